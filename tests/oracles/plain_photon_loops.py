"""Photon loops with no tricks, to check a faster program and to time it against.

Water of one kind fills all space, or z > 0 only, in which case light that crosses z = 0
is lost. A pencil beam leaves the origin along +z. The receiver is a disc in the plane
z = 0 that takes light within `acceptance` of the -z direction; nothing stops at it. One
history serves all frequencies: path L scores exp(+i omega L / v). Two loops, each for
the intensity and for the whole Stokes vector:

- chance hits: absorption ends histories, what crosses the disc is counted;
- local estimate: at each scattering a way to the receiver is drawn, either a direction
  evenly within the acceptance or a point evenly on the disc, and what would arrive
  along it is scored. Histories end by absorption here too.

The angle of scattering is that of Henyey-Greenstein; the reduced Mueller matrix of the
loops with Stokes vectors is Rayleigh's. Received Q and U are referred to x: the
parallel axis is x made perpendicular to the light, the perpendicular axis is about -y,
since parallel x perpendicular is the direction of travel. Launched ones are referred
to x and y.

Each batch of histories has its own stream of random numbers, so results do not depend
on the count of threads. Nothing is shared with the package.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import plain_photon_kernels as kernels
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

Array = NDArray[Any]

FREQUENCIES = np.linspace(1e6, 200e6, 20)


@dataclass(frozen=True)
class Case:
    """What is simulated; the defaults are the narrow receiver that programs race on."""

    attenuation: float = 1.0  # 1 / m
    albedo: float = 0.8
    asymmetry: float = 0.95
    group_index: float = 1.33
    centre: float = 0.07  # of the disc, along x, m
    radius: float = 0.05  # m
    acceptance: float = np.radians(2.0)  # half angle; pi / 2: any angle
    half_space: bool = False


@dataclass(frozen=True)
class Tally:
    """Means per history of each batch, and the time they took."""

    received: Array  # batches (, 4): at zero frequency
    signal: Array  # batches, frequencies (, 4)
    seconds: float
    histories: int

    @property
    def mean(self) -> Any:
        """Return the received fraction."""
        return self.received.mean(axis=0)

    @property
    def standard_error(self) -> Any:
        """Return the standard error of the received fraction."""
        return self.received.std(axis=0, ddof=1) / np.sqrt(len(self.received))

    @property
    def response(self) -> Array:
        """Return the complex signal over that at zero frequency."""
        total = self.signal.mean(axis=0)
        return total / self.received.mean(axis=0).flat[0]

    @property
    def figure_of_merit(self) -> float:
        """Return 1 / (relative variance x seconds) of the received intensity."""
        mean, error = np.ravel(self.mean)[0], np.ravel(self.standard_error)[0]
        return float((mean / error) ** 2 / self.seconds)


def chance_hits(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
) -> Tally:
    """Run the analogue loop for the intensity."""
    return _run(kernels.chance_hits, case, (), histories, seed, batches, frequencies)


def local_estimate(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
    point_on_disc: bool = False,
) -> Tally:
    """Run the loop with an estimate at each scattering for the intensity."""
    extra = (point_on_disc,)
    return _run(
        kernels.local_estimate, case, extra, histories, seed, batches, frequencies
    )


def chance_hits_stokes(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    launched: ArrayLike = (1.0, 1.0, 0.0, 0.0),
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
) -> Tally:
    """Run the analogue loop for the whole Stokes vector."""
    extra = (_state(launched),)
    return _run(
        kernels.chance_hits_stokes, case, extra, histories, seed, batches, frequencies
    )


def local_estimate_stokes(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    launched: ArrayLike = (1.0, 1.0, 0.0, 0.0),
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
    point_on_disc: bool = False,
) -> Tally:
    """Run the loop with an estimate at each scattering for the whole Stokes vector."""
    extra = (_state(launched), point_on_disc)
    return _run(
        kernels.local_estimate_stokes,
        case,
        extra,
        histories,
        seed,
        batches,
        frequencies,
    )


@dataclass(frozen=True)
class SlabTally:
    """Means per history of each batch of a slab: fractions of the launched light."""

    reflected: Array  # batches, modulations; complex
    transmitted: Array  # with the direct light
    seconds: float
    histories: int


def slab(
    *,
    albedo: float = 0.9,
    thickness: float = 2.0,
    asymmetry: float = 0.75,
    modulation: ArrayLike = (0.0,),
    histories: int,
    seed: int,
    batches: int = 100,
) -> SlabTally:
    """Run the analogue loop through a slab, lengths in units of 1 / attenuation.

    `modulation` is omega / (v c): path L, in these units, scores exp(+i x L).
    """
    wave = np.atleast_1d(np.asarray(modulation, dtype=float))
    out = np.zeros((batches, 2, wave.size), dtype=complex)
    each = _even_share(histories, batches)
    fixed = (albedo, thickness, asymmetry, wave, each)
    streams = _streams(seed, batches)
    seconds = _in_parallel(
        kernels.slab, [(*fixed, *rest) for rest in zip(streams, out, strict=True)]
    )
    return SlabTally(out[:, 0] / each, out[:, 1] / each, seconds, histories)


def _run(
    kernel: Callable[..., None],
    case: Case,
    extra: tuple[Any, ...],
    histories: int,
    seed: int,
    batches: int,
    frequencies: ArrayLike,
) -> Tally:
    """Run a kernel and take the time of it."""
    frequency = np.atleast_1d(np.asarray(frequencies, dtype=float))
    wavenumber = 2 * np.pi * frequency * case.group_index / speed_of_light
    steps = np.diff(wavenumber)
    if not np.allclose(steps, steps[:1], rtol=1e-9):
        raise ValueError(f"frequencies must be evenly spaced, got {frequency} Hz")
    waves = np.array([wavenumber[0], steps[0] if steps.size else 0.0])
    each = _even_share(histories, batches)
    last = (
        (4,)
        if kernel in (kernels.chance_hits_stokes, kernels.local_estimate_stokes)
        else ()
    )
    received = np.zeros((batches, *(last or (1,))))
    signal = np.zeros((batches, frequency.size, *last), dtype=complex)
    water = np.array([case.attenuation, case.albedo, case.asymmetry])
    disc = np.array([case.centre, case.radius, np.cos(case.acceptance)])
    fixed = (water, disc, case.half_space, *extra, waves, each)
    seconds = _in_parallel(
        kernel,
        [
            (*fixed, *rest)
            for rest in zip(_streams(seed, batches), received, signal, strict=True)
        ],
    )
    received = received / each if last else received[:, 0] / each
    return Tally(received, signal / each, seconds, histories)


def _in_parallel(kernel: Callable[..., None], calls: list[tuple[Any, ...]]) -> float:
    """Run the calls on all cores and return the seconds that they took."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        start = time.perf_counter()
        list(pool.map(lambda arguments: kernel(*arguments), calls))
        return time.perf_counter() - start


def _even_share(histories: int, batches: int) -> int:
    if histories % batches or histories <= 0:
        raise ValueError(
            f"histories must be a multiple of batches, {batches}, got {histories}"
        )
    return histories // batches


def _streams(seed: int, batches: int) -> Array:
    return np.random.default_rng(seed).integers(0, 2**64, size=batches, dtype=np.uint64)


def _state(launched: ArrayLike) -> Array:
    state = np.array(launched, dtype=float)
    if state.shape != (4,) or state[0] != 1 or np.linalg.norm(state[1:]) > 1 + 1e-12:
        raise ValueError(f"launched must be a state of intensity 1, got {state}")
    return state
