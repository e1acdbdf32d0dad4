"""Polarized light of water and of a painted plate, by photon transport.

`python tests/oracles/polarized_light.py` writes the table
`tests/reference/polarized_light.csv`. It takes about 15 minutes. The light is launched
with vertical polarization (V), and received behind a parallel (V) and a crossed (H)
analyzer. Single scattering backwards depolarizes by 12 %, and so does multiple
scattering of the particles, whose matrices are those of small spheres.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from amulor.optics import rays
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.polarization import mueller
from amulor.transport import (
    GaussianReceiver,
    Medium,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    simulate,
)

TABLE = Path(__file__).parents[1] / "reference" / "polarized_light.csv"
FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
GROUP_INDEX, BASELINE = 1.38, 0.2
#: Absorption and scattering [1/m], phase function, distances of the plate [m].
WATERS = {
    "harbor": (0.366, 1.824, lambda: petzold("NUC 2040"), (0.91, 1.37, 2.28)),
    "coastal": (0.179, 0.219, lambda: petzold("HAOCE 11"), (2.5,)),
    "milk": (0.05, 0.8, lambda: henyey_greenstein_function(asymmetry=0.9), (1.5,)),
    "strong milk": (
        0.05,
        2.65,
        lambda: henyey_greenstein_function(asymmetry=0.9),
        (1.5,),
    ),
}
HISTORIES = 1_500_000


def scattering_matrix(function: PhaseFunction) -> ScatteringMatrix:
    """Return matrices of small spheres, mixed with an ideal depolarizer."""
    angle = np.linspace(0, np.pi, 721)
    share = 0.12 * (1 - np.cos(angle)) / 2
    matrix = (1 - share)[:, None, None] * mueller.rayleigh(angle)
    matrix += share[:, None, None] * np.diag([1.0, 0, 0, 0])
    return ScatteringMatrix.tabulated(angle, mueller=matrix, phase_function=function)


def main() -> None:
    """Compute the table."""
    receiver = GaussianReceiver(
        position=np.array([BASELINE, 0.0, 0.0]),
        direction=rays.direction(np.radians(-4.0), 0.0),
        radius=0.02,
        acceptance_angle=0.08,
    )
    rows = []
    for name, (absorption, scattering, function, distances) in WATERS.items():
        medium = Medium.homogeneous(
            absorption=absorption,
            scattering=scattering,
            phase_function=scattering_matrix(function()),
            group_index=GROUP_INDEX,
        )
        for distance in (0.0, *distances):
            plate = PlaneTarget(
                position=(0, 0, distance),
                reflectance=0.1,
                mueller=mueller.painted_metal(),
            )
            tally = simulate(
                medium,
                Source(polarization="V"),
                receiver,
                np.concatenate([[0.0], FREQUENCY]),
                histories=HISTORIES,
                seed=1,
                target=plate if distance else None,
            )
            for light in ("water", "target") if distance else ("water",):
                for analyzer in "VH":
                    passed = tally.passed(light, analyser=analyzer)
                    mean = tally.histories_of / tally.histories @ passed
                    rows.extend(
                        (
                            name,
                            distance,
                            light,
                            analyzer,
                            f,
                            f"{m.real:.6e}",
                            f"{m.imag:.6e}",
                        )
                        for f, m in zip(FREQUENCY, mean[1:], strict=True)
                    )
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            (
                "water",
                "distance_m",
                "light",
                "analyzer",
                "frequency_hz",
                "real",
                "imaginary",
            )
        )
        writer.writerows(rows)


if __name__ == "__main__":
    main()
