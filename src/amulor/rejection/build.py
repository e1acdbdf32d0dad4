"""Target-signal cubes: the common output of all rejection methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube.schema import PHASE_PREFIX
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance, phase_uncertainties


def signal_variables(
    signal: NDArray[np.complex128], uncertainty: Covariance
) -> dict[str, NDArray[Any]]:
    """Return the variables of a signal and its errors."""
    return {
        "in_phase": signal.real,
        "quadrature": signal.imag,
        "in_phase_uncertainty": np.sqrt(uncertainty.in_phase),
        "quadrature_uncertainty": np.sqrt(uncertainty.quadrature),
        "in_phase_quadrature_covariance": uncertainty.cross,
    }


def common_variables(common: Covariance | None) -> dict[str, NDArray[Any]]:
    """Return the variables of the errors that pixels share; none without."""
    if common is None:
        return {}
    return {
        "common_in_phase_uncertainty": np.sqrt(common.in_phase),
        "common_quadrature_uncertainty": np.sqrt(common.quadrature),
        "common_covariance": common.cross,
    }


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
    tests: Mapping[str, NDArray[Any]] | None = None,
    water_is_in: bool = False,
    step: str,
    **attributes: Any,
) -> xr.Dataset:
    """Build the target-signal cube that a rejection method returns.

    The signals and their errors have the shape of `samples`. `common` is the part of
    the errors that the pixels share, `proportional` the part that cannot make a target
    out of nothing (see `quality.flags`), `residual` the estimated residual water
    signal; `water_is_in` says that no water was subtracted. `terms` are the errors by
    their terms, of `amulor.cube.schema.SIGNAL_TERMS`, chosen by `present_terms`;
    `tests` are statistics behind flags, of `SAMPLE_TESTS` and `PIXEL_TESTS`.
    """
    saturated = None
    if "saturated" in samples:
        saturated = samples["saturated"].values
    flags = quality.flags(
        None if saturated is None else saturated != 0,
        target_signal,
        uncertainty,
        residual=residual,
        proportional=proportional,
        water_is_in=water_is_in,
    )
    variables: dict[str, NDArray[Any]] = {
        **signal_variables(target_signal, uncertainty),
        "water_in_phase": water_signal.real,
        "water_quadrature": water_signal.imag,
        "quality_flag": flags.flag,
        "water_residual_cause": flags.cause,
        **{
            name: test.astype(np.float32)
            for name, test in (flags.tests | dict(tests or {})).items()
        },
    }
    if saturated is not None:
        variables["saturated"] = saturated
    if residual is not None:
        variables |= {
            "residual_in_phase": residual.real,
            "residual_quadrature": residual.imag,
        }
    variables |= common_variables(common)
    for name, phase in phase_uncertainties(target_signal, terms or {}).items():
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


def present_terms(
    terms: Mapping[str, Covariance], selected: tuple[str, ...] | None = None
) -> dict[str, Covariance]:
    """Return the selected error terms by name; without selection, the nonzero terms."""
    return {
        name: errors
        for name, errors in terms.items()
        if (
            errors.in_phase.any() or errors.quadrature.any()
            if selected is None
            else name in selected
        )
    }


def saturated_in_any(first: xr.Dataset, channels: xr.Dataset) -> xr.Dataset:
    """Return the first channel, flagged saturated where any channel is saturated."""
    if "saturated" not in channels:
        return first
    worst = channels["saturated"].values.max(axis=1, keepdims=True)
    return first.assign(saturated=first["saturated"].copy(data=worst))
