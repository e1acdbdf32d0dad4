"""Compiled code under threads: many may enter it, whatever numba's threads rest on.

Loops compiled with `parallel=True` end the process, without a message that Python could
catch, when two threads enter them under numba's layer `workqueue`. The layer is chosen
once for a process, so each has one of its own.
"""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "src"
#: Modules of numba without which a layer cannot be chosen.
LAYERS = {"workqueue": "workqueue", "omp": "omppool"}

ENTER = """
import sys
from concurrent.futures import ThreadPoolExecutor
import numba
import numpy as np
import xarray as xr
from amulor import io
from amulor.optics import small_angle_diffusion
from amulor.rejection import joint, water_fit

cube = io.read_cube(sys.argv[1])

def water(_):
    return small_angle_diffusion.water_response(
        np.linspace(1e6, 2e8, 400), absorption=0.2, forward_scattering=0.5,
        diffuse_scattering=0.0, second_moment=0.06, backscatter_vsf=1e-3,
        group_index=1.38, baseline=0.1, receiver_radius=0.02, acceptance_angle=0.1)

def estimate(_):
    return joint(cube, interval=(0.8, 4.0))

with ThreadPoolExecutor(4) as pool:
    waters, found = pool.map(water, range(4)), pool.map(estimate, range(2))
    waters, found = list(waters), list(found)
assert all(np.array_equal(one, waters[0]) for one in waters)
xr.testing.assert_equal(found[0], found[1])
assert found[0]["joint_slant_range"].notnull().any()
"""

PROVE = """
import sys
from concurrent.futures import ThreadPoolExecutor
import numba
import numpy as np

# The layer of this process works, and it is the one that was asked for.
@numba.njit(parallel=True)
def double(values):
    for k in numba.prange(values.size):
        values[k] *= 2

values = np.ones(8)
if sys.argv[2] == "together":
    with ThreadPoolExecutor(2) as pool:
        double(values.copy())
        list(pool.map(lambda _: [double(np.ones(10**6)) for _ in range(200)], "ab"))
double(values)
assert (values == 2).all()
assert numba.threading_layer() == sys.argv[1]
"""


def run(script: str, *words: str, layer: str) -> subprocess.CompletedProcess[str]:
    """Return what became of a process whose threads of numba rest on a layer."""
    return subprocess.run(
        [sys.executable, "-c", script, *words],
        env={
            **os.environ,
            "NUMBA_THREADING_LAYER": layer,
            "NUMBA_NUM_THREADS": "2",
        },
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def file_of_samples(plate_text: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with enough pixels for two threads to share."""
    from amulor import io
    from amulor.simulation import simulate
    from amulor.survey import Survey

    size = "columns = 40\nrows = 30"
    assert "columns = 12\nrows = 6" in plate_text
    text = plate_text.replace("columns = 12\nrows = 6", size)
    text = text.replace('"39 MHz"', '"31 MHz", "83 MHz", "139 MHz"')
    cube = simulate(Survey.from_text(text), rng=4).isel(polarization=[0])
    path = tmp_path_factory.mktemp("layers") / "samples.nc"
    io.write_cube(cube, path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("layer", LAYERS)
def test_many_threads_may_enter_compiled_code(
    layer: str, file_of_samples: Path
) -> None:
    try:
        importlib.import_module(f"numba.np.ufunc.{LAYERS[layer]}")
    except ImportError:
        pytest.skip(f"this numba has no layer {layer}")
    # After our own code the process proves that it has the layer that was asked for.
    done = run(
        ENTER.replace("sys.argv[1]", repr(str(file_of_samples))) + PROVE,
        layer,
        "apart",
        layer=layer,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_parallel_loop_would_have_ended_the_process() -> None:
    # What the test above would see if a loop of amulor were compiled so.
    done = run(PROVE, "workqueue", "together", layer="workqueue")
    assert done.returncode != 0
    assert "oncurrent access" in done.stderr


def test_no_loop_is_compiled_for_threads_of_numba() -> None:
    asked = [
        f"{path.relative_to(SOURCES)}:{call.lineno}"
        for path in SOURCES.rglob("*.py")
        if "parallel=" in (text := path.read_text("utf-8"))
        for call in ast.walk(ast.parse(text))
        if isinstance(call, ast.Call)
        and any(
            word.arg == "parallel" and ast.unparse(word.value) == "True"
            for word in call.keywords
        )
    ]
    assert asked == []
