"""Phase functions of scattering: closed forms, objects, tables, spheres."""

from amulor.optics.phase_functions.henyey_greenstein import (
    forward_split,
    henyey_greenstein,
    henyey_greenstein_backscatter_fraction,
    henyey_greenstein_cumulative,
    henyey_greenstein_forward_fraction,
    henyey_greenstein_second_moment,
    similarity_second_moment,
)

__all__ = [
    "forward_split",
    "henyey_greenstein",
    "henyey_greenstein_backscatter_fraction",
    "henyey_greenstein_cumulative",
    "henyey_greenstein_forward_fraction",
    "henyey_greenstein_second_moment",
    "similarity_second_moment",
]
