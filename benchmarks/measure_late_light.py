"""Delay of echoes by scattered light: formula and independent photons, as a table.

Usage: python benchmarks/measure_late_light.py FILE [PHOTONS]. Distance 2.5 m, a quarter
of the attenuation is absorption. Rows that FILE has are not computed again.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from amulor.optics.late_echo import late_echo, sharp_receiver_late_echo
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
)
from amulor.optics.phase_functions.tables import petzold

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))
from late_photons import late_range

COLUMNS = (
    "phase_function", "receiver", "lengths", "frequency_mhz", "photons_mm",
    "standard_error_mm", "formula_mm", "ratio",
)  # fmt: skip
DEPTH, RADIUS, INDEX, FREQUENCY = 2.5, 0.02, 1.38, np.array([50e6, 200e6, 500e6])
FUNCTIONS = {
    "henyey-greenstein": henyey_greenstein_function(asymmetry=0.95),
    "fournier-forand": fournier_forand(relative_index=1.1, slope=3.5835),
    "petzold": petzold("HAOCE 11"),
    "petzold harbor": petzold("NUC 2040"),
    # The constant of the formula was fitted without these two.
    "henyey-greenstein 0.90": henyey_greenstein_function(asymmetry=0.9),
    "henyey-greenstein 0.99": henyey_greenstein_function(asymmetry=0.99),
}
#: Field of view [rad], distance from the laser [m], and whether edges are sharp.
RECEIVERS = {
    "narrow": (0.02, 0.0, False),
    "narrow sharp": (0.02, 0.0, True),
    "wide": (0.08, 0.0, False),
    "aside": (0.08, 0.2, False),
    "aside sharp": (0.08, 0.2, True),
}


def compared(
    function: str, receiver: str, lengths: int, photons: int
) -> list[dict[str, Any]]:
    """Compute the delay of one case by photons and by the formula, per frequency."""
    water = FUNCTIONS[function]
    acceptance, aside, sharp = RECEIVERS[receiver]
    scattering, absorption = 0.75 * lengths / DEPTH, 0.25 * lengths / DEPTH
    angle = np.concatenate([[0.0], np.geomspace(1e-7, np.pi, 100_000)])
    by_photons, error = late_range(
        2 * np.pi * FREQUENCY * INDEX / speed_of_light,
        depth=DEPTH,
        scattering=scattering,
        absorption=absorption,
        angle=angle,
        cumulative=np.asarray(water.cumulative(angle)),
        receiver_radius=RADIUS,
        acceptance_angle=acceptance,
        aside=aside,
        sharp=sharp,
        photons=photons,
    )
    formula = sharp_receiver_late_echo if sharp else late_echo
    late = formula(
        FREQUENCY,
        depth=DEPTH,
        scattering=scattering,
        absorption=absorption,
        phase_function=water,
        group_index=INDEX,
        baseline=aside,
        tilt=aside / DEPTH,
        receiver_radius=RADIUS,
        acceptance_angle=acceptance,
    )
    rows = zip(FREQUENCY, by_photons, error, late, strict=True)
    return [
        dict(
            zip(
                COLUMNS,
                (
                    function, receiver, lengths, round(f / 1e6), f"{1e3 * mc:.4f}",
                    f"{1e3 * e:.4f}", f"{1e3 * product:.4f}", f"{product / mc:.3f}",
                ),
                strict=True,
            )
        )
        for f, mc, e, product in rows
    ]  # fmt: skip


def main() -> None:
    """Append the cases that the table lacks."""
    file = Path(sys.argv[1])
    photons = int(sys.argv[2]) if len(sys.argv) > 2 else 150_000
    done = set()
    if file.exists():
        with file.open(newline="") as lines:
            done = {
                (row["phase_function"], row["receiver"], int(row["lengths"]))
                for row in csv.DictReader(lines)
            }
    else:
        file.write_text(",".join(COLUMNS) + "\n")
    for lengths in (6, 3, 1, 5, 7, 9, 12):
        for function in FUNCTIONS:
            for receiver in RECEIVERS:
                if (function, receiver, lengths) in done:
                    continue
                rows = compared(function, receiver, lengths, photons)
                with file.open("a", newline="") as out:
                    csv.DictWriter(out, COLUMNS).writerows(rows)


if __name__ == "__main__":
    main()
