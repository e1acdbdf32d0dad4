"""Chance hits of MCX-CL in the case of the narrow receiver, by OpenCL on a CPU.

Run with the interpreter of an environment that has `pmcxcl` and an OpenCL platform for
the CPU, as README.md tells: ``python time_mcx_opencl.py [--cpu] [--runs N]``.
"""

from __future__ import annotations

import argparse

import case
import numpy as np
import pmcxcl
from numpy.typing import NDArray

PHOTONS = 2_000_000
#: Edge of a voxel [m], and voxels in a row: no face but z = 0 is met before LONGEST.
EDGE, ROW = 3.0, 22
#: Photons that meet the disc are 4e-4 of all, before absorption.
BUFFER = PHOTONS // 200


def run(photons: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return length and cosine at the disc of all paths that end on it."""
    end = case.LONGEST * case.GROUP_INDEX / case.SPEED_OF_LIGHT
    middle = ROW / 2
    result = pmcxcl.run(
        nphoton=photons,
        vol=np.ones((ROW, ROW, ROW // 2), dtype=np.uint8),
        unitinmm=1e3 * EDGE,
        prop=np.array(
            [
                [0.0, 0.0, 1.0, case.GROUP_INDEX],
                [
                    case.ABSORPTION / 1e3,
                    case.SCATTERING / 1e3,
                    case.ASYMMETRY,
                    case.GROUP_INDEX,
                ],
            ]
        ),
        issrcfrom0=1,  # otherwise places count from one, and nothing is detected
        srcpos=[middle, middle, 0.0],
        srcdir=[0.0, 0.0, 1.0],
        detpos=[[middle + case.CENTRE / EDGE, middle, 0.0, case.RADIUS / EDGE]],
        tstart=0.0,
        tend=end,
        tstep=end,
        isreflect=0,
        issave2pt=0,
        issavedet=1,
        savedetflag="dpv",
        maxdetphoton=BUFFER,
        autopilot=0,
        nthread=2048,
        nblocksize=64,
        seed=seed,
        gpuid=1,
    )
    # Rows: detector, path in voxels, direction.
    found = np.asarray(result.get("detp", np.zeros((5, 0))), dtype=float)
    if found.shape[1] >= BUFFER:
        raise RuntimeError(f"the buffer of {BUFFER} hits is full: hits were lost")
    return found[1] * EDGE, -found[-1]


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cpu", action="store_true", help="CPU time over two cores")
    parser.add_argument("--runs", type=int, default=4, help="runs of 2e6 photons")
    options = parser.parse_args()
    run(PHOTONS // 1000, 1)  # compiles
    start = case.clock(options.cpu)
    found = [run(PHOTONS, 2 + k) for k in range(options.runs)]
    seconds = case.clock(options.cpu) - start
    path = np.concatenate([part[0] for part in found])
    cosine = np.concatenate([part[1] for part in found])
    weight = np.exp(-case.ABSORPTION * path)
    photons = PHOTONS * options.runs
    narrow = cosine >= np.cos(case.ACCEPTANCE)
    print("seconds:", "CPU time over two cores" if options.cpu else "wall")
    print(
        f"{photons / seconds:.3g} photons/s, {path.size} on the disc at any angle "
        f"({weight.sum() / photons:.4g} with absorption), {narrow.sum()} accepted"
    )
    hits = weight[narrow]
    mean = hits.sum() / photons
    case.report(
        "MCX-CL, chance hits",
        mean,
        ((hits**2).sum() / photons - mean**2) / photons,
        seconds,
    )
    if hits.size:
        # Scores have a mean square of the fraction times the mean weight of light.
        mean_square = case.FRACTION * (hits**2).sum() / hits.sum()
        print(
            "  by the known fraction and the weights alone: FOM "
            f"{case.FRACTION**2 * photons / mean_square / seconds:.2g}"
        )
        size = np.abs(case.response(path[narrow], hits))
        at = [1, 4, 9, 19]
        print(
            "  response at "
            + ", ".join(f"{case.FREQUENCIES[k] / 1e6:.0f}" for k in at)
            + " MHz: "
            + ", ".join(f"{size[k]:.3f}" for k in at)
        )


if __name__ == "__main__":
    main()
