"""Writes the target-signal cubes that all methods return."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._decisions import decided
from amulor.cube.terms import PHASE_PREFIX
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance, phase_uncertainties


def target_cube(
    samples: xr.Dataset,
    target_signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    water_signal: NDArray[np.complex128],
    residual: NDArray[np.complex128] | None = None,
    common: Covariance | None = None,
    proportional: Covariance | None = None,
    terms: Mapping[str, Covariance] | None = None,
    water_is_in: bool = False,
    step: str,
    **attributes: Any,
) -> xr.Dataset:
    """Make the cube that a rejection method returns.

    Parameters
    ----------
    samples : xarray.Dataset
        What was measured; coordinates, attributes and truth are passed on.
    target_signal, water_signal : ndarray of complex
        The two parts of the signal [V].
    uncertainty : Covariance
        Errors of the target signal, all of them.
    residual : ndarray of complex, optional
        Water signal that is estimated to be left in [V].
    common : Covariance, optional
        The part of the errors that the pixels share.
    proportional : Covariance, optional
        The part of the errors that cannot make a target out of nothing, see
        `quality.flags`.
    terms : mapping of str to Covariance, optional
        All errors by their terms, of `amulor.cube.terms.SIGNAL_TERMS`; those that are
        zero everywhere are left out.
    water_is_in : bool
        True if no water signal was taken out.
    step : str
        Line for the history.
    **attributes
        Further global attributes.

    Returns
    -------
    xarray.Dataset
        Cube of level `target_signal`.
    """
    variables: dict[str, NDArray[Any]] = {
        "in_phase": target_signal.real,
        "quadrature": target_signal.imag,
        "in_phase_uncertainty": np.sqrt(uncertainty.in_phase),
        "quadrature_uncertainty": np.sqrt(uncertainty.quadrature),
        "in_phase_quadrature_covariance": uncertainty.cross,
        "water_in_phase": water_signal.real,
        "water_quadrature": water_signal.imag,
        "quality_flag": quality.flags(
            samples,
            target_signal,
            uncertainty,
            residual=residual,
            proportional=proportional,
            water_is_in=water_is_in,
        ),
    }
    if "saturated" in samples:
        variables["saturated"] = samples["saturated"].values
    if residual is not None:
        variables |= {
            "residual_in_phase": residual.real,
            "residual_quadrature": residual.imag,
        }
    if common is not None:
        variables |= {
            "common_in_phase_uncertainty": np.sqrt(common.in_phase),
            "common_quadrature_uncertainty": np.sqrt(common.quadrature),
            "common_covariance": common.cross,
        }
    known = decided(
        "terms of the error",
        lambda: [
            name
            for name, errors in (terms or {}).items()
            if errors.in_phase.any() or errors.quadrature.any()
        ],
    )
    present = {name: errors for name, errors in (terms or {}).items() if name in known}
    for name, phase in phase_uncertainties(target_signal, present).items():
        variables[f"{PHASE_PREFIX}{name}"] = phase
    if water_is_in:
        attributes["error_unknown"] = cubes.WATER_NOT_REMOVED
    if "shot" in samples.sizes:
        attributes.setdefault("open_water_shots", np.int32(samples.sizes["shot"]))
    geometry = samples.amulor.geometry
    target = cubes.build(
        "target_signal",
        variables,
        {
            str(name): samples[name].values
            for name in samples.coords
            if name != "geometry"
        },
        geometry={
            key: value
            for key, value in geometry.items()
            if key not in ("long_name", "units")
        },
        attributes={**samples.attrs, "level": "target_signal", **attributes},
    )
    truth = samples.amulor.truth
    if truth is not None:
        target = cubes.attach(target, truth, "truth")
    return cubes.note(target, step)


def saturated_in_any(first: xr.Dataset, channels: xr.Dataset) -> xr.Dataset:
    """Return a channel that counts as saturated where any of several channels is.

    Parameters
    ----------
    first : xarray.Dataset
        Level `samples`, one channel, which stands for all in the result.
    channels : xarray.Dataset
        The same samples, all channels that the result is made from.

    Returns
    -------
    xarray.Dataset
        `first` with the largest `saturated`; as it is, if the cube does not say.
    """
    if "saturated" not in channels:
        return first
    worst = channels["saturated"].values.max(axis=1, keepdims=True)
    return first.assign(saturated=first["saturated"].copy(data=worst))
