"""Where the joint estimation starts: a shape of the water signal from a coarse grid."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import start as kernels
from amulor.rejection.joint.model import water_at
from amulor.rejection.joint.overlap.frame import Frame
from amulor.rejection.joint.overlap.integral import table_of
from amulor.rejection.joint.overlap.shape import Shape
from amulor.rejection.joint.pixels import (
    Pixels,
    echo_of,
    grid_of,
    phasors,
    places,
    samples,
    weight,
)
from amulor.rejection.joint.priors import whitened

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Values of k' [1/m] and of b_f <theta^2> [rad^2/m] that are tried, with one b_f [1/m].
_GRID = (np.geomspace(0.06, 2.5, 7), np.geomspace(2e-3, 0.1, 3))
_FORWARD = 1.0
#: Pixels that decide.
_STARTERS = 48


def start(
    frame: Frame,
    targets: Pixels,
    shots: Pixels | None,
    *,
    transfer: Complex,
    deepest: float,
) -> tuple[Shape, Floats]:
    """Find a shape and strengths of the water signal from which to start.

    Parameters
    ----------
    frame : Frame
        How the receiver looks at the scan.
    targets : Pixels
        Samples with or without a target.
    shots : Pixels, optional
        Samples that are known to be open water; they decide alone if given.
    transfer : ndarray of complex
        What the echo has beyond its delay [1].
    deepest : float
        Depth beyond which no target stands [m].

    Returns
    -------
    tuple of Shape and ndarray
        The best of a grid, and the strength in each channel [V].
    """
    lowest, best = np.inf, None
    if shots is None:
        few = np.linspace(0, len(targets) - 1, min(_STARTERS, len(targets)))
        some = targets.part(few.astype(np.intp))
        path = grid_of(some, frame.phase_per_path)
    else:
        some, path = shots, np.zeros(0)
    plain = weight(some)
    given = samples(some, plain)
    echo = echo_of(transfer, frame.phase_per_path)
    grid = phasors(path, echo)
    channels = some.signal.shape[1]
    nothing = np.zeros(0)
    for loss, spread in itertools.product(*_GRID):
        shape = Shape(float(loss), float(spread), _FORWARD, nothing, nothing)
        table = table_of(frame, shape, deepest=deepest, derivatives=False)
        if shots is None:
            cost = np.empty(len(some))
            strength = np.zeros((len(some), channels))
            kernels.starting_costs(
                given, places(some, table), table.arrays, echo, grid, cost, strength
            )
            total = float(cost.sum())
            typical = np.median(strength, axis=0)
        else:
            open_path = np.full(len(some), np.inf)
            _, water, _ = water_at(some, open_path, table, frame.phase_per_path)
            u, v = (
                whitened(plain, some.signal),
                whitened(plain, np.broadcast_to(water[:, None], some.signal.shape)),
            )
            square = np.einsum("ncx,ncx->c", v, v)
            along = np.einsum("ncx,ncx->c", u, v)
            typical = np.maximum(along, 0) / np.where(square > 0, square, 1)
            total = float(np.sum(u**2) - np.sum(typical * along))
        if total < lowest:
            lowest, best = total, (shape, typical)
    assert best is not None
    return best
