"""Surveys of the trust study: various waters and targets, common instrument."""

from __future__ import annotations

from typing import Any

from amulor.survey import Survey

#: Frequencies by their number: one, two, four of a handy instrument, a sweep [Hz].
FREQUENCIES: dict[int, tuple[float, ...]] = {
    1: (50e6,),
    2: (20e6, 80e6),
    4: (10e6, 35e6, 80e6, 146e6),
    16: tuple(5e6 + 9.4e6 * k for k in range(16)),
}

#: Waters by name: a, b [1/m] and the forward part of a Henyey-Greenstein function of
#: the asymmetry given, split at 15 degrees: its share [1], its second moment [rad^2]
#: and the function straight backwards [1/sr].
WATERS: dict[str, dict[str, float]] = {
    # The long tank of Ricci et al. 2010, section 8, experiment 1.
    "tank": {
        "absorption": 0.15,
        "scattering": 0.35,
        "forward_fraction": 0.95,
        "second_moment": 0.05,
        "phase_function_at_180": 0.003,
    },
    # Petzold's coastal and harbour waters: a and b of Mobley 1994, table 3.10.
    "coastal": {
        "absorption": 0.179,
        "scattering": 0.219,
        "forward_fraction": 0.85,
        "second_moment": 0.012,
        "phase_function_at_180": 0.004,
    },
    "harbour": {
        "absorption": 0.366,
        "scattering": 1.824,
        "forward_fraction": 0.85,
        "second_moment": 0.012,
        "phase_function_at_180": 0.005,
    },
}

_TEXT = """
name = "{name}"
[water]
{water}
refractive_index = 1.34
group_index = {group_index}
backscatter_mueller = [0.81, -0.81, -0.62]
signal_fluctuation = "{fluctuation} %"
{targets}
[instrument]
phase_uncertainty = "0 deg"
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = [{frequencies}]
polarizations = [{pairs}]
[instrument.receiver]
position = ["{baseline} cm", "0 m", "0 m"]
azimuth = "{azimuth} deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
saturation = "100 V"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.1 deg"
[scan]
columns = {columns}
rows = {rows}
azimuth_span = "{wide} deg"
elevation_span = "{tall} deg"
dwell = "125 ms"
[scan.open_water]
columns = {shot_columns}
rows = {shot_rows}
repeats = {repeats}
"""
_UNITS = {
    "absorption": "1/m",
    "scattering": "1/m",
    "second_moment": "rad^2",
    "phase_function_at_180": "1/sr",
    "split_angle": "deg",
}


def plate(
    distance: float, *, lean: float = 0.0, reflectance: float = 0.1, size: float = 2.0
) -> str:
    """Return TOML text of a plate, rotated by `lean` degrees about the vertical."""
    return (
        f'[[targets]]\nkind = "plate"\nposition = ["0 m", "0 m", "{distance} m"]\n'
        f'rotation = ["0 deg", "{lean} deg", "0 deg"]\nwidth = "{size} m"\n'
        f'height = "{size} m"\nreflectance = {reflectance}'
    )


def corner(distance: float, *, reflectance: float, right: float = 0.0) -> list[str]:
    """Return TOML texts of two walls at right angles, from the distance of their edge.

    The walls are 0.3 m wide and high, and face the instrument at 45 degrees.
    """
    half = 0.15 / 2**0.5
    return [
        f'[[targets]]\nkind = "plate"\nposition = ["{right + side * half:.5f} m", '
        f'"0 m", "{distance - half:.5f} m"]\n'
        f'rotation = ["0 deg", "{side * 45} deg", "0 deg"]\n'
        f'width = "0.3 m"\nheight = "0.3 m"\nreflectance = {reflectance}'
        for side in (-1, 1)
    ]


def stairs(distance: float, *, reflectance: float, tread: float = 0.03) -> str:
    """Return TOML text of a staircase of five treads."""
    return (
        f'[[targets]]\nkind = "staircase"\n'
        f'position = ["0 m", "0 m", "{distance} m"]\ntread_width = "{tread} m"\n'
        'step_heights = ["4 cm", "3 cm", "2 cm", "1 cm"]\nheight = "2 m"\n'
        f"reflectance = {reflectance}"
    )


def survey(
    count: int,
    *targets: str,
    water: dict[str, float] | str = "tank",
    frequencies: tuple[float, ...] | None = None,
    pairs: tuple[str, ...] = ("VV", "VH"),
    **others: Any,
) -> Survey:
    """Return the survey of a scan, of 24 x 16 pixels by default."""
    properties = WATERS[water] if isinstance(water, str) else water
    chosen = FREQUENCIES[count] if frequencies is None else frequencies
    lines = [
        f'{name} = "{value} {_UNITS[name]}"' if name in _UNITS else f"{name} = {value}"
        for name, value in properties.items()
    ]
    values: dict[str, Any] = {
        "name": "Trust study",
        "group_index": 1.38,
        "fluctuation": 2.0,
        "baseline": 20,
        "azimuth": -4.0,
        "columns": 24,
        "rows": 16,
        "wide": 4,
        "tall": 3,
        "shot_columns": 9,
        "shot_rows": 3,
        "repeats": 10,
    } | others
    return Survey.from_text(
        _TEXT.format(
            water="\n".join(lines),
            targets="\n".join(targets),
            frequencies=", ".join(f'"{value / 1e6:.4f} MHz"' for value in chosen),
            pairs=", ".join(f'"{pair}"' for pair in pairs),
            **values,
        )
    )


def scaled(water: str, factor: float) -> dict[str, float]:
    """Return water properties with absorption and scattering multiplied by a factor."""
    coefficients = dict(WATERS[water])
    for name in ("absorption", "scattering"):
        coefficients[name] *= factor
    return coefficients
