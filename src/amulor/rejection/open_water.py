"""Takes out the water signal that was measured without a target."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.rejection import quality
from amulor.rejection.build import target_cube
from amulor.rejection.covariance import along, covariance_of
from amulor.rejection.reference.before_target import water_before_target
from amulor.rejection.reference.presence import shows_target
from amulor.rejection.reference.strength import strength_of
from amulor.rejection.reference.turbidity import Turbidity

Complex = NDArray[np.complex128]

#: At one frequency the column must be weaker than this, in parts of the target [1].
_TOO_STRONG = 0.3


def open_water(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    column_uncertainty: float | None = None,
    put_back: bool = True,
) -> xr.Dataset:
    r"""Subtract the open-water signal from samples, phasor by phasor.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots at the same frequencies and channels, in
        the order in which they were recorded; their directions may be sparse over the
        scan, but must reach to its edges.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m], to tell how much water
        stands behind the target. From 0 to the unambiguous range by default.
    column_uncertainty : float, optional
        Relative standard uncertainty of what the survey says about the water behind
        the target, such as 0.2 [1]. By default the shots tell: they correct the
        survey's turbidity, and what they leave open is the error.
    put_back : bool
        Whether the water behind the target is put back, for it was never there to be
        subtracted. If not, it is only stated, in the `residual_` variables.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`. Its uncertainty holds the instrument's, the
        fluctuation of the water as seen among the shots, the error of the reference
        between the shots, and a drift from the first shot to the last; what the pixels
        share also stands alone in the `common_` variables. The `residual_` variables
        estimate the water signal that is left because the target cuts the column off
        (zero where it was put back); they are there if the cube's survey describes the
        water. The attributes `open_water_drift` and `open_water_drift_uncertainty`
        hold the size of the relative change, frequency by frequency; infinite
        uncertainty says that no direction was repeated, or none is stated.

    Raises
    ------
    CubeError
        If there are no open-water shots, too few to judge their scatter, if the
        scan goes beyond their directions, or the water changed by more than a fifth
        between the first and the last.
    ValueError
        If the interval is empty or holds far too many ambiguity intervals, or the
        uncertainty of the column is not between 0 and 1.

    Notes
    -----
    (55)-(58) of [1]_ as a difference of phasors, which has no branch to go wrong. A
    drift that is larger than chance makes it in 1 of 1000 scans counts as an error that
    is spread evenly over its size, and flags `WATER_RESIDUAL` where half of it moves
    the phase by more than all other errors. So does, with two frequencies or channels
    at least, a remainder that has the shape of the water signal itself: the reference
    is of other water there. `NO_TARGET` is decided before any column is put back, see
    `amulor.rejection.reference.presence.shows_target`.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cube = cubes.checked(cube, "samples")
    _refuse_odd_fraction(column_uncertainty)
    water = water_before_target(
        cube, interval=interval, survey_is_right=column_uncertainty is not None
    )
    seen = shows_target(cube, water, interval=interval)
    target, water_signal, common = water.difference, water.to_the_end, water.common
    known = covariance_of(cube) + common
    residual = None
    circular = np.zeros(target.shape[2:], dtype=bool)
    corrected = put_back and water.hidden_fraction is not None
    if water.hidden_fraction is not None:
        residual = -water.hidden_fraction * water_signal
        if put_back:
            settled = np.nan_to_num(residual)
            circular = _circular(target - settled, settled)
            target, water_signal = target - settled, water_signal + settled
            shared = water.hidden_error
            if shared is None:
                shared = along(settled, column_uncertainty or 0.0)
            common, known = common + shared, known + shared
            residual = np.where(np.isnan(residual), residual, 0)
    # Only the water in front of the target fluctuates.
    total = known + water.fluctuation
    drift = along(water.drift * water.signal, 12**-0.5)
    strength = strength_of(
        target,
        water.signal,
        covariance_of(cube) + water.fluctuation,
        common + drift,
        modulation_frequency=cube["modulation_frequency"].values,
        path=water.path,
    )
    target = target - strength.change * water.signal
    water_signal = water_signal + strength.change * water.signal
    departure = along(water.signal, strength.uncertainty)
    other = quality.looks_like_water(cube, target, water.signal, total)
    by_drift = drift + departure
    result = target_cube(
        cube,
        target,
        total + by_drift,
        water_signal=water_signal,
        residual=residual,
        common=common + by_drift,
        step="reject, open water"
        + (", column behind the target put back" if corrected else ""),
        frequencies_share_errors=np.int32(0),
        open_water_degree=np.array([fit.degree for fit in water.fits], dtype=np.int32),
        open_water_drift=np.array([abs(fit.drift.change) for fit in water.fits]),
        open_water_drift_uncertainty=np.array(
            [abs(fit.drift.uncertainty) for fit in water.fits]
        ),
        **_turbidity_attributes(water.turbidity),
    )
    result = quality.add(result, QualityFlag.WATER_RESIDUAL, other | circular)
    return quality.add(result, QualityFlag.NO_TARGET, ~seen)


def _circular(target: Complex, column: Complex) -> NDArray[np.bool_]:
    """Return where one frequency leaves target and column to explain each other.

    The distance that cuts the column off comes from what subtraction left. Where the
    column is more than a third as strong as the target, it is the column that sets this
    distance, and a single frequency cannot contradict it.
    """
    if len(target) > 1:
        return np.zeros(target.shape[2:], dtype=bool)
    size = np.abs(column)
    # In a shadow the column may come out short: what others have counts as well.
    usual = np.array(
        [[np.median(c[c > 0]) if c.any() else 0.0 for c in f] for f in size]
    )
    weak = np.maximum(size, usual[..., None, None]) > _TOO_STRONG * np.abs(target)
    return np.asarray(weak.any(axis=(0, 1)))


def _turbidity_attributes(turbidity: Turbidity | None) -> dict[str, Any]:
    """Return what the shots say about the water, as attributes of a cube."""
    if turbidity is None:
        return {}
    return {
        "open_water_turbidity": turbidity.factor,
        "open_water_turbidity_uncertainty": turbidity.factor * turbidity.uncertainty,
        "open_water_misfit": turbidity.misfit,
    }


def _refuse_odd_fraction(column_uncertainty: float | None) -> None:
    if column_uncertainty is not None and not 0 <= column_uncertainty <= 1:
        raise ValueError(
            "column_uncertainty must lie between 0 and 1 (a fraction of the water "
            f"behind the target), got {column_uncertainty:g}"
        )
