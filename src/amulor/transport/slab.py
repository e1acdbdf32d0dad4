"""Reflection and transmission of light by plane water layers, by Monte Carlo."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.transport._kernels import slab as _slab_kernels
from amulor.transport._kernels.interfaces import Interface
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
    index_ratio: float | tuple[float, float] = 1.0,
    rms_slope: float = 0.0,
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
    index_ratio : float or tuple of float
        Refractive index of the layers divided by that outside; a pair for the near and
        the far face [1]. A face with a ratio above 1 reflects and refracts by Fresnel's
        formulas.
    rms_slope : float
        Root mean square slope of the near face along one axis, such as waves have it
        [1]. By default the face is flat.
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
        vectors refer to the plane of the direction and the forward axis. `incidence`
        and `outward` are directions outside of the faces.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if a rough face is combined with radiant
        intensities.

    Notes
    -----
    Photons are traced until they are absorbed or leave. Each scattering event adds a
    local estimate to each direction: the phase function times the transmission of the
    straight path out, and of the paths that are reflected between the faces.

    A rough face has facets with a normal distribution of slopes, and the shadowing of
    Smith's model [1]_. Light may be reflected or refracted several times before it
    leaves, so that no light is lost and paths are reciprocal. For waves on deep water,
    the mean square slope along one axis is about 0.0015 + 0.00256 U, at a wind speed U
    in m/s [2]_.

    References
    ----------
    .. [1] E. Heitz et al., ACM Trans. Graph. 35, 58 (2016),
       :doi:`10.1145/2897824.2925943`.
    .. [2] C. Cox, W. Munk, J. Opt. Soc. Am. 44, 838 (1954),
       :doi:`10.1364/JOSA.44.000838`.

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
    ratios = np.array(index_ratio, dtype=np.float64)
    if ratios.shape not in ((), (2,)) or not np.all((ratios >= 1) & (ratios < np.inf)):
        raise ValueError(
            f"index_ratio must be one or two numbers from 1, got {index_ratio!r}"
        )
    near, far = (float(ratio) for ratio in np.broadcast_to(ratios, 2))
    if not 0 <= rms_slope < 1:
        raise ValueError(f"rms_slope must be from 0 to below 1, got {rms_slope!r}")
    if rms_slope > 0 and near == 1:
        raise ValueError("a rough face needs an index_ratio above 1, got 1")
    if rms_slope > 0 and angles.size:
        raise ValueError(
            "a rough face needs no outward directions; set rms_slope to 0, got "
            f"{rms_slope!r}"
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
        outward=_axes(angles, near=near, far=far),
        near=Interface(ratio=near, slope=float(rms_slope), outward=-1.0),
        far=Interface(ratio=far, slope=0.0, outward=1.0),
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
    near: Interface
    far: Interface
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
            *self.near[:2],
            self.far.ratio,
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
                near=self.near,
                far=self.far,
                radius=self.radius,
            ),
            self.water,
            record.arrays(0),
        )
        weight = np.zeros((0, 2, frame.batches.shape[2]))  # none are kept
        return record.batch(number, self.size, self.size, weight, keep=False)


def _axes(outward: Array, *, near: float, far: float) -> Array:
    """Return exit directions inside, polarization axes and solid angles, shape (m, 7).

    The last column is the solid angle of a direction inside over that outside. Snell's
    law gives the directions inside, from the index ratios of the near and far face.
    """
    polar, azimuth = outward.T
    index = np.where(np.cos(polar) > 0, far, near)
    sine = np.sin(polar) / index
    cosine = np.copysign(np.sqrt(1 - sine**2), np.cos(polar))
    columns = [
        sine * np.cos(azimuth),
        sine * np.sin(azimuth),
        cosine,
        cosine * np.cos(azimuth),
        cosine * np.sin(azimuth),
        -sine,
        np.cos(polar) / (cosine * index**2),
    ]
    return np.ascontiguousarray(np.stack(columns, axis=-1))
