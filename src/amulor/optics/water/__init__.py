"""Optical properties of water: refractive index, absorption, scattering."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics.water import (
        attenuation,
        case_1,
        milk,
        molecular_scattering,
        pure_water,
        seawater,
        types,
    )

__all__ = [
    "attenuation",
    "case_1",
    "milk",
    "molecular_scattering",
    "pure_water",
    "seawater",
    "types",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(__name__, __all__)
