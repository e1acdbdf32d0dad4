"""Leaves pixels out of a range image: doubtful, uncertain or mixed ones."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE, QualityFlag
from amulor.imaging.common import with_flag


def leave_out(
    image: xr.Dataset,
    *,
    good_only: bool = False,
    largest_uncertainty: float | None = None,
    mixed: bool = False,
) -> xr.Dataset:
    """Return a range image in which some pixels count as not measured.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    good_only : bool
        Leave out all pixels that carry any flag.
    largest_uncertainty : float, optional
        Leave out pixels whose combined standard uncertainty is larger [m].
    mixed : bool
        Leave out mixed pixels and outliers, whose points hang where nothing is.

    Returns
    -------
    xarray.Dataset
        Those pixels flagged `MISSING`; the history says how many were taken, and why.

    Raises
    ------
    ValueError
        If the largest uncertainty is not above 0 m.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> image = imaging.range_image(target)
    >>> kept = imaging.leave_out(image, largest_uncertainty=7e-3)
    >>> largest = float(kept["slant_range_uncertainty"].max())
    >>> print(f"largest uncertainty {1e3 * largest:.1f} mm")
    largest uncertainty 7.0 mm
    """
    image = cubes.checked(image, "range_image")
    gone, counts = to_leave_out(
        image,
        good_only=good_only,
        largest_uncertainty=largest_uncertainty,
        mixed=mixed,
    )
    return without(image, gone, counts)


def to_leave_out(
    image: xr.Dataset,
    *,
    good_only: bool,
    largest_uncertainty: float | None,
    mixed: bool,
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Return which pixels `leave_out` takes, and how many for which reason."""
    if largest_uncertainty is not None and not largest_uncertainty > 0:
        raise ValueError(
            f"largest uncertainty must be above 0 m, got {largest_uncertainty:g} m"
        )
    flag = image["quality_flag"].values
    usable = (flag & UNUSABLE) == 0
    reasons = {}
    if good_only:
        reasons["doubtful"] = flag != 0
    if mixed:
        between = QualityFlag.MIXED | QualityFlag.OUTLIER
        reasons["mixed or outlying"] = (flag & between) != 0
    if largest_uncertainty is not None:
        limit = f"more uncertain than {largest_uncertainty * 1e3:g} mm"
        sigma = image["slant_range_uncertainty"].values
        reasons[limit] = ~(sigma <= largest_uncertainty)
    gone = np.zeros(flag.shape, dtype=bool)
    counts = {}
    for reason, where in reasons.items():
        new = where & usable & ~gone
        gone |= new
        counts[reason] = int(new.sum())
    return gone, counts


def without(
    image: xr.Dataset, gone: NDArray[np.bool_], counts: dict[str, int]
) -> xr.Dataset:
    """Return a range image without some pixels."""
    if not any(counts.values()):
        return image
    kept = {
        str(name): values.where(~gone)
        for name, values in image.data_vars.items()
        if str(name).startswith("slant_range") and values.dims == ("row", "column")
    }
    image = with_flag(image.assign(kept), QualityFlag.MISSING, gone)
    said = ", ".join(f"{count} {reason}" for reason, count in counts.items())
    return cubes.note(image, f"left out: {said}")
