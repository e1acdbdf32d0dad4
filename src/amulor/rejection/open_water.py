"""Takes out the water signal that was measured without a target."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.optics import interference
from amulor.rejection import column, reference
from amulor.rejection.build import covariance_of, target_cube
from amulor.rejection.reference import Covariance


def open_water(cube: xr.Dataset) -> xr.Dataset:
    """Subtract the open-water signal from samples, phasor by phasor.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots at the same frequencies and channels;
        their directions may be sparse over the scan.

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
        If there are no open-water shots, or too few to judge their scatter.

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
    if shots.sizes["shot"] < _FEWEST_SHOTS:
        raise CubeError(
            f"the cube has {shots.sizes['shot']} open-water shots, needed are at least "
            f"{_FEWEST_SHOTS} to judge how much the water signal strays; record more"
        )
    fits = _fit_all(cube, shots)
    signal = cube.amulor.signal.values
    shape = signal.shape
    water = np.array([fit.signal for fit in fits]).reshape(shape)
    common = _stacked([fit.common for fit in fits], shape)
    stray = _stacked([fit.fluctuation for fit in fits], shape)
    target = interference.target_signal(signal, water)
    residual, present = None, np.ones(shape)
    hidden = column.hidden_share(cube, target)
    if hidden is not None:
        # Once more with the target's phase mended by the first estimate.
        hidden = column.hidden_share(cube, target + hidden * water)
    if hidden is not None:
        residual = -hidden * water
        present = np.abs(1 - hidden) ** 2
    total = covariance_of(cube) + stray.scaled(present) + common
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


_FEWEST_SHOTS = 3


def _fit_all(cube: xr.Dataset, shots: xr.Dataset) -> list[reference.Reference]:
    """Return the fits, modulation frequency by frequency, channel by channel."""
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
    usable = np.isfinite(signal)
    fits = []
    for index in np.ndindex(signal.shape[:2]):
        use = usable[index]
        if use.sum() < _FEWEST_SHOTS:
            frequency = float(cube["modulation_frequency"][index[0]]) / 1e6
            raise CubeError(
                f"only {use.sum()} open-water shots at {frequency:g} MHz in channel "
                f"{cube['polarization'].values[index[1]]} are numbers, needed are "
                f"{_FEWEST_SHOTS}; record more"
            )
        own = Covariance(
            errors.in_phase[index][use],
            errors.quadrature[index][use],
            errors.cross[index][use],
        )
        fits.append(reference.fit(signal[index][use], own, places[use], pixels))
    return fits


def _stacked(parts: list[Covariance], shape: tuple[int, ...]) -> Covariance:
    return Covariance(
        *(
            np.array([getattr(part, name) for part in parts]).reshape(shape)
            for name in ("in_phase", "quadrature", "cross")
        )
    )
