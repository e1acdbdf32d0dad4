"""Computes the tables that the figures of docs/learn look up in the browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from amulor.optics import detection, low_pass, small_angle, target_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function

FILE = Path(__file__).parent / "_static" / "learn" / "tables.js"
ATTENUATION = [0.1, 0.2, 0.4, 0.8, 1.2, 1.6]  # [1/m]
ABSORBED = 0.3  # of the attenuation
FREQUENCY = np.arange(0, 201, 2)  # [MHz]
DISTANCE = np.arange(0.5, 6.01, 0.25)  # [m]
GROUP_INDEX = 1.38
INSTRUMENT = {
    "baseline": 0.07,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
    "tilt": 0.035,
}
POWER, TRANSMISSION, EFFICIENCY = 20e-3, 0.1, 0.25  # [W], [1], [1]


def tables() -> dict[str, Any]:
    """Return what the figures need: open water, echoes and photoelectrons."""
    water, echo, cut_off = [], [], []
    for attenuation in ATTENUATION:
        column: dict[str, Any] = {
            "absorption": ABSORBED * attenuation,
            "scattering": (1 - ABSORBED) * attenuation,
            "phase_function": henyey_greenstein_function(asymmetry=0.95),
            "split_angle": np.pi / 2,
            **INSTRUMENT,
        }

        def response(frequency: Any, column: dict[str, Any] = column) -> Any:
            return small_angle.water_response(
                frequency, group_index=GROUP_INDEX, **column
            )

        water.append(response(FREQUENCY * 1e6))
        cut_off.append(low_pass.cut_off(response) / 1e6)
        echo.append(
            target_echo.small_angle_target_response(
                0.0, depth=DISTANCE, optical_path=0.0, reflectance=1.0, **column
            ).real
        )
    rate = detection.photoelectron_rate(
        POWER * TRANSMISSION, wavelength=405e-9, quantum_efficiency=EFFICIENCY
    )
    return {
        "attenuation": ATTENUATION,
        "frequency": FREQUENCY.tolist(),
        "distance": DISTANCE.tolist(),
        "groupIndex": GROUP_INDEX,
        "inPhase": _short(np.real(water)),
        "quadrature": _short(np.imag(water)),
        "echo": _short(np.array(echo)),
        "cutOff": _short(np.array(cut_off)),
        "photoelectrons": float(f"{float(rate):.6g}"),
    }


def _short(values: Any) -> Any:
    """Return nested lists of six digits."""
    if np.ndim(values):
        return [_short(value) for value in values]
    return float(f"{float(values):.6g}")


def main() -> None:
    """Write the tables as a script, which a page opened from a disk may load too."""
    text = json.dumps(tables(), separators=(",", ":"))
    FILE.write_text(f"window.amulorTables={text};\n")


if __name__ == "__main__":
    main()
