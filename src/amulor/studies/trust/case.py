"""Test case of the trust study: samples of a scan, and its true surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Case:
    """Samples of a test scan, the user's inputs to its processing, and true ranges."""

    samples: xr.Dataset
    """Samples cube, with the user's survey, which may be wrong."""
    surfaces: Floats
    """Slant ranges of the surfaces on each beam, shape (surfaces, row, column), NaN
    without a surface [m]."""
    late: Floats
    """Excess delay of the echo as a slant range, shape (row, column); mean over
    frequencies, weighted for equal noise [m]."""
    interval: tuple[float, float] | None
    """Nearest and farthest slant range given by the user [m]."""
    judged: NDArray[np.bool_]
    """Mask of evaluated pixels, shape (row, column)."""


def case_of(
    samples: xr.Dataset,
    *,
    interval: tuple[float, float] | None,
    late: Floats | None = None,
    surfaces: Floats | None = None,
    judged: NDArray[np.bool_] | None = None,
) -> Case:
    """Return the test case of a simulated cube."""
    truth = samples.amulor.truth
    if surfaces is None:
        surfaces = truth["slant_range"].values[None]
    shape = surfaces.shape[1:]
    return Case(
        samples=cubes.without_groups(samples, "truth"),
        surfaces=surfaces,
        late=np.zeros(shape) if late is None else late,
        interval=interval,
        judged=np.ones(shape, dtype=bool) if judged is None else judged,
    )


def lateness(
    echo: NDArray[np.complex128],
    optical_path: Floats,
    *,
    modulation_frequency: Floats,
    group_index: float,
) -> Floats:
    r"""Return the excess delay of an echo behind its surface, as a slant range [m]."""
    frequency = modulation_frequency.reshape(-1, *[1] * optical_path.ndim)
    turn = np.exp(-2j * np.pi * frequency * optical_path / speed_of_light)
    phase = np.angle(echo * turn)
    delays = phase * speed_of_light / (4 * np.pi * frequency * group_index)
    weight = frequency**2 * np.abs(echo) ** 2
    total = weight.sum(axis=0)
    mean: Floats = np.divide(
        (weight * delays).sum(axis=0), total, out=np.zeros(total.shape), where=total > 0
    )
    return mean
