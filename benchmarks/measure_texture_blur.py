"""Echo of a striped plate by `simulate` beside photon transport.

    python benchmarks/measure_texture_blur.py [HISTORIES]

A stripe, 10 cm wide, with a tenth of the reflectance of its surroundings, is on a plate
3 m away. The echo is divided by that of a plate without stripe. Photon transport
follows all paths; `simulate` uses the small-angle form. Distances are the phase of the
ratio at 50 MHz: how much farther than the plain plate the stripe seems to be.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh
from scipy.constants import speed_of_light

from amulor import Survey
from amulor.optics.late_echo import late_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.simulation.geometry import Setup, trace
from amulor.transport import (
    GaussianReceiver,
    Medium,
    MeshTarget,
    PlaneTarget,
    Source,
    simulate,
)

DISTANCE, WIDTH, DARK = 3.0, 0.1, 0.1
#: Distance of the beam from the middle of the stripe [m].
OFFSETS = (0.0, 0.04, 0.06, 0.1, 0.2)
LENGTHS = (1.0, 3.0, 5.0)
FREQUENCY = np.array([0.0, 50e6, 200e6])
#: Absorption as a part of the attenuation, asymmetry and group index.
ABSORBED, ASYMMETRY, INDEX = 0.3, 0.95, 1.33
EYE = {"radius": 0.02, "acceptance_angle": 0.05, "position": (0.07, 0.0, 0.0)}


def stripes(offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return corners, faces and brightness of the faces, the beam at zero."""
    edges = np.array([-3.0, -WIDTH / 2 - offset, WIDTH / 2 - offset, 3.0])
    corners = np.array([(x, y, 0.0) for x in edges for y in (-3, 3)])
    faces = np.array(
        [[2 * k + j, 2 * k + 1 + j, 2 * k + 2 + j] for k in range(3) for j in (0, 1)]
    )
    return corners, faces, np.repeat([1.0, DARK, 1.0], 2)


def by_photons(lengths: float, histories: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return ratio of the echoes and relative error, for each offset."""
    water = Medium.homogeneous(
        absorption=ABSORBED * lengths / DISTANCE,
        scattering=(1 - ABSORBED) * lengths / DISTANCE,
        phase_function=henyey_greenstein_function(asymmetry=ASYMMETRY),
        group_index=INDEX,
    )
    place = np.array([0, 0, DISTANCE])
    targets = [PlaneTarget(position=(0, 0, DISTANCE), reflectance=0.4)]
    for offset in OFFSETS:
        corners, faces, bright = stripes(offset)
        targets.append(
            MeshTarget(
                vertices=corners + place, faces=faces, reflectance=0.4, texture=bright
            )
        )
    runs = [
        simulate(
            water, Source(), GaussianReceiver(**EYE), FREQUENCY, histories=histories,
            seed=seed, target=target, threads=1,
        )
        for seed, target in enumerate(targets, 1)
    ]  # fmt: skip
    light = [(run.target_signal, run.relative_error_of("target")) for run in runs]
    plain, error = light[0]
    return [(each / plain, np.hypot(own, error)) for each, own in light[1:]]


def by_simulate(lengths: float, folder: Path) -> list[np.ndarray]:
    """Return the ratio of the echoes for each offset."""
    ratios = []
    for offset in OFFSETS:
        corners, faces, bright = stripes(offset)
        # Each face has its own corners, so that colors do not run between faces.
        colors = np.repeat(np.round(255 * bright), 3)[:, None] * np.ones(4)
        file = folder / f"{offset}.ply"
        trimesh.Trimesh(
            corners[faces].reshape(-1, 3),
            np.arange(faces.size).reshape(-1, 3),
            vertex_colors=colors.astype(np.uint8),
            process=False,
        ).export(file)
        survey = Survey.preset("amulor-2010").with_(
            {
                "water.second_moment": None,
                "water.forward_fraction": None,
                "water.phase_function_at_180": None,
                "water.asymmetry": ASYMMETRY,
                "water.absorption": ABSORBED * lengths / DISTANCE,
                "water.scattering": (1 - ABSORBED) * lengths / DISTANCE,
                "water.group_index": INDEX,
                "instrument.modulation_frequencies": FREQUENCY[1:].tolist(),
                "instrument.polarizations": ["none"],
                "instrument.emitter": {"position": (0.0, 0.0, 0.0)},
                "instrument.receiver": {
                    "position": EYE["position"],
                    "radius": EYE["radius"],
                    "acceptance": EYE["acceptance_angle"],
                },
                "scan.columns": 1,
                "scan.rows": 1,
                "scan.azimuth": 0.0,
                "scan.elevation": 0.0,
                "targets": [
                    {
                        "kind": "mesh",
                        "file": str(file),
                        "position": (0.0, 0.0, DISTANCE),
                        "reflectance": 0.4,
                        "texture": "vertex-colours",
                    }
                ],
            }
        )
        found = trace(Setup(survey))
        assert found.surroundings is not None
        ratios.append(found.brightness.ravel()[0] + found.surroundings[:, 0, 0])
    return ratios


def delay(lengths: float) -> float:
    """Return the range error of the plate without stripe by late light [m]."""
    late = late_echo(
        FREQUENCY[1],
        depth=DISTANCE,
        absorption=ABSORBED * lengths / DISTANCE,
        scattering=(1 - ABSORBED) * lengths / DISTANCE,
        phase_function=henyey_greenstein_function(asymmetry=ASYMMETRY),
        group_index=INDEX,
        baseline=EYE["position"][0],
        receiver_radius=EYE["radius"],
        acceptance_angle=EYE["acceptance_angle"],
    )
    return float(late)


def main(histories: int) -> None:
    """Print both ratios, their difference in standard errors, and the distances."""
    per_distance = 4 * np.pi * FREQUENCY[1] * INDEX / speed_of_light
    print("| lengths | offset | photons | simulate | distance, mm | simulate, mm |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for lengths in LENGTHS:
            start = time.process_time()
            simulated = by_simulate(lengths, Path(folder))
            seconds = time.process_time() - start
            for offset, (ratio, error), model in zip(
                OFFSETS, by_photons(lengths, histories), simulated, strict=True
            ):
                size = abs(ratio[0])
                farther, by_model = (
                    1e3 * np.angle(each[1]) / per_distance for each in (ratio, model)
                )
                print(
                    f"| {lengths:g} | {100 * offset:g} cm | {size:.3f} +- "
                    f"{size * error[0]:.3f} | {model[0].real:.3f} | {farther:.2f} | "
                    f"{by_model:.2f} |",
                    flush=True,
                )
            print(f"{lengths:g} lengths: {seconds:.1f} s by simulate", file=sys.stderr)
            middle = simulated[0]
            farther = 1e3 * np.angle(middle[1]) / per_distance
            late = 1e3 * delay(lengths)
            share = farther / late / (1 / middle[0].real - 1)
            print(
                f"{lengths:g} lengths: the plain plate is {late:.1f} mm late; "
                f"the stripe is farther by {share:.2f} of this times the ratio of "
                "plain to striped echo less one",
                file=sys.stderr,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
