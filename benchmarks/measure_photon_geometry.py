"""Figures of merit of photon transport by baseline and radius of the receiver.

    python benchmarks/measure_photon_geometry.py

Each receiver is run with `amulor.transport` and with the chance hits of a plain loop,
one after the other, so that other load on the machine hardly moves their ratio. The
figure of merit (FOM) is 1 / (relative variance x seconds of processor time) of the
light at 0 MHz, with 20 frequencies computed. The variance of the chance hits follows
from the fraction of light that amulor finds.
"""

from __future__ import annotations

import time
from dataclasses import replace

from time_transport import NARROW, plain, run_of

HISTORIES, HITS = 100_000, 500_000
RECEIVERS = (
    {"centre": 0.07, "radius": 0.05},
    {"centre": 0.2, "radius": 0.05},
    {"centre": 0.5, "radius": 0.05},
    {"centre": 0.07, "radius": 0.01},
    {"centre": 0.25, "radius": 0.2},
)


def merit_of(case: plain.Case) -> tuple[float, float]:
    """Return the FOM of amulor, and the fraction of the light that is received."""
    frequencies = [0.0, *plain.FREQUENCIES[1:]]
    start = time.process_time()
    tally = run_of(case, HISTORIES, 1, frequencies, threads=1)
    seconds = time.process_time() - start
    merit = float(tally.relative_error[0] ** -2.0) / seconds
    return merit, abs(tally.signal[0])


def hits_of(case: plain.Case, fraction: float) -> float:
    """Return the FOM of chance hits."""
    start = time.process_time()
    plain.chance_hits(case, histories=HITS, seed=1)
    seconds = time.process_time() - start
    return HITS * fraction / (1 - fraction) / seconds


def main() -> None:
    """Print the table."""
    merit_of(NARROW)  # compiles
    plain.chance_hits(NARROW, histories=1000, seed=1)
    print("| baseline [m] | radius [m] | fraction | FOM | chance hits | ratio |")
    print("| --- | --- | --- | --- | --- | --- |")
    for receiver in RECEIVERS:
        case = replace(NARROW, **receiver)
        merit, fraction = merit_of(case)
        hits = hits_of(case, fraction)
        print(
            f"| {case.centre:g} | {case.radius:g} | {fraction:.2e} | {merit:,.3g} "
            f"| {hits:,.2g} | {merit / hits:,.2g} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
