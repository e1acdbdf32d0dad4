"""Underwater amplitude-modulated laser radar: from a survey file to a 3D image.

::

    Survey.from_toml(path)            water, target, instrument, scan
        |
    simulate(survey, rng=...)         cube of lock-in samples  <-- read_cube(path)
        |
    rejection.open_water(cube)        the water signal is removed
        |
    imaging.range_image(cube)         slant ranges with uncertainty and flags
        |
    imaging.point_cloud(image)        points in space  --> io.write_cloud(...)

`pipeline.run` goes from samples to the range image, edges and outliers flagged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor import (
        acquisition,
        cube,
        design,
        errors,
        imaging,
        io,
        optics,
        pipeline,
        rejection,
        samples,
        simulation,
        studies,
        survey,
        transport,
        units,
        view,
    )
    from amulor.io import read_cube, write_cube
    from amulor.simulation import simulate
    from amulor.survey import Survey

__version__ = "0.2.0.dev0"

__all__ = [
    "Survey",
    "acquisition",
    "cube",
    "design",
    "errors",
    "imaging",
    "io",
    "optics",
    "pipeline",
    "read_cube",
    "rejection",
    "samples",
    "simulate",
    "simulation",
    "studies",
    "survey",
    "transport",
    "units",
    "view",
    "write_cube",
]

if not TYPE_CHECKING:
    # Nothing is imported before it is used, so that `amulor --help` is quick.
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            "Survey": "amulor.survey",
            "read_cube": "amulor.io",
            "simulate": "amulor.simulation",
            "write_cube": "amulor.io",
        },
    )
