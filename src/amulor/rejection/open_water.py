"""Takes out the water signal that was measured without a target."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.optics import interference
from amulor.rejection import column, reference
from amulor.rejection.build import covariance_of, target_cube
from amulor.rejection.reference import FEWEST_SHOTS, Covariance, fluctuation, stacked
from amulor.survey import Survey


def open_water(
    cube: xr.Dataset, *, interval: tuple[float, float] | None = None
) -> xr.Dataset:
    """Subtract the open-water signal from samples, phasor by phasor.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots at the same frequencies and channels;
        their directions may be sparse over the scan, but must reach to its edges.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m], to tell how much water
        stands behind the target. From 0 to the unambiguous range by default.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`. Its uncertainty holds the instrument's, the
        fluctuation of the water as seen among the shots, and the error of the
        reference, which also stands alone in the `common_` variables. The `residual_`
        variables estimate the water signal that is left because the target cuts the
        column off; they are there if the cube's survey describes the water.

    Raises
    ------
    CubeError
        If there are no open-water shots, too few to judge their scatter, or if the
        scan goes beyond their directions.
    ValueError
        If the interval is empty or holds far too many ambiguity intervals.

    Notes
    -----
    (55)-(58) of [1]_ as a difference of phasors, which has no branch to go wrong.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cubes.check(cube, "samples")
    shots = cube.amulor.open_water
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
    fits = fit_shots(cube, shots)
    signal = cube.amulor.signal.values
    shape = signal.shape
    water = np.array([fit.signal for fit in fits]).reshape(shape)
    common = stacked([fit.common for fit in fits], shape)
    target = interference.target_signal(signal, water)
    known = covariance_of(cube) + common
    present, residual = water, None
    hidden = column.hidden_share(cube, target, known, interval=interval)
    if hidden is not None:
        residual = -hidden * water
        present = (1 - np.nan_to_num(hidden)) * water
    # Only the water in front of the target strays.
    stray = stacked(
        [
            fluctuation(fit.relative, level.ravel())
            for fit, level in zip(fits, present.reshape(-1, *shape[2:]), strict=True)
        ],
        shape,
    )
    total = known + stray
    return target_cube(
        cube,
        target,
        total,
        water_signal=water,
        residual=residual,
        common=common,
        step="reject, open water",
        open_water_degree=np.array([fit.degree for fit in fits], dtype=np.int32),
    )


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
        If too few shots of a channel are numbers, or the scan goes beyond them.
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
            frequency = float(cube["modulation_frequency"][index[0]]) / 1e6
            raise CubeError(
                f"only {use.sum()} open-water shots at {frequency:g} MHz in channel "
                f"{cube['polarization'].values[index[1]]} are numbers, needed are "
                f"{FEWEST_SHOTS}; record more"
            )
        own = Covariance(
            errors.in_phase[index][use],
            errors.quadrature[index][use],
            errors.cross[index][use],
        )
        fits.append(reference.fit(signal[index][use], own, places[use], pixels))
    return fits


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
