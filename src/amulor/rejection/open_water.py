"""Takes out the water signal that was measured without a target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.rejection import quality
from amulor.rejection.build import along, covariance_of, target_cube
from amulor.rejection.reference import column
from amulor.rejection.reference import fit as reference
from amulor.rejection.reference.fit import (
    FEWEST_SHOTS,
    NO_DRIFT,
    Covariance,
    fluctuation,
    stacked,
)
from amulor.survey import Survey

#: Drift of the reference that chance makes in less than 1 of 1000 scans is real [1].
_REAL_DRIFT = 1e-3
#: A larger change from the first to the last shot is another water [1].
LARGEST_DRIFT = 0.2
#: It must exceed that by so many of its own standard uncertainties [1].
_SURE = 3.0


def open_water(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    column_uncertainty: float | None = None,
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
        the target, such as 0.2 [1]. If it is given, that water is put back, for it was
        never there to be subtracted, and this share of it stays as an error that all
        pixels have in common. By default the water behind the target is only stated.

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
    is of other water there.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cubes.check(cube, "samples")
    _refuse_odd_shares(column_uncertainty)
    shots = shots_of(cube)
    fits = fit_shots(cube, shots)
    signal = cube.amulor.signal.values
    shape = signal.shape
    water = np.array([fit.signal for fit in fits]).reshape(shape)
    common = stacked([fit.common for fit in fits], shape)
    target = subtract(signal, water)
    known = covariance_of(cube) + common
    present, residual = water, None
    hidden = column.hidden_share(cube, target, known, interval=interval)
    if hidden is not None:
        residual = -hidden * water
        present = (1 - np.nan_to_num(hidden)) * water
        if column_uncertainty is not None:
            settled = np.nan_to_num(residual)
            target, water = target - settled, water + settled
            shared = along(settled, column_uncertainty)
            common, known = common + shared, known + shared
            residual = np.where(np.isnan(residual), residual, 0)
    # Only the water in front of the target strays.
    stray = stacked(
        [
            fluctuation(fit.relative, level.ravel())
            for fit, level in zip(fits, present.reshape(-1, *shape[2:]), strict=True)
        ],
        shape,
    )
    total = known + stray
    drift = _drift(fits, shape)
    moved = quality.moves_the_phase(target, drift * present / 2, total)
    by_drift = along(drift * present, 12**-0.5)
    other = quality.looks_like_water(cube, target, present, total)
    result = target_cube(
        cube,
        target,
        total + by_drift,
        water_signal=water,
        residual=residual,
        common=common + by_drift,
        step="reject, open water"
        + ("" if column_uncertainty is None else ", column behind the target put back"),
        frequencies_share_errors=np.int32(0),
        open_water_degree=np.array([fit.degree for fit in fits], dtype=np.int32),
        open_water_drift=np.array([abs(fit.drift.change) for fit in fits]),
        open_water_drift_uncertainty=np.array(
            [abs(fit.drift.uncertainty) for fit in fits]
        ),
    )
    return quality.add(result, QualityFlag.WATER_RESIDUAL, moved | other)


def subtract(
    signal: NDArray[np.complex128], water_signal: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Take the water signal out of samples, in the memory of the samples.

    Parameters
    ----------
    signal : ndarray of complex
        Target and water together [V]; overwritten.
    water_signal : ndarray of the same shape
        The water alone [V].

    Returns
    -------
    ndarray of complex
        `signal`, which now holds the target alone [V].

    Notes
    -----
    `amulor.optics.interference.target_signal`, (55)-(57) of Ricci et al. 2010, as
    rebuilt, without new memory: fetching that takes as long as the subtraction.
    """
    return np.subtract(signal, water_signal, out=signal)


def shots_of(cube: xr.Dataset) -> xr.Dataset:
    """Return the open-water shots of a cube.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.

    Returns
    -------
    xarray.Dataset
        Dimensions (modulation_frequency, polarization, shot).

    Raises
    ------
    CubeError
        If there are none, or too few to judge how much they stray.
    """
    shots: xr.Dataset | None = cube.amulor.open_water
    if shots is None:
        raise CubeError(
            "the cube has no open-water shots (group open_water); record them with the "
            "target out of the beam, or use a polarimetric method"
        )
    if shots.sizes["shot"] < FEWEST_SHOTS:
        raise CubeError(
            f"the cube has {shots.sizes['shot']} open-water shots, needed are at least "
            f"{FEWEST_SHOTS} to judge how much the water signal strays; record more"
        )
    return shots


def fit_shots(cube: xr.Dataset, shots: xr.Dataset) -> list[reference.Reference]:
    """Return the water signal of the shots at the pixels of a cube.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    shots : xarray.Dataset
        Its open-water shots.

    Returns
    -------
    list of Reference
        Modulation frequency by frequency, channel by channel.

    Raises
    ------
    CubeError
        If too few shots of a channel are numbers, the scan goes beyond them, or the
        water changed too much from the first to the last.
    """
    pixels = np.stack(
        [cube["azimuth"].values.ravel(), cube["elevation"].values.ravel()], axis=1
    )
    known = "azimuth" in shots and "elevation" in shots
    places = (
        np.stack([shots["azimuth"].values, shots["elevation"].values], axis=1)
        if known
        else np.zeros((shots.sizes["shot"], 2))
    )
    signal = shots["in_phase"].values + 1j * shots["quadrature"].values
    errors = covariance_of(shots)
    usable = np.isfinite(signal + errors.in_phase + errors.quadrature + errors.cross)
    if known:
        _refuse_a_scan_beyond_the_shots(cube, places, pixels)
    fits = []
    for index in np.ndindex(signal.shape[:2]):
        use = usable[index]
        if use.sum() < FEWEST_SHOTS:
            raise CubeError(
                f"only {use.sum()} open-water shots at {_place(cube, index)} are "
                f"numbers, needed are {FEWEST_SHOTS}; record more"
            )
        own = Covariance(
            errors.in_phase[index][use],
            errors.quadrature[index][use],
            errors.cross[index][use],
        )
        fit = reference.fit(signal[index][use], own, places[use], pixels)
        # Shots of unknown directions may be pixels: their order is no time.
        fits.append(fit if known else replace(fit, drift=NO_DRIFT))
    _refuse_strong_drift(cube, fits, signal.shape[:2])
    return fits


def _place(cube: xr.Dataset, index: tuple[int, ...]) -> str:
    frequency = float(cube["modulation_frequency"][index[0]]) / 1e6
    return f"{frequency:g} MHz in channel {cube['polarization'].values[index[1]]}"


def _is_real(drift: reference.Drift, fits: list[reference.Reference]) -> bool:
    return drift.chance * len(fits) < _REAL_DRIFT


def _drift(
    fits: list[reference.Reference], shape: tuple[int, ...]
) -> NDArray[np.complex128]:
    """Return the drift of every frequency and channel, zero where it may be chance."""
    found = [fit.drift.change if _is_real(fit.drift, fits) else 0j for fit in fits]
    return np.array(found).reshape(*shape[:2], 1, 1)


def _refuse_strong_drift(
    cube: xr.Dataset, fits: list[reference.Reference], shape: tuple[int, ...]
) -> None:
    sure = [
        abs(fit.drift.change) - _SURE * abs(fit.drift.uncertainty)
        if _is_real(fit.drift, fits)
        else 0.0
        for fit in fits
    ]
    worst = int(np.argmax(sure))
    if sure[worst] > LARGEST_DRIFT:
        drift = fits[worst].drift
        place = _place(cube, tuple(map(int, np.unravel_index(worst, shape))))
        raise CubeError(
            f"the open-water signal at {place} changed by "
            f"{abs(drift.change):.0%} (+- {abs(drift.uncertainty):.0%}) from the first "
            f"shot to the last, at most {LARGEST_DRIFT:.0%} can be bridged; record the "
            "reference again closer to the scan, or split scan and reference into "
            "shorter parts"
        )


def _refuse_odd_shares(column_uncertainty: float | None) -> None:
    if column_uncertainty is not None and not 0 <= column_uncertainty <= 1:
        raise ValueError(
            "column_uncertainty must lie between 0 and 1 (a share of the water behind "
            f"the target), got {column_uncertainty:g}"
        )


#: How far the scan may go beyond the shots: a share of their span, at least that [rad].
_BEYOND, _BEYOND_AT_LEAST = 0.1, 1e-4


def _refuse_a_scan_beyond_the_shots(
    cube: xr.Dataset, shots: NDArray[np.float64], pixels: NDArray[np.float64]
) -> None:
    """Raise if the water signal would have to be extrapolated over the directions."""
    text = cube.attrs.get("survey")
    if text and Survey.from_text(text).scan.moves == "both":
        return  # The receiver turns with the beam: the water is the same everywhere.
    low, high = shots.min(axis=0), shots.max(axis=0)
    room = np.maximum(_BEYOND * (high - low), _BEYOND_AT_LEAST)
    outside = np.maximum(low - pixels.min(axis=0), pixels.max(axis=0) - high) - room
    if np.any(outside > 0):
        axis = int(np.argmax(outside))
        raise CubeError(
            f"the scan goes {np.degrees(outside[axis] + room[axis]):.2f} degrees "
            f"beyond the open-water shots in {('azimuth', 'elevation')[axis]}, where "
            "the water signal is not known; record shots at the edges of the scan"
        )
