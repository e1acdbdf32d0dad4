"""Open-water reference from another cube of the same instrument and water."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import CubeError

#: Numbers that differ by no more than this are the same [1].
_SAME = 1e-6


def with_open_water(cube: xr.Dataset, reference: xr.Dataset) -> xr.Dataset:
    """Return samples with the open-water shots of another cube.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`. Its open-water shots are replaced, if it has any.
    reference : xarray.Dataset
        Level `samples`, of the same water by the same instrument. Its open-water shots
        are used. Without shots it must be a scan without a target; all its pixels are
        then used, in the order of recording.

    Returns
    -------
    xarray.Dataset
        Level `samples` with the group `open_water`.

    Raises
    ------
    CubeError
        If the reference lacks a frequency or a channel of the cube, was recorded by
        another instrument or in another place, or in water that its survey describes
        otherwise.

    Examples
    --------
    >>> from amulor import cube as cubes, rejection, samples
    >>> cube = samples.cube("ladder")
    >>> bare = cubes.without_groups(cube)
    >>> with_shots = rejection.with_open_water(bare, cube)
    >>> with_shots.sizes["shot"]
    540
    """
    cube = cubes.checked(cube, "samples", name="the target cube")
    reference = cubes.checked(reference, "samples", name="the open-water cube")
    _refuse_other_frequencies(cube, reference)
    _refuse_other_channels(cube, reference)
    _refuse_other_geometry(cube, reference)
    _refuse_other_surveys(cube, reference)
    chosen = reference.sel(
        modulation_frequency=cube["modulation_frequency"].values,
        polarization=cube["polarization"].values,
    )
    shots = chosen.amulor.open_water
    if shots is None:
        shots = pixels_as_shots(chosen, np.ones(chosen["azimuth"].shape, dtype=bool))
    bare = cubes.without_groups(cube)
    truth = cube.amulor.truth
    if truth is not None:
        bare = cubes.attach(bare, truth, "truth")
    return cubes.note(
        cubes.attach(bare, shots, "open_water"), "open water from another cube"
    )


def pixels_as_shots(reference: xr.Dataset, empty: NDArray[np.bool_]) -> xr.Dataset:
    """Convert pixels without a target to open-water shots, sorted by time.

    `empty` is the mask of these pixels, over (row, column).
    """
    order = np.flatnonzero(empty)
    if "time" in reference.coords:
        time = reference["time"].values.ravel()[order]
        order = order[np.argsort(time, kind="stable")]

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        wide = values.reshape(*values.shape[:-2], -1)
        return np.asarray(wide[..., order])

    names = ["in_phase", "quadrature", "in_phase_uncertainty", "quadrature_uncertainty"]
    if "in_phase_quadrature_covariance" in reference:
        names.append("in_phase_quadrature_covariance")
    variables = {name: flat(reference[name].values) for name in names}
    if "saturated" in reference:
        lost = flat(reference["saturated"].values) != 0
        variables["in_phase"] = np.where(lost, np.nan, variables["in_phase"])
    for name in ("azimuth", "elevation"):
        variables[name] = flat(reference[name].values)
    return cubes.open_water(variables)


def _refuse_other_frequencies(cube: xr.Dataset, reference: xr.Dataset) -> None:
    needed = cube["modulation_frequency"].values
    available = reference["modulation_frequency"].values
    missing = [value for value in needed if value not in available]
    if missing:
        listed = ", ".join(f"{value / 1e6:g}" for value in missing)
        raise CubeError(
            f"the open-water cube has no sample at {listed} MHz, which the target cube "
            "has; record it again at these frequencies, or select the common ones first"
        )


def _refuse_other_channels(cube: xr.Dataset, reference: xr.Dataset) -> None:
    available = set(reference.amulor.polarizations)
    missing = [name for name in cube.amulor.polarizations if name not in available]
    if missing:
        raise CubeError(
            f"the open-water cube has the channels {', '.join(sorted(available))}, but "
            f"the target cube has {', '.join(missing)} too; record open water in every "
            "channel, or select the common ones first"
        )


def _refuse_other_geometry(cube: xr.Dataset, reference: xr.Dataset) -> None:
    ours, theirs = cube.amulor.geometry, reference.amulor.geometry
    for key in sorted((set(ours) | set(theirs)) - {"long_name", "units"}):
        a, b = ours.get(key), theirs.get(key)
        if a is None or b is None or not np.allclose(a, b, rtol=_SAME, atol=_SAME):
            raise CubeError(
                f"{key} is {b} in the open-water cube, but {a} in the target cube; "
                "record open water with the instrument as it stands, in the same water"
            )


def _refuse_other_surveys(cube: xr.Dataset, reference: xr.Dataset) -> None:
    ours, theirs = cube.amulor.survey, reference.amulor.survey
    if ours is None or theirs is None:
        return
    for part, remedy in (
        ("water", "record open water in the same water as the target"),
        ("instrument", "record open water with the same settings as the target"),
    ):
        a, b = (getattr(survey, part).model_dump() for survey in (ours, theirs))
        difference = _first_difference(a, b)
        if difference is not None:
            name, value, other = difference
            raise CubeError(
                f"the open-water cube is of another {part}: {part}.{name} is {other} "
                f"there, but {value} in the target cube; {remedy}"
            )


def _first_difference(
    ours: Mapping[str, Any], theirs: Mapping[str, Any]
) -> tuple[str, Any, Any] | None:
    """Return name and both values of the first differing field; None if equal."""
    for name, value in ours.items():
        # The reference may have been recorded at more frequencies and channels.
        if name in ("modulation_frequencies", "polarizations"):
            continue
        other = theirs.get(name)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            difference = _first_difference(value, other)
            if difference is not None:
                return f"{name}.{difference[0]}", *difference[1:]
        elif value != other:
            return name, value, other
    return None
