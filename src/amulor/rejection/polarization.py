"""Tells target from water by polarization: water keeps it, painted targets lose it."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.rejection.build import covariance_of, target_cube
from amulor.rejection.open_water import fit_shots
from amulor.rejection.reference import Covariance, fluctuation, stacked

#: Channels in which backscatter of spheres is dark. A mirror-like return keeps V and H,
#: but swaps +45 with -45 degrees and right with left, in the axes of its own light.
CROSS_POLARIZED = ("VH", "HV", "PP", "MM", "RR", "LL")
#: Channels in which it is bright.
CO_POLARIZED = ("VV", "HH", "PM", "MP", "RL", "LR")
_PARTNERS = dict(zip(CO_POLARIZED, CROSS_POLARIZED, strict=True))


def keep_water(cube: xr.Dataset) -> xr.Dataset:
    """Pass samples on with the water signal in them, flagged as such.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`, every sample flagged `NO_OPEN_WATER`: what a picture
        looks like before rejection.
    """
    cubes.check(cube, "samples")
    return _unchanged(cube, step="reject, nothing taken out")


def cross_polarized(cube: xr.Dataset) -> xr.Dataset:
    """Choose the channels in which the water is dark.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a crossed linear or an equal circular pair.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with these channels only. The water signal that is left
        is not known, so every sample is flagged `NO_OPEN_WATER`.

    Raises
    ------
    CubeError
        If there is no such channel.
    """
    return _chosen(cube, CROSS_POLARIZED, name="cross-polarized")


def co_polarized(cube: xr.Dataset) -> xr.Dataset:
    """Choose the channels in which target and water are bright.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with an equal linear or a crossed circular pair.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with these channels only, flagged `NO_OPEN_WATER`.

    Raises
    ------
    CubeError
        If there is no such channel.
    """
    return _chosen(cube, CO_POLARIZED, name="co-polarized")


def unmix(
    cube: xr.Dataset,
    *,
    target_ratio: float,
    water_ratio: float,
    target_ratio_uncertainty: float = 0.0,
    water_ratio_uncertainty: float = 0.0,
    water_fluctuation: float | None = None,
) -> xr.Dataset:
    r"""Separate target and water by their known depolarization ratios.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel and its cross-polarized partner.
    target_ratio, water_ratio : float
        Cross-polarized over co-polarized signal of target and water, between 0 and 1
        and different from each other; :math:`(1 - m_{22}) / (1 + m_{22})` for linear
        light on a diagonal Mueller matrix [1].
    target_ratio_uncertainty, water_ratio_uncertainty : float
        Their standard uncertainties; their share of the error is common to all
        pixels [1].
    water_fluctuation : float, optional
        Relative change of the water signal from sample to sample, which differs in
        the two channels since they are measured one after the other [1]. Taken from
        the open-water shots by default, and needed if the cube has none.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the co-polarized one.

    Raises
    ------
    CubeError
        If the two channels are not there, or nothing tells how the water fluctuates.
    ValueError
        If the ratios are equal or out of range: then no unmixing is possible.

    Notes
    -----
    With co-polarized :math:`A = T + W` and cross-polarized
    :math:`B = r_t T + r_w W`, :math:`T = (B - r_w A) / (r_t - r_w)`.
    """
    cubes.check(cube, "samples")
    for name, ratio in (("target_ratio", target_ratio), ("water_ratio", water_ratio)):
        if not 0 <= ratio <= 1:
            raise ValueError(f"{name} must lie between 0 and 1, got {ratio:g}")
    contrast = target_ratio - water_ratio
    if abs(contrast) < _SMALLEST_CONTRAST:
        raise ValueError(
            f"target_ratio ({target_ratio:g}) and water_ratio ({water_ratio:g}) are "
            f"closer than {_SMALLEST_CONTRAST:g}; polarization cannot tell them apart"
        )
    co, cross = _pair(cube)
    first, second = cube.sel(polarization=[co]), cube.sel(polarization=[cross])
    a, b = first.amulor.signal.values, second.amulor.signal.values
    target = (b - water_ratio * a) / contrast
    water = a - target
    strays = [
        _stray(part, water, water_fluctuation).scaled((water_ratio / contrast) ** 2)
        for part in (first, second)
    ]
    independent = covariance_of(second).scaled(contrast**-2) + covariance_of(
        first
    ).scaled((water_ratio / contrast) ** 2)
    if "saturated" in cube:
        either = np.maximum(first["saturated"].values, second["saturated"].values)
        first = first.assign(saturated=first["saturated"].copy(data=either))
    # dT/dr_t = -T / contrast and dT/dr_w = -W / contrast.
    common = _along(target, target_ratio_uncertainty / contrast) + _along(
        water, water_ratio_uncertainty / contrast
    )
    return target_cube(
        first,
        target,
        independent + strays[0] + strays[1] + common,
        water_signal=water,
        common=common,
        step=f"reject, unmix {co} and {cross}, ratios of target {target_ratio:g}, "
        f"of water {water_ratio:g}",
    )


_SMALLEST_CONTRAST = 1e-3


def _stray(
    channel: xr.Dataset, water: NDArray[np.complex128], stated: float | None
) -> Covariance:
    """Return how the water signal of one channel strays, per unit of co-polarized."""
    if stated is not None:
        return _along(water, stated)
    shots = channel.amulor.open_water
    if shots is None:
        raise CubeError(
            "the cube has no open-water shots to tell how much the water signal "
            "fluctuates; state water_fluctuation (command line: --water-fluctuation, "
            '0 for still water, such as "5 %")'
        )
    parts = [
        fluctuation(fit.relative, level.ravel())
        for fit, level in zip(fit_shots(channel, shots), water[:, 0], strict=True)
    ]
    return stacked(parts, water.shape)


def _along(signal: NDArray[np.complex128], size: float) -> Covariance:
    """Return the covariance of an error that stretches a signal by a random factor."""
    return Covariance(
        (size * signal.real) ** 2,
        (size * signal.imag) ** 2,
        size**2 * signal.real * signal.imag,
    )


def _pair(cube: xr.Dataset) -> tuple[str, str]:
    present = [str(value) for value in cube["polarization"].values]
    for co, cross in _PARTNERS.items():
        if co in present and cross in present:
            return co, cross
    listed = ", ".join("+".join(pair) for pair in _PARTNERS.items())
    raise CubeError(
        f"the cube has the channels {', '.join(present)}, but unmixing needs one of "
        f"the pairs {listed}; record both analyser positions"
    )


def _chosen(cube: xr.Dataset, channels: tuple[str, ...], *, name: str) -> xr.Dataset:
    cubes.check(cube, "samples")
    present = [str(value) for value in cube["polarization"].values]
    chosen = [channel for channel in present if channel in channels]
    if not chosen:
        raise CubeError(
            f"the cube has the channels {', '.join(present)}, none of which is "
            f"{name} ({', '.join(channels)}); record one, or use another method"
        )
    return _unchanged(
        cube.sel(polarization=chosen),
        step=f"reject, {name} channel {', '.join(chosen)}",
    )


def _unchanged(cube: xr.Dataset, *, step: str) -> xr.Dataset:
    signal = cube.amulor.signal.values
    return target_cube(
        cube,
        signal,
        covariance_of(cube),
        water_signal=np.zeros_like(signal),
        water_is_in=True,
        step=step,
    )
