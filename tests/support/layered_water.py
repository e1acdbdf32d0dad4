"""Water in layers, and a plate in it."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.transport import Layer, Medium, PlaneTarget

PEAKED = henyey_greenstein_function(asymmetry=0.9)
EVEN = isotropic()
TILTED = np.array([0.48, 0.6, 0.64])


def layers(*thickness: float, top: float = -1.0) -> Medium:
    """Return up to three layers; the second is clear."""
    kinds = (0.2, 0.4, PEAKED), (0.0, 0.0, EVEN), (0.3, 0.1, EVEN)
    return Medium.layered(
        [
            Layer(absorption=a, scattering=b, phase_function=p, thickness=t)
            for (a, b, p), t in zip(kinds, thickness, strict=False)
        ],
        group_index=1.33,
        top=top,
    )


def plate(**changes: Any) -> PlaneTarget:
    """Return a plate 2 m ahead."""
    return PlaneTarget(**({"position": (0, 0, 2), "reflectance": 0.5} | changes))
