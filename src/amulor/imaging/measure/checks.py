"""Check distances: known lengths compared with what a range image measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import xarray as xr
from pydantic import Field

from amulor.errors import CubeError, SurveyError
from amulor.imaging.measure.figures import Measurement, distance, height
from amulor.survey import toml_file
from amulor.survey.quantity import Description, Length

#: Coverage factor of the expanded uncertainty: 95 of 100 for normal errors [1].
COVERAGE_FACTOR = 2.0

Verdict = Literal["pass", "fail", "undecided"]
_Number = Annotated[int, Field(ge=0)]


class Check(Description):
    """A length between two pixels that is known from elsewhere.

    Examples
    --------
    >>> from amulor.imaging.measure import Check
    >>> bar = Check(name="scale bar", first=(20, 8), second=(20, 60), expected="80 mm")
    >>> bar.expected
    0.08
    """

    name: Annotated[str, Field(min_length=1, max_length=100)]
    """What it is, such as "scale bar A-B"."""
    kind: Literal["distance", "relief"] = "distance"
    """Straight distance, or how far the second stands nearer to the instrument."""
    first: tuple[_Number, _Number]
    """Row and column of one end."""
    second: tuple[_Number, _Number]
    """Row and column of the other."""
    reach: Annotated[int, Field(ge=0, le=20)] = 0
    """Pixels around each end to every side that are averaged [1]."""
    expected: Length
    """The known length [m]."""
    expected_uncertainty: Annotated[Length, Field(ge=0)] = 0.0
    """Its standard uncertainty [m]."""
    tolerance: Annotated[Length, Field(gt=0)] | None = None
    """Largest deviation that is allowed; without one, measured and known length have to
    agree within their expanded uncertainty [m]."""


class _Checks(Description):
    """A file of check distances."""

    checks: Annotated[tuple[Check, ...], Field(min_length=1)]
    """Known lengths."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """A known length beside the measured one."""

    check: Check
    """What was known."""
    measured: Measurement
    """What was measured."""
    deviation: float
    """Measured less known [m]."""
    expanded: float
    """Expanded uncertainty of the deviation, k = 2 [m]."""
    verdict: Verdict
    """Pass, fail, or undecided where the uncertainty is too large or not known."""


def read_checks(path: str | Path) -> tuple[Check, ...]:
    """Read the check distances of a TOML file.

    Parameters
    ----------
    path : str or pathlib.Path
        With a table [[checks]] for each.

    Returns
    -------
    tuple of Check
        In SI units.

    Raises
    ------
    SurveyError
        With one line for each thing that is wrong.

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
    text = toml_file.text_of(path, error=SurveyError)
    return toml_file.described(
        text,
        _Checks,
        name=str(path),
        what="a file of check distances",
        error=SurveyError,
    ).checks


def compared(image: xr.Dataset, check: Check) -> Checked:
    r"""Measure a known length.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    check : Check
        What is known.

    Returns
    -------
    Checked
        With the verdict.

    Raises
    ------
    CubeError
        If an end holds no range.

    Notes
    -----
    With the deviation d and its expanded uncertainty :math:`U = 2 \sqrt{u^2 + u_0^2}`:
    under a tolerance T it passes if :math:`|d| + U \le T` and fails if :math:`|d| - U >
    T`, the guarded acceptance and rejection of JCGM 106; in between nobody can tell.
    Without one it passes if :math:`|d| \le U`. It is undecided if U is not known.

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
            found = distance(image, check.first, check.second, reach=check.reach)
        else:
            found = height(
                image,
                check.first,
                check.second,
                axis=(0.0, 0.0, -1.0),
                reach=check.reach,
            )
    except CubeError as error:
        raise CubeError(f"check {check.name!r}: {error}") from None
    off = found.value - check.expected
    combined = (found.uncertainty**2 + check.expected_uncertainty**2) ** 0.5
    expanded = COVERAGE_FACTOR * combined
    return Checked(
        check=check,
        measured=found,
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
