"""Results of a fixed seed, and how far a change of structure has moved them.

Run ``python benchmarks/digest_results.py before.npz`` before a change and
``python benchmarks/digest_results.py after.npz before.npz`` after it, on one machine.
Each line is the digest of one result, and how many of its numbers differ, by how much
of the largest one. The demo, a scan of it by rows, a site and the quick study of Ricci
et al. 2010 are run as commands; joint estimate and transport runs as functions.

What has just been compiled and what comes from the compile cache can differ in the last
bit, where sums may be taken in any order. So both runs need a cache of their own that
is filled: set NUMBA_CACHE_DIR, run twice, and keep the second.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import contextlib
import hashlib
import io
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


def together(*arrays):
    """Return the numbers of some arrays, one after the other."""
    return np.concatenate(
        [np.ravel(np.asarray(array, dtype=float)) for array in arrays]
    )


def run(*words):
    """Run a command, its printing kept back; stop if it fails."""
    with contextlib.redirect_stdout(io.StringIO()):
        code = cli.main(list(words))
    if code != 0:
        raise SystemExit(f"amulor {' '.join(words)} ended with {code}")


def demo(folder):
    """Return the numbers of each file that the demo writes."""
    run("demo", "--output", str(folder), "--json")
    found = {}
    for path in sorted(folder.glob("**/*.nc")):
        cube = amulor.read_cube(path)
        names = [name for name in (*TARGET, *IMAGE) if name in cube]
        found[f"demo, {path.name}"] = together(*(cube[name] for name in names))
    for path in sorted(folder.glob("**/*.ply")):
        points = path.read_bytes().partition(b"end_header\n")[2]
        found[f"demo, {path.name}"] = together(np.frombuffer(points, dtype=np.uint8))
    return found


def by_rows(cube, folder):
    """Return target signal and range image of a scan that is worked on by rows."""
    folder.mkdir()
    target, image = folder / "target.nc", folder / "image.nc"
    run("reject", str(cube), "--method", "open-water", "-o", str(target),
        "--tile-rows", "7")  # fmt: skip
    run("image", str(target), "--polarization", "VH", "-o", str(image),
        "--tile-rows", "7")  # fmt: skip
    return {
        "by rows, target": together(*(amulor.read_cube(target)[n] for n in TARGET)),
        "by rows, image": together(*(amulor.read_cube(image)[n] for n in IMAGE)),
    }


def site(folder):
    """Return poses and changes of the wreck of the examples, small."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "wreck"))
    import make_site

    make_site.make(folder, rows=50)
    run("site", "register", str(folder / "site.toml"), "-o", str(folder / "poses.json"))
    run("site", "compare", str(folder / "site.toml"), "--poses",
        str(folder / "poses.json"), "-o", str(folder / "change.csv"))  # fmt: skip
    change = np.genfromtxt(folder / "change.csv", delimiter=",", skip_header=1)
    poses = json.loads((folder / "poses.json").read_text(encoding="utf-8"))
    return {
        "site, change": change,
        "site, covariance of the poses": np.asarray(poses["covariance"]),
    }


def study(folder):
    """Return the numbers that the checks of the quick study compare."""
    run("reproduce", "ricci2010", "--quick", "--output", str(folder), "--json")
    figures = json.loads((folder / "checks.json").read_text(encoding="utf-8"))[
        "figures"
    ]
    return {
        f"quick study, figure {figure['number']}": together(
            [check["value"] for check in figure["checks"]]
        )
        for figure in figures
    }


def joint_estimate():
    """Return a joint estimate and its range image."""
    target = amulor.rejection.joint(scene(40, 30), interval=INTERVAL)
    image = amulor.imaging.range_image(target)
    return {
        "joint estimate": together(*(target[name] for name in TARGET)),
        "joint estimate, range image": together(*(image[name] for name in IMAGE)),
    }


def transport_runs():
    """Return transport runs: scalar, polarised with a plane, with a mesh."""
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
        "polarised, plane": (transport.ScatteringMatrix.rayleigh(), plane),
        "mesh": (peak, square),
    }
    found = {}
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
        batches = np.asarray(tally.batches)
        found[f"transport, {name}"] = together(batches.real, batches.imag)
        found[f"transport, {name}, record"] = together(
            tally.contribution, tally.record.water, tally.record.target
        )
    return found


def compared(new, old):
    """Return in words how far numbers have moved."""
    if new.shape != old.shape:
        return f"{old.size} numbers became {new.size}"
    same = (new == old) | (np.isnan(new) & np.isnan(old))
    if same.all():
        return "same"
    if not np.array_equal(np.isfinite(new), np.isfinite(old)):
        return "other numbers are finite"
    finite = np.isfinite(old)
    step = np.abs(new - old)[finite].max() / np.abs(old)[finite].max()
    return f"{np.mean(~same):.1%} differ, by up to {step:.1e} of the largest"


def main():
    """Print all digests."""
    name, *before = sys.argv[1:]
    old = np.load(before[0]) if before else {}
    with tempfile.TemporaryDirectory() as folder:
        found = {
            **transport_runs(),
            **joint_estimate(),
            **demo(Path(folder) / "demo"),
            **by_rows(
                Path(folder) / "demo" / "ladder_milk_samples.nc", Path(folder) / "rows"
            ),
            **site(Path(folder) / "site"),
            **study(Path(folder) / "study"),
        }
    for key, numbers in found.items():
        text = hashlib.sha256(numbers.tobytes()).hexdigest()[:16]
        print(f"{key:36}{text}  {compared(numbers, old[key]) if key in old else ''}")
    np.savez_compressed(name, **found)


if __name__ == "__main__":
    main()
