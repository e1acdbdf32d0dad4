"""Joint estimation in several threads: what one thread gives.

Test processes that share a machine have one thread each, so a process of its own shows
what several do.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
import xarray as xr

from amulor import io
from amulor.rejection.joint._kernels.compiled import FEWEST
from amulor.simulation import simulate
from amulor.survey import Survey

ESTIMATE = """
import sys
import numba
from amulor import io
from amulor.rejection import joint

assert int(sys.argv[3]) == numba.config.NUMBA_NUM_THREADS
found = joint(io.read_cube(sys.argv[1]), interval=(0.8, 4.0))
io.write_cube(found, sys.argv[2])
"""


def estimated(folder: Path, *, threads: int) -> xr.Dataset:
    """Return what a process with so many threads makes of the samples of a folder."""
    output = folder / f"{threads}.nc"
    words = [str(folder / "samples.nc"), str(output), str(threads)]
    subprocess.run(
        [sys.executable, "-c", ESTIMATE, *words],
        env={**os.environ, "NUMBA_NUM_THREADS": str(threads)},
        check=True,
    )
    return io.read_cube(output)


@pytest.mark.study
def test_the_estimate_is_the_same_with_any_number_of_threads(
    plate_text: str, tmp_path: Path
) -> None:
    sweep = ", ".join(f'"{f} MHz"' for f in (12, 31, 57, 83, 104, 139))
    text = plate_text.replace('"39 MHz"', sweep)
    # As many pixels as three threads are worth.
    size = f"columns = 48\nrows = {math.ceil(3 * FEWEST / 48)}"
    assert "columns = 12\nrows = 6" in text
    survey = Survey.from_text(text.replace("columns = 12\nrows = 6", size))
    cube = simulate(survey, rng=4).isel(polarization=[0])
    io.write_cube(cube, tmp_path / "samples.nc")
    one, three = (estimated(tmp_path, threads=threads) for threads in (1, 3))
    assert one["joint_slant_range"].notnull().all()
    for name in one.data_vars:
        xr.testing.assert_equal(one[name], three[name])
