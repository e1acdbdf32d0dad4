"""Reads errors out of cubes and writes target-signal cubes; shared by all methods."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.rejection import quality
from amulor.rejection.reference.fit import Covariance


def covariance_of(samples: xr.Dataset) -> Covariance:
    """Return the stated errors of samples or shots.

    Parameters
    ----------
    samples : xarray.Dataset
        With `in_phase_uncertainty`, `quadrature_uncertainty` and perhaps
        `in_phase_quadrature_covariance`.

    Returns
    -------
    Covariance
        Arrays of the shape of the samples.
    """
    cross = samples.get("in_phase_quadrature_covariance")
    in_phase = samples["in_phase_uncertainty"].values ** 2
    return Covariance(
        in_phase,
        samples["quadrature_uncertainty"].values ** 2,
        np.zeros_like(in_phase) if cross is None else cross.values,
    )


def along(signal: NDArray[np.complex128], size: float) -> Covariance:
    """Return the covariance of an error that stretches a signal by a random factor.

    Parameters
    ----------
    signal : ndarray of complex
        What is stretched [V].
    size : float
        Standard deviation of the factor [1].

    Returns
    -------
    Covariance
        Arrays of the shape of the signal.
    """
    return Covariance(
        (size * signal.real) ** 2,
        (size * signal.imag) ** 2,
        size**2 * signal.real * signal.imag,
    )


def target_cube(
    samples: xr.Dataset,
    target_signal: NDArray[np.complex128],
    uncertainty: Covariance,
    *,
    water_signal: NDArray[np.complex128],
    residual: NDArray[np.complex128] | None = None,
    common: Covariance | None = None,
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
