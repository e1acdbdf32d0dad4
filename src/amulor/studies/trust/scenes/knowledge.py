"""Scenes with survey errors: wrong water, geometry or group index."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import xarray as xr

from amulor.simulation import simulate
from amulor.studies.trust.case import Case, case_of
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.surveys import plate, scaled, survey
from amulor.survey import Survey
from amulor.survey.view import geometry_attributes

_TARGET = plate(2.6, lean=20)


def believing(samples: xr.Dataset, believed: Survey) -> xr.Dataset:
    """Return a copy of a cube with another survey and its geometry attributes."""
    geometry = samples["geometry"].copy()
    geometry.attrs |= geometry_attributes(believed)
    return samples.assign_coords(geometry=geometry).assign_attrs(
        survey=believed.to_toml()
    )


def _wrong(count: int, seed: int, **believed: Any) -> Case:
    samples = simulate(survey(count, _TARGET), rng=seed)
    return case_of(
        believing(samples, survey(count, _TARGET, **believed)), interval=around(2.6)
    )


def wrong_turbidity(count: int, seed: int, *, factor: float) -> Case:
    """Simulate a plate scan with absorption and scattering misstated by `factor`."""
    return _wrong(count, seed, water=scaled("tank", factor))


def wrong_baseline(count: int, seed: int, *, by: float = 0.5) -> Case:
    """Simulate a plate scan with a baseline stated too long by `by` [cm]."""
    return _wrong(count, seed, baseline=20 + by)


def wrong_axis(count: int, seed: int, *, by: float = 1.0) -> Case:
    """Simulate a plate scan with the receiver azimuth misstated by `by` degrees."""
    return _wrong(count, seed, azimuth=-4.0 + by)


def wrong_index(count: int, seed: int, *, by: float = 0.002) -> Case:
    """Simulate a plate scan with the group index of the water overstated."""
    return _wrong(count, seed, group_index=1.38 + by)


#: What a careful user states of the instrument, one standard uncertainty each.
_CALIBRATION = {
    "delay_uncertainty": "0.1 ns",
    "receiver_position_uncertainty": "5 mm",
    "direction_uncertainty": "0.2 deg",
    "group_index_uncertainty": 0.002,
}


def calibrated(count: int, seed: int, *, make: Callable[[int, int], Case]) -> Case:
    """Return the case from `make`, with calibration uncertainties in its survey."""
    case = make(count, seed)
    believed = case.samples.amulor.survey
    with_calibration = believed.with_({"calibration": _CALIBRATION})
    return replace(
        case, samples=case.samples.assign_attrs(survey=with_calibration.to_toml())
    )
