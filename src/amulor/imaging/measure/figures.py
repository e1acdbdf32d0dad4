"""Distance, height, angle and area between picked pixels, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from amulor.errors import CubeError, SurveyError
from amulor.imaging.common import own_variance
from amulor.imaging.edges import STEP_MARGIN, reached, steps
from amulor.imaging.measure.points import Points, points_of
from amulor.survey import toml_file
from amulor.survey.quantity import Description, Length

Floats = NDArray[np.float64]
Pixel = tuple[int, int]

#: Angle below which two directions coincide, without a measurable angle [rad].
_STRAIGHT = 1e-6


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Quantity measured in a range image, with its uncertainty."""

    value: float
    """Measured value in its unit."""
    uncertainty: float
    """Standard uncertainty, errors shared by pixels included; NaN if the range errors
    are unknown."""
    random: float
    """Part of the uncertainty from the noise of single pixels."""
    unit: str
    """Unit: m, m2, m3 or rad."""
    pixels: int
    """Number of pixels used [1]."""


def distance(
    image: xr.Dataset, first: Pixel, second: Pixel, *, reach: int = 0
) -> Measurement:
    r"""Straight-line distance between two points.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    first, second : tuple of int
        Row and column of each.
    reach : int
        Number of pixels to each side over which a point is averaged, up to a step of
        the surface [1].

    Returns
    -------
    Measurement
        Distance [m].

    Raises
    ------
    CubeError
        If a pixel has no range, or both are the same point.

    Notes
    -----
    :math:`u^2 = g^T C g` with the covariance C of the slant ranges
    (`amulor.imaging.correlation.covariance`) and
    :math:`g_i = \partial D / \partial r_i`, the component of each beam along the
    distance; first order. Common errors cancel as far as the beams and the errors of
    both pixels are alike. Beam directions are assumed to be exact.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> found = imaging.measure.distance(image, (20, 8), (20, 60), reach=2)
    >>> print(f"{found.value * 1e3:.1f} mm +- {found.uncertainty * 1e3:.1f} mm")
    74.5 mm +- 1.5 mm
    """
    picked, weight = _picked(image, [first, second], reach)
    place = weight @ picked.position
    step = place[1] - place[0]
    length = float(np.linalg.norm(step))
    if length == 0:
        raise CubeError("both points are the same; pick two that are apart")
    along = step / length
    return _measured(picked, weight, length, np.stack([-along, along]), unit="m")


def height(
    image: xr.Dataset,
    first: Pixel,
    second: Pixel,
    *,
    axis: ArrayLike = (0.0, -1.0, 0.0),
    reach: int = 0,
) -> Measurement:
    """Height of the second of two points above the first, along an axis.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    first, second : tuple of int
        Row and column of each.
    axis : array_like, shape (3,)
        Upward direction in the instrument's axes (right, down, forward); (0, 0, -1) is
        towards the instrument [1].
    reach : int
        Number of pixels to each side over which a point is averaged, up to a step of
        the surface [1].

    Returns
    -------
    Measurement
        Height of the second over the first, with its sign [m].

    Raises
    ------
    CubeError
        If a pixel has no range.
    ValueError
        If the axis has no length.

    Examples
    --------
    How far the first board of the ladder stands before its wall: 41 mm.

    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> found = imaging.measure.height(
    ...     image, (20, 8), (20, 26), axis=(0, 0, -1), reach=3
    ... )
    >>> print(f"{found.value * 1e3:.1f} mm +- {found.uncertainty * 1e3:.1f} mm")
    39.0 mm +- 1.4 mm
    """
    up = np.asarray(axis, dtype=float)
    size = float(np.linalg.norm(up))
    if up.shape != (3,) or not size > 0:
        raise ValueError(f"axis must be a vector of 3 with a length, got {up.tolist()}")
    up = up / size
    picked, weight = _picked(image, [first, second], reach)
    place = weight @ picked.position
    value = float(up @ (place[1] - place[0]))
    return _measured(picked, weight, value, np.stack([-up, up]), unit="m")


def angle(
    image: xr.Dataset, first: Pixel, corner: Pixel, second: Pixel, *, reach: int = 0
) -> Measurement:
    """Angle at a point between the directions to two others.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    first, corner, second : tuple of int
        Row and column of each point. The angle is that at the corner.
    reach : int
        Number of pixels to each side over which a point is averaged, up to a step of
        the surface [1].

    Returns
    -------
    Measurement
        Angle, from 0 to pi [rad].

    Raises
    ------
    CubeError
        If a pixel has no range, or the three points lie on a line, where no uncertainty
        of first order exists.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> found = imaging.measure.angle(image, (5, 5), (20, 40), (30, 90), reach=1)
    >>> print(f"{found.value:.3f} rad")
    0.365 rad
    """
    picked, weight = _picked(image, [first, corner, second], reach)
    place = weight @ picked.position
    arm_a, arm_b = place[0] - place[1], place[2] - place[1]
    lengths = float(np.linalg.norm(arm_a)), float(np.linalg.norm(arm_b))
    if min(lengths) == 0:
        raise CubeError("two of the points are the same; pick three that are apart")
    arm_a, arm_b = arm_a / lengths[0], arm_b / lengths[1]
    sine = float(np.linalg.norm(np.cross(arm_a, arm_b)))
    cosine = float(arm_a @ arm_b)
    if sine < _STRAIGHT:
        raise CubeError("the three points lie on a line; pick a corner off it")
    to_first = (cosine * arm_a - arm_b) / (sine * lengths[0])
    to_second = (cosine * arm_b - arm_a) / (sine * lengths[1])
    gradient = np.stack([to_first, -to_first - to_second, to_second])
    value = float(np.arctan2(sine, cosine))
    return _measured(picked, weight, value, gradient, unit="rad")


def area(image: xr.Dataset, corners: Sequence[Pixel], *, reach: int = 0) -> Measurement:
    r"""Area of a polygon with pixels as its corners.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    corners : sequence of tuple of int
        Rows and columns, at least three, in order around the polygon.
    reach : int
        Number of pixels to each side over which a point is averaged, up to a step of
        the surface [1].

    Returns
    -------
    Measurement
        Area [m2]. For corners out of a plane it is the largest projected area of the
        polygon.

    Raises
    ------
    CubeError
        If there are fewer than three corners, a corner has no range, or the area is
        zero.

    Notes
    -----
    :math:`|\sum_k p_k \times p_{k+1}| / 2`, the length of the vector area.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.unmix(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> corners = [(5, 65), (5, 75), (30, 75), (30, 65)]
    >>> found = imaging.measure.area(image, corners, reach=1)
    >>> print(f"{found.value * 1e6:.0f} mm2 +- {found.uncertainty * 1e6:.0f} mm2")
    240 mm2 +- 4 mm2
    """
    if len(corners) < 3:
        raise CubeError(f"an area needs at least 3 corners, got {len(corners)}")
    picked, weight = _picked(image, corners, reach)
    place = weight @ picked.position
    place = place - place.mean(axis=0)  # far origins would cost digits
    after, before = np.roll(place, -1, axis=0), np.roll(place, 1, axis=0)
    vector = np.cross(place, after).sum(axis=0) / 2
    size = float(np.linalg.norm(vector))
    if size == 0:
        raise CubeError("the corners enclose no area; pick some that are off a line")
    gradient = np.cross(after - before, vector / size) / 2
    return _measured(picked, weight, size, gradient, unit="m2")


def _picked(
    image: xr.Dataset, pixels: Sequence[Pixel], reach: int
) -> tuple[Points, Floats]:
    """Pixels used for the picked points, and the weight of each pixel in each point."""
    if reach < 0:
        raise ValueError(f"reach must be at least 0 pixels, got {reach}")
    usable = np.isfinite(image["slant_range"].values)
    rows, columns, owners = [], [], []
    for owner, (row, column) in enumerate(pixels):
        around = [(row, column)]
        if reach and usable[_single_pixel(image, row, column)]:
            wide = reach + STEP_MARGIN
            top, left = max(row - wide, 0), max(column - wide, 0)
            near = image.isel(
                row=slice(top, row + wide + 1), column=slice(left, column + wide + 1)
            )
            edges = steps(near["slant_range"].values, own_variance(near))
            part = reached(*edges, (row - top, column - left), reach)
            part &= np.isfinite(near["slant_range"].values)
            around = [(top + int(r), left + int(c)) for r, c in np.argwhere(part)]
        rows += [r for r, _ in around]
        columns += [c for _, c in around]
        owners += [owner] * len(around)
    weight = np.zeros((len(pixels), len(rows)))
    weight[owners, np.arange(len(rows))] = 1.0
    weight /= weight.sum(axis=1, keepdims=True)
    return points_of(image, rows, columns), weight


def _single_pixel(image: xr.Dataset, row: int, column: int) -> tuple[int, int]:
    """Row and column of a single pixel, checked to be in the image."""
    shape = image["slant_range"].shape
    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
        raise CubeError(
            f"pixel ({row}, {column}) is outside of the image of {shape[0]} rows and "
            f"{shape[1]} columns"
        )
    return row, column


def _measured(
    picked: Points, weight: Floats, value: float, gradient: Floats, *, unit: str
) -> Measurement:
    """Measurement with uncertainty, propagated by the gradient at the points."""
    along = np.einsum("kx,ix,ki->i", gradient, picked.direction, weight)
    variance = float(along @ picked.covariance @ along)
    # A pixel that two points have in common is one and the same noise.
    equal = np.zeros_like(picked.covariance)
    _, place = np.unique(picked.position, axis=0, return_inverse=True)
    place = place.reshape(-1)
    equal[place[:, None] == place] = 1.0
    random = float(along @ (equal * picked.noise) @ along)
    return Measurement(
        value=value,
        uncertainty=max(variance, 0.0) ** 0.5,
        random=max(random, 0.0) ** 0.5,
        unit=unit,
        pixels=int(place.max()) + 1,
    )


#: Coverage factor of the expanded uncertainty: 95 of 100 for normal errors [1].
COVERAGE_FACTOR = 2.0

Verdict = Literal["pass", "fail", "undecided"]
_Number = Annotated[int, Field(ge=0)]


class Check(Description):
    """Reference length between two pixels.

    Examples
    --------
    >>> from amulor.imaging.measure import Check
    >>> bar = Check(name="scale bar", first=(20, 8), second=(20, 60), expected="80 mm")
    >>> bar.expected
    0.08
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    """Name, such as "scale bar A-B"."""
    kind: Literal["distance", "relief"] = "distance"
    """Straight-line distance, or height of the second point towards the instrument."""
    first: tuple[_Number, _Number]
    """Row and column of the first end."""
    second: tuple[_Number, _Number]
    """Row and column of the second end."""
    reach: Annotated[int, Field(ge=0, le=20)] = 0
    """Pixels averaged around each end in every direction [1]."""
    expected: Length
    """Reference length [m]."""
    expected_uncertainty: Annotated[Length, Field(ge=0)] = 0.0
    """Standard uncertainty of the reference length [m]."""
    tolerance: Annotated[Length, Field(gt=0)] | None = None
    """Largest allowed deviation; the expanded uncertainty by default [m]."""


class _Checks(Description):
    """Content of a file of check distances."""

    checks: Annotated[tuple[Check, ...], Field(min_length=1)]
    """Reference lengths."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Comparison of a reference length with the measured length."""

    check: Check
    """Reference length."""
    measured: Measurement
    """Measured length, with uncertainty."""
    deviation: float
    """Measured minus reference length [m]."""
    expanded: float
    """Expanded uncertainty of the deviation, k = 2 [m]."""
    verdict: Verdict
    """Verdict: pass, fail, or undecided where the uncertainty is too large or
    unknown."""


def read_checks(path: str | Path) -> tuple[Check, ...]:
    """Read the check distances of a TOML file.

    Parameters
    ----------
    path : str or pathlib.Path
        TOML file with a table [[checks]] for each check distance.

    Returns
    -------
    tuple of Check
        Check distances in SI units.

    Raises
    ------
    SurveyError
        With one line for each error in the file.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from amulor import imaging
    >>> ends = "first = [20, 8], second = [20, 60]"
    >>> text = f'checks = [{{name = "scale bar", expected = "80 mm", {ends}}}]'
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "checks.toml"
    ...     _ = file.write_text(text)
    ...     (found,) = imaging.measure.read_checks(file)
    >>> found.name
    'scale bar'
    """
    return toml_file.read(
        path, _Checks, what="a file of check distances", error=SurveyError
    ).checks


def compared(image: xr.Dataset, check: Check) -> Checked:
    r"""Measure a reference length and compare it with its reference value.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    check : Check
        Reference length and its ends.

    Returns
    -------
    Checked
        Measured length with the outcome of the check.

    Raises
    ------
    CubeError
        If an end has no range.

    Notes
    -----
    With the deviation d and its expanded uncertainty :math:`U = 2 \sqrt{u^2 + u_0^2}`:
    with a tolerance T it passes if :math:`|d| + U \le T` and fails if
    :math:`|d| - U > T`, the guarded acceptance and rejection of JCGM 106. In between it
    is undecided. Without a tolerance it passes if :math:`|d| \le U`. It is undecided if
    U is unknown.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> bar = imaging.measure.Check(
    ...     name="board before wall", kind="relief", first=(20, 8), second=(20, 26),
    ...     reach=3, expected="40.8 mm", tolerance="5 mm",
    ... )
    >>> imaging.measure.compared(image, bar).verdict
    'pass'
    """
    try:
        if check.kind == "distance":
            measured = distance(image, check.first, check.second, reach=check.reach)
        else:
            measured = height(
                image,
                check.first,
                check.second,
                axis=(0.0, 0.0, -1.0),
                reach=check.reach,
            )
    except CubeError as error:
        raise CubeError(f"check {check.name!r}: {error}") from None
    off = measured.value - check.expected
    combined = (measured.uncertainty**2 + check.expected_uncertainty**2) ** 0.5
    expanded = COVERAGE_FACTOR * combined
    return Checked(
        check=check,
        measured=measured,
        deviation=off,
        expanded=expanded,
        verdict=_verdict(abs(off), expanded, check.tolerance),
    )


def _verdict(off: float, expanded: float, tolerance: float | None) -> Verdict:
    if math.isnan(expanded):
        return "undecided"
    if tolerance is None:
        return "pass" if off <= expanded else "fail"
    if off + expanded <= tolerance:
        return "pass"
    return "fail" if off - expanded > tolerance else "undecided"
