"""Plain loop of photons through a slab on a core, all cores and an NVIDIA GPU.

    python benchmarks/measure_slab_on_gpu.py

Light falls straight on a slab (Henyey-Greenstein, asymmetry 0.75, thickness 2, albedo
0.9). Photons are followed one by one until they leave or are absorbed. Each row states
the histories per second, and the reflected and transmitted parts beside those of van de
Hulst (1980), in standard errors. On the GPU each thread starts its next photon as soon
as one ends. In the last rows it also counts the light that leaves by its path length.

Needs numpy, numba and numba-cuda; nothing of amulor. Without a GPU its rows are left
out. docs/decisions/0046-photons-without-a-gpu.md has the result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, cuda, njit, prange

ASYMMETRY, THICKNESS, ALBEDO = 0.75, 2.0, 0.9
REFLECTED, TRANSMITTED = 0.0973946, 0.6609577
#: Bins of path length, and their width in attenuation lengths.
BINS, WIDTH = 2048, 0.02
THREADS, BLOCKS_OF_A_PROCESSOR = 256, 8

Loop = Callable[..., Any]


def steps(compiler: Loop, real: Any, bits: int) -> tuple[Loop, Loop, Loop]:
    """Compile the seed of a stream, a uniform number, and a scattering for a type."""
    scale, half = real(2.0**-bits), real(0.5 * 2.0**-bits)
    shift = np.uint64(64 - bits)
    first, second, third = np.uint64(21), np.uint64(35), np.uint64(4)
    multiplier = np.uint64(2685821657736338717)
    one, two, g, pi = real(1), real(2), real(ASYMMETRY), real(math.pi)

    @compiler
    def seeded(number: int) -> Any:
        """State of a stream (splitmix64)."""
        z = (np.uint64(number) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return (z ^ (z >> np.uint64(31))) | np.uint64(1)

    @compiler
    def drawn(state: Any) -> Any:
        """Next state (xorshift64*), and a uniform number from 0 to 1."""
        state ^= state >> first
        state ^= state << second
        state ^= state >> third
        return state, real((state * multiplier) >> shift) * scale + half

    @compiler
    def turned(state: Any, nz: Any) -> Any:
        """Next state, and the cosine to the axis after a scattering."""
        state, u = drawn(state)
        ratio = (one - g * g) / (one - g + two * g * u)
        cosine = (one + g * g - ratio * ratio) / (two * g)
        state, u = drawn(state)
        level = math.sqrt(max(one - nz * nz, real(0)))
        sine = math.sqrt(max(one - cosine * cosine, real(0)))
        nz = cosine * nz + sine * level * math.cos(pi * u)
        return state, min(max(nz, -one), one)

    return seeded, drawn, turned


def stream(compiler: Loop, real: Any, bits: int, add: Loop) -> tuple[Loop, Loop]:
    """Compile the seed, and the loop of a stream that adds light to two histograms."""
    seeded, drawn, turned = steps(compiler, real, bits)
    zero, one = real(0), real(1)
    thickness, albedo, per_bin = real(THICKNESS), real(ALBEDO), real(1 / WIDTH)

    @compiler
    def followed(state: Any, count: int, bins: Any) -> Any:
        """Reflected and transmitted photons of a stream."""
        reflected, transmitted, done = 0, 0, 0
        z, nz, length = zero, one, zero
        while done < count:
            state, u = drawn(state)
            free = -math.log(u)
            z, length = z + nz * free, length + free
            state, u = drawn(state)
            below, above = z < zero, z > thickness
            if below or above:
                reflected += int(below)
                transmitted += int(above)
                over = z if below else z - thickness
                add(
                    bins, int(below), min(int((length - over / nz) * per_bin), BINS - 1)
                )
            if below or above or u >= albedo:
                done += 1
                z, nz, length = zero, one, zero
            else:
                state, nz = turned(state, nz)
        return reflected, transmitted

    return seeded, followed


def cores(count: int) -> tuple[float, float, float]:
    """Seconds on all threads of numba, and the reflected and transmitted parts."""
    compiler = njit(error_model="numpy")
    streams = 16 * config.NUMBA_NUM_THREADS

    @compiler
    def nothing(bins: Any, part: int, at: int) -> None:
        """Count no path length."""

    seeded, followed = stream(compiler, np.float64, 53, nothing)

    @njit(parallel=True, error_model="numpy")
    def loop(count: int) -> Any:
        reflected, transmitted = 0, 0
        for number in prange(streams):
            r, t = followed(seeded(number), count, 0)
            reflected += r
            transmitted += t
        return reflected, transmitted

    loop(1)
    begin = time.perf_counter()
    reflected, transmitted = loop(count // streams)
    seconds = time.perf_counter() - begin
    total = count // streams * streams
    return seconds * count / total, reflected / total, transmitted / total


def on_gpu(count: int, real: Any, bits: int, *, counted: bool) -> tuple[float, ...]:
    """Seconds on the GPU, and the reflected and transmitted parts."""
    compiler = cuda.jit(device=True)

    @compiler
    def add(bins: Any, part: int, at: int) -> None:
        """Count a path length, or nothing."""
        if counted:
            cuda.atomic.add(bins, (part, at), 1)

    seeded, followed = stream(compiler, real, bits, add)

    @cuda.jit(fastmath=bits < 53)
    def loop(count: int, sums: Any, bins: Any) -> None:
        reflected, transmitted = followed(seeded(cuda.grid(1)), count, bins)
        cuda.atomic.add(sums, 0, reflected)
        cuda.atomic.add(sums, 1, transmitted)

    blocks = BLOCKS_OF_A_PROCESSOR * cuda.get_current_device().MULTIPROCESSOR_COUNT
    each = count // (blocks * THREADS)
    total, best = each * blocks * THREADS, math.inf
    for turn in range(3):  # the first one compiles
        sums = cuda.to_device(np.zeros(2, np.int64))
        bins = cuda.to_device(np.zeros((2, BINS), np.int32))
        cuda.synchronize()
        begin = time.perf_counter()
        loop[blocks, THREADS](each, sums, bins)
        cuda.synchronize()
        if turn:
            best = min(best, time.perf_counter() - begin)
    reflected, transmitted = sums.copy_to_host() / total
    return best * count / total, reflected, transmitted


def main() -> None:
    """Print one row for each device and type."""
    print("| device | million histories/s | reflected [s.e.] | transmitted [s.e.] |")
    print("| --- | --- | --- | --- |")

    def row(device: str, count: int, found: tuple[float, ...]) -> None:
        """Print the rate and the deviations of a run."""
        seconds, *parts = found
        scores = [
            (part - p) / math.sqrt(p * (1 - p) / count)
            for part, p in zip(parts, (REFLECTED, TRANSMITTED), strict=True)
        ]
        numbers = f"{count / seconds / 1e6:,.1f} | {scores[0]:+.1f} | {scores[1]:+.1f}"
        print(f"| {device} | {numbers} |", flush=True)

    row(f"{config.NUMBA_NUM_THREADS} cores, 64 bits", 100_000_000, cores(100_000_000))
    if not cuda.is_available():
        print("no GPU")
        return
    name = cuda.get_current_device().name
    name = name.decode() if isinstance(name, bytes) else name
    for real, bits, kind in ((np.float32, 24, "32"), (np.float64, 53, "64")):
        for counted, words in ((False, ""), (True, ", path lengths counted")):
            found = on_gpu(1_000_000_000, real, bits, counted=counted)
            row(f"{name}, {kind} bits{words}", 1_000_000_000, found)


if __name__ == "__main__":
    main()
