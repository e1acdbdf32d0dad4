"""Stokes vectors and Mueller matrices of light, components, targets and analyzers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics.polarization import (
        components,
        depolarization,
        mueller,
        schemes,
        stokes,
    )

__all__ = [
    "components",
    "depolarization",
    "mueller",
    "schemes",
    "stokes",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(__name__, __all__)
