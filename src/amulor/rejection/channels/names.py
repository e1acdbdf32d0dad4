"""Which polarization channels a cube has, and which of them belong together."""

from __future__ import annotations

import xarray as xr

from amulor.errors import CubeError

#: Channels in which backscatter of spheres is dark. A mirror-like return keeps V and H,
#: but swaps +45 with -45 degrees and right with left, in the axes of its own light.
CROSS_POLARIZED = ("VH", "HV", "PP", "MM", "RR", "LL")
#: Channels in which it is bright.
CO_POLARIZED = ("VV", "HH", "PM", "MP", "RL", "LR")
PARTNERS = dict(zip(CO_POLARIZED, CROSS_POLARIZED, strict=True))


def pair_of(cube: xr.Dataset) -> tuple[str, str]:
    """Return a co-polarized channel and its cross-polarized partner.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.

    Returns
    -------
    tuple of str
        The first pair that is there.

    Raises
    ------
    CubeError
        If there is none.
    """
    present = cube.amulor.polarizations
    for co, cross in PARTNERS.items():
        if co in present and cross in present:
            return co, cross
    listed = ", ".join("+".join(pair) for pair in PARTNERS.items())
    raise CubeError(
        f"the cube has the channels {', '.join(present)}, but unmixing needs one of "
        f"the pairs {listed}; record both analyser positions"
    )
