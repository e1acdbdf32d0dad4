"""`amulor warm-up`: compilation of the numerical code in advance."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from amulor import _progress
from amulor.cli._output import progress_bar

if TYPE_CHECKING:
    import xarray as xr

    from amulor.survey import Survey


def warm_up() -> None:
    """Compile the numerical code for this computer, so that commands start faster.

    Without it, each command compiles the loops that it needs when it first runs. It
    takes a minute or two. Use it for container images, for services, or the evening
    before a survey. Run it again after an update of amulor, Python or numba, and if
    NUMBA_CACHE_DIR changes. It omits loops that only Python code calls: slabs of water,
    and your own phase functions.
    """
    work = _work()
    with progress_bar() as advance:
        for number, (name, step) in enumerate(work.items()):
            with _progress.part(number / len(work), (number + 1) / len(work)):
                advance(name, number / len(work))
                step()
    count, folder = _ready()
    print(f"{count} compiled loops are ready in {folder}")


def _work() -> dict[str, Callable[[], object]]:
    """Return short computations that together compile the loops of commands."""
    from amulor.studies import ladder
    from amulor.survey import Survey

    small = {"scan.columns": 16, "scan.rows": 8}
    frequencies = ["20 MHz", "40 MHz", "60 MHz"]
    moments, tabulated = (
        Survey.from_text(ladder.survey_text(water)).with_(
            small | {"instrument.modulation_frequencies": frequencies}
        )
        for water in ladder.WATERS
    )
    turbid = {"absorption": "0.25 1/m", "scattering": "0.6 1/m"}
    water = {"kind": "petzold", "station": "HAOCE 11", "group_index": 1.34}
    tabulated = tabulated.with_({"water": water | turbid})
    cubes: list[xr.Dataset] = []
    return {
        "simulated scans": lambda: cubes.extend(_scans(moments, tabulated)),
        "rejection and range images": lambda: _images(cubes),
        "water against frequency": lambda: _sweep(moments, tabulated),
        "errors of instruments": lambda: _design(moments),
        "photons": lambda: _photons(moments),
    }


def _scans(moments: Survey, tabulated: Survey) -> list[xr.Dataset]:
    """Simulate scans by three models, in two waters; one scan without references."""
    from amulor import simulation

    for model in (simulation.ClosureModel(), simulation.DiffusionModel()):
        simulation.simulate(moments, rng=1, model=model)
    unaided = moments.with_({"scan.open_water": None})
    return [
        simulation.simulate(survey, rng=1) for survey in (moments, tabulated, unaided)
    ]


def _images(cubes: list[xr.Dataset]) -> None:
    """Run joint and open-water rejection; compute image, surface, deviation, raster."""
    from amulor import imaging, pipeline

    for cube in cubes:
        image = pipeline.run(cube, method="joint", polarization="VH")
        if cube.amulor.open_water is not None:
            image = pipeline.run(cube, method="open-water", polarization="VH")
        surface = imaging.products.surface(image)
        imaging.products.deviation(surface, surface.position, surface.triangles)
        plane = imaging.products.plane_of(surface.frame)
        imaging.products.raster(surface, plane, cell=5e-3)


def _sweep(moments: Survey, tabulated: Survey) -> None:
    """Compute water signals by three models, for Gaussian and sharp receivers."""
    from amulor.simulation import backscatter

    sharp = tabulated.with_({"instrument.receiver.edge": "sharp"})
    for survey in (moments, tabulated, sharp):
        backscatter.small_angle_response(survey, [0.0, 50e6])
    backscatter.closure_response(moments, [0.0, 50e6])
    backscatter.diffusion_response(moments, [0.0, 50e6])


def _design(survey: Survey) -> None:
    """Predict the range errors of a survey."""
    from amulor.design import evaluate

    for method in ("open-water", "joint"):
        evaluate(survey, method=method, distance=[1.0, 1.5])


def _photons(survey: Survey) -> None:
    """Simulate a few photons."""
    from amulor.simulation import transport

    transport.monte_carlo_response(survey, [0.0, 50e6], relative_error=0.2, seed=1)


def _ready() -> tuple[int, str]:
    """Return the number of compiled loops and the folder of their files."""
    from numba.core.dispatcher import Dispatcher

    from amulor._compiled import loops_behind

    # Only the outermost loops on disk are loaded; `loops_behind` adds the others.
    entries = [
        value
        for name, module in list(sys.modules.items())
        if name.startswith("amulor.")
        for value in list(vars(module).values())
        if isinstance(value, Dispatcher) and value.overloads
    ]
    loops = {loop for entry in entries for loop in loops_behind(entry)}
    places = sorted({str(entry.stats.cache_path) for entry in entries})
    return len(loops), os.path.commonpath(places)
