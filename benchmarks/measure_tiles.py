"""Measures time and memory of the steps by rows: python benchmarks/measure_tiles.py 1 4

Each step runs in a process of its own on a scan of so many million pixels, four
frequencies and one channel; the figures are processor time, wall time, the most memory
that the process had, and the size of the file. What a step makes is deleted when the
next one has read it; `--keep` leaves the last file.

`--sparse 100` simulates one row of a hundred and leaves the others missing, as in a
scan that was stopped: a hundred million pixels are there in minutes, and all of them
are read, worked on and written.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import xarray as xr

from amulor.cube import without_groups
from amulor.io import read_cube
from amulor.io.netcdf import row_writer

SURVEY = """
name = "Plate behind turbid water"
[water]
absorption = "0.255 1/m"
scattering = "0.595 1/m"
forward_fraction = 1.0
second_moment = "0.06 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.38
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "1.5 m"]
rotation = ["0 deg", "12 deg", "0 deg"]
width = "60 cm"
height = "60 cm"
reflectance = 0.1
[instrument]
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["10 MHz", "20 MHz", "39 MHz", "78 MHz"]
polarizations = ["VV"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2.672 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 us"
phase_floor = "0.06 deg"
[scan]
columns = {columns}
rows = {rows}
azimuth_span = "14 deg"
elevation_span = "14 deg"
dwell = "100 us"
[scan.open_water]
columns = 5
rows = 3
repeats = 50
"""

NEAR = ["--nearest", "0.5 m", "--farthest", "4 m"]


def steps(folder: Path) -> dict[str, list[str]]:
    """Return the commands, in the order in which one reads what another made."""
    name = {
        key: str(folder / f"{key}.{end}")
        for key, end in (
            ("survey", "toml"), ("samples", "nc"), ("target", "nc"), ("image", "nc"),
            ("cloud", "ply"), ("laz", "laz"), ("e57", "e57"), ("points", "nc"),
            ("report", "html"),
        )
    }  # fmt: skip
    return {
        "simulate": ["simulate", name["survey"], "-o", name["samples"]],
        "reject": [
            "reject", name["samples"], "--method", "open-water", *NEAR,
            "-o", name["target"],
        ],
        "image": ["image", name["target"], *NEAR, "-o", name["image"]],
        "export .ply": ["export", name["image"], "-o", name["cloud"]],
        "export .laz": ["export", name["image"], "-o", name["laz"]],
        "export .e57": ["export", name["image"], "-o", name["e57"]],
        "export .nc": ["export", name["image"], "-o", name["points"]],
        "report": ["report", name["image"], "-o", name["report"]],
    }  # fmt: skip


#: What reading samples and writing a target signal takes, without all else.
COPY = """
import sys, time
from amulor.io import read_cube, write_cube
samples, target, output = sys.argv[1:]
result = read_cube(target)
begin = time.perf_counter()
read_cube(samples)
write_cube(result, output, overwrite=True)
print(time.perf_counter() - begin)
"""


#: Steps that work by rows where they are told to; the others find out by the size.
TOLD = (
    "simulate",
    "reject",
    "image",
    "export .ply",
    "export .laz",
    "export .e57",
    "export .nc",
)


def measured(words: list[str]) -> dict[str, float]:
    """Run a command in a process of its own; return time and memory."""
    begin = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "amulor", *words], stdout=subprocess.DEVNULL
    )
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"amulor {' '.join(words)}: ended with {status}")
    return {
        "wall_s": round(time.perf_counter() - begin, 1),
        "cpu_s": round(used.ru_utime + used.ru_stime, 1),
        "peak_MB": round(used.ru_maxrss / 1e3),
        "file_MB": round(Path(words[words.index("-o") + 1]).stat().st_size / 1e6, 1),
    }


def read_and_write(folder: Path) -> float:
    """Return the time to read the samples and write the target signal [s]."""
    names = [str(folder / f"{name}.nc") for name in ("samples", "target", "again")]
    done = subprocess.run(
        [sys.executable, "-c", COPY, *names],
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    Path(names[-1]).unlink()
    return float(done.stdout)


def spread(samples: Path, every: int) -> None:
    """Put the rows of a file apart, and rows without a number between them."""
    cube = without_groups(read_cube(samples), "truth")
    rows = cube.sizes["row"]
    elevation = cube["elevation"].values
    apart = (elevation[-1] - elevation[0]) / max(rows - 1, 1) / every
    steps = xr.DataArray(np.arange(every), dims="row")
    with row_writer(samples, rows * every, overwrite=True) as writer:
        for row in range(rows):
            tile = cube.isel(row=[row] * every).copy(deep=True)
            for variable in tile.data_vars.values():
                if variable.dtype.kind == "f" and "row" in variable.dims:
                    variable[{"row": slice(1, None)}] = np.nan
            if row == rows - 1:  # not beyond the shots
                apart = np.zeros_like(apart)
            tile = tile.assign_coords(
                elevation=tile["elevation"] + steps * xr.DataArray(apart, dims="column")
            )
            writer.put(tile, row * every)


def main() -> None:
    """Measure the steps that are asked for, one line of JSON each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("millions", type=float, nargs="+", help="millions of pixels")
    parser.add_argument("--steps", nargs="+", default=["simulate", "reject", "image"])
    parser.add_argument("--tile-rows", type=int)
    parser.add_argument("--folder", type=Path, help="an existing one, which is kept")
    parser.add_argument("--sparse", type=int, default=1, metavar="N")
    parser.add_argument("--read-and-write", action="store_true", help="beside reject")
    parser.add_argument("--keep", action="store_true")
    chosen = parser.parse_args()
    for millions in chosen.millions:
        with tempfile.TemporaryDirectory() as made:
            folder = chosen.folder or Path(made)
            side = round((millions * 1e6) ** 0.5)
            text = SURVEY.replace("{columns}", str(side))
            text = text.replace("{rows}", str(side // chosen.sparse))
            (folder / "survey.toml").write_text(text)
            for step in chosen.steps:
                words = [*steps(folder)[step], "--overwrite"]
                if step in TOLD and chosen.tile_rows:
                    words += ["--tile-rows", str(chosen.tile_rows)]
                found = measured(words)
                if step == "reject" and chosen.read_and_write:
                    found["read_and_write_s"] = round(read_and_write(folder), 1)
                if step == "simulate" and chosen.sparse > 1:
                    # In a process of its own: a child begins with its parent's peak.
                    samples = (folder / "samples.nc", chosen.sparse)
                    child = get_context("spawn").Process(target=spread, args=samples)
                    child.start()
                    child.join()
                print(
                    json.dumps({"step": step, "pixels": side**2, **found}), flush=True
                )
                if not chosen.keep and step in ("reject", "image"):
                    Path(words[1]).unlink()


if __name__ == "__main__":
    main()
