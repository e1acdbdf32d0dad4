"""Share of an instrument's phase error that looks like a change of the distance.

    python benchmarks/measure_distance_like_errors.py

For cases of the trust study whose intervals do not contain the surface: phase errors of
the echo, median over the pixels. A change of the distance is proportional to the
frequency. Only the rest contradicts one distance.
"""

from __future__ import annotations

import numpy as np

from amulor.studies.trust.scenes.instrument import KINDS, Recorded

#: Kind, size and number of frequencies, and the fraction of the error that remains.
CASES = (
    ("harmonic", 10.0, 2, 1.0),
    ("quadrature gain", 10.0, 2, 0.3),
    ("quadrature angle", 10.0, 4, 0.3),
    ("quadrature angle", 10.0, 4, 1.0),
)


def main() -> None:
    """Print the phase error of each case, and its parts."""
    print("error             size  f  remains  error mrad  rest mrad  like a distance")
    for kind, size, count, fraction in CASES:
        recorded = Recorded(count, 1)
        scan, shots = KINDS[kind].of_size(fraction * size)(recorded)
        echo = recorded.truth("target")[:, 0]
        water = (shots - recorded.shots)[:, 0].mean(axis=-1)
        added = (scan - recorded.scan)[:, 0] - water[:, None, None]
        phase = np.median(np.angle(1 + added / echo), axis=(1, 2))
        unit = recorded.frequency / np.linalg.norm(recorded.frequency)
        rest = float(np.linalg.norm(phase - (unit @ phase) * unit))
        total = float(np.linalg.norm(phase))
        print(
            f"{kind:16s} {size:5.0f} {count:2d} {fraction:8.1f} {1e3 * total:11.1f} "
            f"{1e3 * rest:10.1f} {1 - (rest / total) ** 2:15.1%}"
        )


if __name__ == "__main__":
    main()
