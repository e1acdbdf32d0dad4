"""Drift of the phase between repeated directions of a scan, in standard errors.

    python benchmarks/measure_repeats.py

Directions of the first row of the trust study's plate are measured again after the
scan, with noise of their own. The relative change of the samples, divided by its
standard error, is compared with the same figure of the open-water references, whose
halves lie before and after the scan. Each figure is the largest of all frequencies, and
the median or the largest of several seeds.
"""

from __future__ import annotations

import numpy as np

from amulor.rejection.observation import Observation
from amulor.rejection.reference import instrument
from amulor.studies.trust.scenes.instrument import KINDS, Recorded

COUNTS = (1, 2, 4)
SEEDS = 20
#: Repeated directions, and errors of the instrument with their sizes.
REPEATED = (1, 24)
ERRORS = (("perfect", 1.0), ("phase drift", 1.0), ("delay drift", 1.0))


def repeats(
    signal: np.ndarray, again: np.ndarray, variance: np.ndarray, directions: int
) -> float:
    """Return the largest change of a frequency in standard errors."""
    before, after = (s[:, :, 0, :directions] for s in (signal, again))
    change = (after / before).imag
    weight = np.abs(before) ** 2 / (2 * variance[:, :, 0, :directions])
    mean = np.sum(weight * change, axis=(1, 2)) / weight.sum(axis=(1, 2))
    return float(np.max(np.abs(mean) * np.sqrt(weight.sum(axis=(1, 2)))))


def references(recorded: Recorded, shots: np.ndarray) -> float:
    """Return the same change between the halves of the open-water references."""
    places = Observation(cube=recorded.cube).shots
    directions = instrument.directions_of(places, places)
    _, group = np.unique(np.round(directions, 9), axis=0, return_inverse=True)
    change, error = instrument._halves(shots, group.ravel())
    weight = error**-2
    mean = np.sum(weight * change.imag, axis=1) / weight.sum(axis=1)
    return float(np.max(np.abs(mean) * np.sqrt(weight.sum(axis=1))))


def main() -> None:
    """Print the table."""
    print("frequencies  error        references  1 direction  24 directions")
    for count in COUNTS:
        figures: dict[str, list[list[float]]] = {kind: [] for kind, _ in ERRORS}
        for seed in range(1, SEEDS + 1):
            recorded, later = Recorded(count, seed), Recorded(count, seed + SEEDS)
            later.scan_time = np.ones_like(later.scan_time)
            errors = Observation(cube=recorded.cube).covariance
            variance = 0.5 * (errors.in_phase + errors.quadrature)
            for kind, size in ERRORS:
                effect = KINDS[kind].of_size(size)
                scan, shots = effect(recorded)
                again, _ = effect(later)
                figures[kind].append(
                    [
                        references(recorded, shots),
                        *(repeats(scan, again, variance, n) for n in REPEATED),
                    ]
                )
        for kind, values in figures.items():
            combined = np.max if kind == "perfect" else np.median
            row = "  ".join(f"{value:11.1f}" for value in combined(values, axis=0))
            print(f"{count:11d}  {kind:11s}  {row}", flush=True)


if __name__ == "__main__":
    main()
