"""Scattering phase functions: closed forms, objects, measured tables, Mie spheres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

# The function takes the place of its module of the same name, so it cannot be lazy.
from amulor.optics.phase_functions.henyey_greenstein import (
    forward_split,
    henyey_greenstein,
    henyey_greenstein_backscatter_fraction,
    henyey_greenstein_cumulative,
    henyey_greenstein_forward_fraction,
    henyey_greenstein_second_moment,
    similarity_second_moment,
)

if TYPE_CHECKING:
    from amulor.optics.phase_functions import (
        fournier_forand,
        integrals,
        mie,
        mixture,
        models,
        phase_function,
        rayleigh,
        tables,
    )

__all__ = [
    "forward_split",
    "fournier_forand",
    "henyey_greenstein",
    "henyey_greenstein_backscatter_fraction",
    "henyey_greenstein_cumulative",
    "henyey_greenstein_forward_fraction",
    "henyey_greenstein_second_moment",
    "integrals",
    "mie",
    "mixture",
    "models",
    "phase_function",
    "rayleigh",
    "similarity_second_moment",
    "tables",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(__name__, __all__)
