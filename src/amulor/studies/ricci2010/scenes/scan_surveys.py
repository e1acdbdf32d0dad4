"""Surveys of the simulated scans: the paper's instrument, target and water."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import xarray as xr

from amulor import imaging
from amulor.studies.ricci2010.scenes.water_sweeps import forward_fraction
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey
from amulor.units import write


@dataclass(frozen=True, kw_only=True)
class ScanWater:
    """Optical properties of the water in a scan."""

    attenuation: float
    """Attenuation coefficient [1/m]."""
    second_moment: float
    """Mean square angle of forward scattering [rad^2]."""
    backscatter: float
    """Phase function at 180 degrees [1/sr]."""
    m22: float
    """Mueller element m22 of backscattering [1]."""
    fluctuation: float
    """Relative fluctuation of the water signal from sample to sample [1]."""


@cache
def table() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the content of `scans.toml`: definitions of waters and scans."""
    path = resources.files("amulor.studies.ricci2010") / "scans.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))


def water_of(study: Study, name: str) -> ScanWater:
    """Return the named water from `scans.toml`."""
    names = table()["waters"][name]
    return ScanWater(**{field: study[number] for field, number in names.items()})


@dataclass(frozen=True, kw_only=True)
class ScanField:
    """Geometry of a scan: distance, baseline and pixel grid."""

    distance: float
    """Target distance, at which the receiver is aimed [m]."""
    baseline: float
    """Distance between receiver and beam [m]."""
    columns: int
    """Number of pixels per line [1]."""
    rows: int
    """Number of lines [1]."""
    width: float
    """Azimuth span [rad]."""
    height: float
    """Elevation span [rad]."""


def survey_of(
    study: Study,
    *,
    name: str,
    water: ScanWater,
    field: ScanField,
    target: str,
    polarizations: Sequence[str],
) -> Survey:
    """Return the survey of a scan with the paper's instrument."""
    fraction = study["absorption_share"]
    # A sphere straight backwards: m33 = -m22, m44 = 1 - 2 m22.
    matrix = [water.m22, -water.m22, 1 - 2 * water.m22]
    m22, m44 = study["m22_target"], study["m44_target"]

    forward = forward_fraction(water.second_moment, split_angle=study["split_angle"])

    def text(value: float, quantity: str) -> str:
        return f'"{write(value, quantity)}"'

    place = text(field.distance, "length")
    channels = ", ".join(f'"{name}"' for name in polarizations)
    return Survey.from_text(f"""
name = "{name}"
[water]
absorption = {text(fraction * water.attenuation, "attenuation coefficient")}
scattering = {text((1 - fraction) * water.attenuation, "attenuation coefficient")}
forward_fraction = {forward}
second_moment = {text(water.second_moment, "angle squared")}
phase_function_at_180 = {text(water.backscatter, "solid-angle density")}
refractive_index = {study["index"]}
group_index = {study["index"]}
backscatter_mueller = {matrix}
signal_fluctuation = {water.fluctuation}
[[targets]]
position = ["0 m", "0 m", {place}]
reflectance = {study["ladder_reflectance"]}
mueller = [{m22}, {-m22}, {m44}]
{target}
[instrument]
phase_uncertainty = "0 deg"
wavelength = {text(study["wavelength"], "length")}
power = {text(study["power"], "power")}
modulation_depth = {study["modulation_depth"]}
modulation_frequencies = [{text(study["frequency"], "frequency")}]
polarizations = [{channels}]
[instrument.receiver]
position = [{text(field.baseline, "length")}, "0 m", "0 m"]
azimuth = {text(-math.atan2(field.baseline, field.distance), "angle")}
radius = {text(study["receiver_radius"], "length")}
acceptance = {text(study["acceptance"], "angle")}
[instrument.detector]
optical_transmission = {study["optical_transmission"]}
saturation = "1e3 V"
[instrument.lock_in]
time_constant = {text(study["lock_in_time_constant"], "time")}
phase_floor = {text(study["scan_phase_floor"], "angle")}
[scan]
columns = {field.columns}
rows = {field.rows}
azimuth_span = {text(field.width, "angle")}
elevation_span = {text(field.height, "angle")}
dwell = {text(study["dwell"], "time")}
[scan.open_water]
columns = 9
rows = 3
repeats = {round(study["open_water_repeats"])}
""")


def around(distance: float) -> tuple[float, float]:
    """Return range limits 1 m around a target distance, at least 0.2 m [m]."""
    return max(distance - 1.0, 0.2), distance + 1.0


def images(
    target: xr.Dataset, *, interval: tuple[float, float]
) -> dict[str, xr.Dataset]:
    """Return the range images of a target signal, by channel."""
    return {
        channel: imaging.range_image(target, polarization=channel, interval=interval)
        for channel in map(str, target["polarization"].values)
    }
