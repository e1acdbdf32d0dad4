"""Digests of results of a fixed seed: what a change of structure must not move.

Run with ``python benchmarks/digest_results.py`` before and after a change on one
machine, and compare the lines. The demo and the quick study of Ricci et al. 2010 are
run as commands; joint estimate and transport runs as functions.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from time_joint_estimation import INTERVAL, scene

import amulor
from amulor import cli, transport
from amulor.optics.phase_functions.models import henyey_greenstein_function

#: Variables whose names no version has changed.
TARGET = ("in_phase", "quadrature", "in_phase_uncertainty", "quadrature_uncertainty")
IMAGE = ("slant_range", "slant_range_uncertainty", "intensity", "quality_flag")


def digest(*arrays):
    """Return the first 16 digits of the SHA-256 of arrays, bit for bit."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:16]


def run(*words):
    """Run a command, its printing kept back; stop if it fails."""
    stdout, sys.stdout = sys.stdout, open("printed.txt", "a")  # noqa: SIM115
    try:
        code = cli.main(list(words))
    finally:
        sys.stdout = stdout
    if code != 0:
        raise SystemExit(f"amulor {' '.join(words)} ended with {code}")


def demo(folder):
    """Print a digest of each file of arrays that the demo writes."""
    run("demo", "--output", str(folder), "--json")
    for path in sorted(folder.glob("**/*.nc")):
        cube = amulor.read_cube(path)
        names = [name for name in (*TARGET, *IMAGE) if name in cube]
        print(f"demo {path.name:24}", digest(*(cube[name].values for name in names)))
    for path in sorted(folder.glob("**/*.ply")):
        print(f"demo {path.name:24}", digest(np.fromfile(path, dtype=np.uint8)))


def study(folder):
    """Print a digest of the checks of the quick study, and of each figure's numbers."""
    run("reproduce", "ricci2010", "--quick", "--output", str(folder), "--json")
    checks = json.loads((folder / "checks.json").read_text(encoding="utf-8"))
    for figure in checks["figures"]:
        values = np.array([float(check["value"] or 0.0) for check in figure["checks"]])
        print(f"quick study, figure {figure['number']:<9}", digest(values))


def joint_estimate():
    """Print digests of a joint estimate and of its range image."""
    target = amulor.rejection.joint(scene(40, 30), interval=INTERVAL)
    image = amulor.imaging.range_image(target)
    print("joint estimate               ", digest(*(target[n].values for n in TARGET)))
    print("joint estimate, range image  ", digest(*(image[n].values for n in IMAGE)))


def transport_run():
    """Print digests of transport runs: scalar, polarised with a plane, with a mesh."""
    peak = henyey_greenstein_function(asymmetry=0.95)
    receiver = transport.DiscReceiver(
        radius=0.05, acceptance_angle=0.04, position=(0.07, 0, 0)
    )
    plane = transport.PlaneTarget(position=(0, 0, 1.5), reflectance=0.5)
    square = transport.MeshTarget(
        vertices=[[-1, -1, 2], [1, -1, 2.5], [1, 1, 2.5], [-1, 1, 2]],
        faces=[[0, 1, 2], [0, 2, 3]],
        reflectance=0.5,
    )
    cases = {
        "scalar": (peak, None),
        "polarised": (transport.ScatteringMatrix.rayleigh(), plane),
        "mesh": (peak, square),
    }
    for name, (phase_function, target) in cases.items():
        medium = transport.Medium.homogeneous(
            absorption=0.2,
            scattering=0.8,
            phase_function=phase_function,
            group_index=1.33,
        )
        tally = transport.simulate(
            medium,
            transport.Source(),
            receiver,
            [0.0, 50e6],
            target=target,
            histories=20_000,
            seed=3,
            keep_record=True,
        )
        record = tally.record
        print(
            f"transport run, {name:14}",
            digest(tally.batches, tally.contribution, record.water, record.target),
        )


def main():
    """Print all digests."""
    with tempfile.TemporaryDirectory() as folder:
        transport_run()
        joint_estimate()
        demo(Path(folder) / "demo")
        study(Path(folder) / "study")


if __name__ == "__main__":
    main()
