"""Underwater amplitude-modulated laser radar: from a survey file to a 3D image.

::

    Survey.from_toml(path)            water, target, instrument, scan
        |
    simulate(survey, rng=...)         cube of lock-in samples  <-- read_cube(path)
        |
    rejection.open_water(cube)        the water signal taken out
        |
    imaging.range_image(cube)         slant ranges with uncertainty and flags
        |
    imaging.point_cloud(image)        points in space  --> io.write_cloud(...)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from amulor import cube, imaging, optics, rejection, transport, view
    from amulor.io import read_cube, write_cube
    from amulor.simulation import simulate
    from amulor.survey import Survey

__version__ = "0.1.0"

__all__ = [
    "Survey",
    "cube",
    "imaging",
    "io",
    "optics",
    "read_cube",
    "rejection",
    "simulate",
    "transport",
    "view",
    "write_cube",
]

_MODULES = ("cube", "imaging", "io", "optics", "rejection", "transport", "view")
_NAMES = {
    "Survey": "amulor.survey",
    "read_cube": "amulor.io",
    "simulate": "amulor.simulation",
    "write_cube": "amulor.io",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `amulor --help` is quick."""
    if name in _MODULES:
        return importlib.import_module(f"amulor.{name}")
    if name in _NAMES:
        return getattr(importlib.import_module(_NAMES[name]), name)
    raise AttributeError(f"module 'amulor' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted([*globals(), *__all__])
