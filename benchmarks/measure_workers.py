"""Measures how a site run grows: python benchmarks/measure_workers.py 1 2 4

Scans of one site, the same survey with other seeds, go from samples to range images and
clouds: once without a cluster, then on dask clusters of so many processes on this
machine, one thread each. The digests of all files are compared.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measure_tiles import SURVEY

SCAN = """
[[scan]]
name = "{name}"
file = "{name}.nc"
epoch = "one"
[scan.processing]
method = "open-water"
polarization = "VV"
nearest = "0.5 m"
farthest = "4 m"
"""


def amulor(*words: str | Path) -> float:
    """Run a command in one thread for BLAS and loops; return its wall time [s]."""
    one = {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "amulor", *map(str, words)],
        env={**os.environ, **one, "SOURCE_DATE_EPOCH": "1750000000"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - begin


def digests(folder: Path) -> dict[str, str]:
    """Return the digest of each cube and cloud in a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for end in ("nc", "ply")
        for path in sorted(folder.rglob(f"*.{end}"))
    }


def main() -> None:
    """Measure, one line of JSON for each number of workers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("workers", type=int, nargs="+")
    parser.add_argument("--scans", type=int, default=4)
    parser.add_argument("--pixels", type=int, default=250_000, help="of a scan")
    chosen = parser.parse_args()
    side = round(chosen.pixels**0.5)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        text = SURVEY.replace("{columns}", str(side)).replace("{rows}", str(side))
        (folder / "survey.toml").write_text(text)
        site = 'name = "Plates"\n[[epoch]]\nname = "one"\n'
        for number in range(chosen.scans):
            name = f"plate{number}"
            site += SCAN.replace("{name}", name)
            amulor(
                "simulate", folder / "survey.toml", "--seed", str(number),
                "-o", folder / f"{name}.nc",
            )  # fmt: skip
        (folder / "site.toml").write_text(site)
        run = ("run", folder / "site.toml", "-o")
        alone = amulor(*run, folder / "alone")
        whole = digests(folder / "alone")
        print(json.dumps({"workers": 0, "wall_s": round(alone, 1)}), flush=True)
        for workers in chosen.workers:
            output = folder / f"by_{workers}"
            cluster = ("--scheduler", "local", "--workers", str(workers))
            wall = amulor(*run, output, *cluster)
            found = {
                "workers": workers,
                "wall_s": round(wall, 1),
                "speedup": round(alone / wall, 2),
                "files": len(whole),
                "same_bytes": digests(output) == whole,
            }
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
