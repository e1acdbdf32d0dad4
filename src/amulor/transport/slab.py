"""Reflection and transmission of light by plane water layers, by Monte Carlo."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.transport._kernels import slab as _slab_kernels
from amulor.transport._kernels.types import Water
from amulor.transport._problem import digest_of, integrals_of, water_tables
from amulor.transport._runs import (
    Batch,
    Limits,
    Progress,
    Record,
    checked_seed,
    conduct,
    frequencies,
    random_state,
)
from amulor.transport.medium import Medium
from amulor.transport.receiver import Source
from amulor.transport.tally import Tally

__all__ = ["reflection_and_transmission"]

_BATCHES, _LARGEST_BATCH = 128, 1 << 19

Array = NDArray[np.float64]


def reflection_and_transmission(
    medium: Medium,
    modulation_frequency: ArrayLike,
    *,
    histories: int,
    seed: int,
    incidence: float = 0.0,
    polarization: str | ArrayLike = "none",
    outward: ArrayLike | None = None,
    index_ratio: float = 1.0,
    discs: ArrayLike = (),
    threads: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Tally:
    r"""Simulate the reflection and transmission of light by plane water layers.

    Parameters
    ----------
    medium : Medium
        Layers with a finite top.
    modulation_frequency : array_like
        Frequencies of the modulation, not below zero, shape (n,) [Hz].
    histories : int
        Number of photons.
    seed : int
        Seed of the random numbers, not below zero.
    incidence : float
        Angle of the light to the forward axis, 0 to below pi / 2; it comes in the
        plane of the axes forward and right, on its way to the right [rad].
    polarization : str or array_like
        State or Stokes vector of the light, parallel to that plane.
    outward : array_like, optional
        Directions of the radiant intensities to compute, as pairs of polar angle to the
        forward axis, not pi / 2, and azimuth from the right, shape (m, 2) [rad].
    index_ratio : float
        Refractive index of the layers divided by that outside [1]. Both faces reflect
        by Fresnel's formulas.
    discs : array_like
        Radii of discs on the far face, centered where the incident beam enters, shape
        (d,) [m].
    threads : int, optional
        Number of batches computed at the same time.
    progress : callable, optional
        Called with a `Progress` after each batch.

    Returns
    -------
    Tally
        Parts "reflected" and "transmitted" (with unscattered light), relative to the
        incident light [1]. Parts "direction 1" to "direction m" are the radiant
        intensity of scattered light, relative to the incident light [1/sr]. Parts
        "disc 1" to "disc d" are the transmitted light within each disc [1]. Stokes
        vectors refer to the plane of the direction and the forward axis.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if reflecting faces are combined with
        polarized light or radiant intensities.

    Notes
    -----
    Photons are traced until they are absorbed or leave. Each scattering event adds a
    local estimate to each direction: the phase function times the transmission of the
    straight path out.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import isotropic
    >>> from amulor.transport import Layer
    >>> water = Layer(
    ...     absorption=0.1, scattering=0.9, phase_function=isotropic(), thickness=2.0
    ... )
    >>> tally = reflection_and_transmission(
    ...     Medium.layered([water], group_index=1.38), [0.0], histories=200_000, seed=1
    ... )
    >>> print(f"{tally.part('reflected')[0][0, 0].real:.2f}")
    0.36
    """
    if math.isinf(medium.edges[0]):
        raise ValueError("medium must have a finite top [m]: use Medium.layered")
    if not 0 <= incidence < math.pi / 2:
        raise ValueError(
            f"incidence must be from 0 to below pi / 2 rad, got {incidence!r} rad"
        )
    stokes = Source(polarization=polarization).stokes
    if not medium.polarized and np.any(stokes[1:] != 0):
        raise ValueError(
            "polarized light needs a medium with a ScatteringMatrix, got one with a "
            "phase function only"
        )
    angles = (
        np.zeros((0, 2)) if outward is None else np.array(outward, dtype=np.float64)
    )
    if angles.ndim != 2 or angles.shape[1] != 2:
        raise ValueError(
            "outward must be pairs of polar angle and azimuth, shape (m, 2), got "
            f"the shape {angles.shape}"
        )
    polar = angles[:, 0]
    if not np.all((polar >= 0) & (polar <= np.pi) & (np.abs(np.cos(polar)) > 1e-6)):
        raise ValueError("polar angles must be from 0 to pi rad, pi / 2 left out")
    radius = np.array(discs, dtype=np.float64)
    if radius.ndim != 1 or not np.all((radius > 0) & np.isfinite(radius)):
        raise ValueError(f"discs must be a list of radii above 0 m, got {discs!r}")
    if not (math.isfinite(index_ratio) and index_ratio >= 1):
        raise ValueError(f"index_ratio must be at least 1, got {index_ratio!r}")
    if index_ratio != 1 and (medium.polarized or angles.size):
        raise ValueError(
            "faces that reflect need a medium with a phase function and no outward "
            f"directions; set index_ratio to 1, got {index_ratio!r}"
        )
    limits = Limits(histories=histories, threads=threads, progress=progress)
    direction = np.array([math.sin(incidence), 0.0, math.cos(incidence)])
    run = _Run(
        medium=medium,
        water=water_tables(medium.layers, np.array(medium.edges)),
        frequency=frequencies(modulation_frequency),
        seed=checked_seed(seed),
        size=min(math.ceil(histories / _BATCHES), _LARGEST_BATCH),
        incidence=direction,
        stokes=stokes,
        outward=_axes(angles),
        index_ratio=float(index_ratio),
        radius=radius,
    )
    return conduct(run, run.frame(), limits)


@dataclass(frozen=True, kw_only=True)
class _Run:
    """Slab problem in batches, each with its own random numbers."""

    medium: Medium
    water: Water
    frequency: Array
    seed: int
    size: int
    incidence: Array
    stokes: Array
    outward: Array
    index_ratio: float
    radius: Array

    @cached_property
    def digest(self) -> str:
        """SHA-256 digest of the numbers that define the problem."""
        return digest_of(
            *self.water[:7],
            self.medium.group_index,
            self.medium.polarized,
            self.incidence,
            self.stokes,
            self.outward,
            self.index_ratio,
            self.radius,
        )

    def frame(self) -> Tally:
        """Return a tally of the run without batches."""
        directions = [f"direction {k + 1}" for k in range(len(self.outward))]
        discs = [f"disc {k + 1}" for k in range(self.radius.size)]
        parts = ("reflected", "transmitted", *directions, *discs)
        components = 4 if self.medium.polarized else 1
        return Tally(
            modulation_frequency=self.frequency,
            parts=parts,
            batches=np.empty((0, len(parts), components, self.frequency.size), complex),
            histories_of=np.empty(0, dtype=np.int64),
            groups=0,
            contribution=(0.0, 0.0, 0.0),
            seed=self.seed,
            next_batch=0,
            batch_size=self.size,
            problem=self.digest,
            seconds=0.0,
            phase_function_integral=integrals_of(self.medium.layers),
        )

    def __call__(self, number: int) -> Batch:
        """Run one batch of photon histories."""
        frame = self.frame()
        record = Record.empty(
            self.water.attenuation, self.medium.group_index, self.frequency, frame
        )
        _slab_kernels.run_slab(
            random_state(self.seed, number),
            self.size,
            _slab_kernels.Light(
                incidence=self.incidence,
                stokes=self.stokes,
                polarized=frame.polarized,
                outward=self.outward,
                index_ratio=self.index_ratio,
                radius=self.radius,
            ),
            self.water,
            record.arrays(0),
        )
        weight = np.zeros((0, 2, frame.batches.shape[2]))  # none are kept
        return record.batch(number, self.size, self.size, weight, keep=False)


def _axes(outward: Array) -> Array:
    """Return unit vectors of exit directions and polarization axes, shape (m, 6)."""
    polar, azimuth = outward.T
    columns = [
        np.sin(polar) * np.cos(azimuth),
        np.sin(polar) * np.sin(azimuth),
        np.cos(polar),
        np.cos(polar) * np.cos(azimuth),
        np.cos(polar) * np.sin(azimuth),
        -np.sin(polar),
    ]
    return np.ascontiguousarray(np.stack(columns, axis=-1))
