"""Scatter of independent photon runs beside their stated errors, and figures of merit.

    python benchmarks/measure_photon_seeds.py run FILE CASE FIRST END
    python benchmarks/measure_photon_seeds.py table FILE

The first form simulates a case with the seeds from FIRST up to END and adds a row of
FILE for each; seeds that the file contains are left out, so a study can be resumed.
CASE is one of CASES: light of a target at a number of attenuation lengths, or light of
the water. The second form prints a table. Each run is compared with the mean of all
other seeds of its case. The deviation of the complex signal, at 0 and 200 MHz, has two
components, so its chi-square has two degrees of freedom. The figure of merit is
1 / (relative variance x seconds of processor time), with the variance from the scatter
of the seeds.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from time_transport import NARROW, run_of

from amulor.transport import PlaneTarget

LENGTHS = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
#: Histories, modulation frequencies and whether Stokes vectors are computed, by case.
WATER = {
    "water-2-frequencies": (300_000, 2, False),
    "water-1-frequency": (300_000, 1, False),
    "water-20-frequencies": (300_000, 20, False),
    "water-200-frequencies": (300_000, 200, False),
    "water-stokes": (300_000, 2, True),
}
CASES = (*(f"target-{length:g}" for length in LENGTHS), *WATER)
#: Histories of a run with a target.
HISTORIES = 500_000
#: Covariance of the light at 0 MHz, and three elements of that at 200 MHz.
COVARIANCE = ("still", "real", "cross", "imaginary")


def run(case: str, seed: int) -> dict[str, object]:
    """Return light, covariance and processor time of one run."""
    start = time.process_time()
    if case in WATER:
        histories, count, polarized = WATER[case]
        frequency = np.linspace(0.0, 200e6, count)
        tally = run_of(
            NARROW, histories, seed, frequency, polarized=polarized, threads=1
        )
        signal, covariance = tally.water_signal, tally.water_covariance
    else:
        target = PlaneTarget(
            position=(0, 0, float(case.partition("-")[2])), reflectance=0.3
        )
        tally = run_of(NARROW, HISTORIES, seed, [0.0, 200e6], target=target, threads=1)
        signal, covariance = tally.target_signal, tally.target_covariance
    last = covariance[-1]
    numbers = (covariance[0, 0, 0], last[0, 0], last[0, 1], last[1, 1])
    return {
        "case": case,
        "seed": seed,
        "seconds": time.process_time() - start,
        "light": signal[0].real,
        "in_phase": signal[-1].real,
        "quadrature": signal[-1].imag,
        **dict(zip(COVARIANCE, numbers, strict=True)),
        "flagged": int(tally.heavy_tail_of("water" if case in WATER else "target")),
    }


def table(file: Path) -> None:
    """Print deviations, chi-square and figures of merit of all cases."""
    print(
        "| case | runs | FOM | largest deviation | beyond 4 sigma | chi-square over "
        "freedom at 0 MHz (p) | at 200 MHz (p) | flagged |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    rows = pd.read_csv(file)
    for case in CASES:
        runs = rows[rows["case"] == case]
        if len(runs) < 3:
            continue
        light = runs["light"].to_numpy()
        turning = runs[["in_phase", "quadrature"]].to_numpy()
        still_variance = runs["still"].to_numpy()
        turning_covariance = runs[["real", "cross", "cross", "imaginary"]].to_numpy()
        turning_covariance = turning_covariance.reshape(-1, 2, 2)
        count = len(runs)
        # The mean of the others has the covariance of one run over their number.
        scale = count / (count - 1)
        still = (light - light.mean()) * scale / np.sqrt(still_variance * scale)
        away = (turning - turning.mean(axis=0)) * scale
        inverse = np.linalg.pinv(turning_covariance * scale)
        square = np.einsum("ni,nij,nj->n", away, inverse, away)
        # About the mean of all, a degree of freedom is lost in each component.
        sums = (np.sum(still**2), np.sum(square))
        sums = tuple(value * (count - 1) / count for value in sums)
        chance = [
            float(stats.chi2.sf(value, (count - 1) * freedom))
            for value, freedom in zip(sums, (1, 2), strict=True)
        ]
        merit = light.mean() ** 2 / light.var(ddof=1) / runs["seconds"].mean()
        ratios = (sums[0] / (count - 1), sums[1] / (count - 1) / 2)
        texts = [
            f"{ratio:.2f} ({p:.2g})" for ratio, p in zip(ratios, chance, strict=True)
        ]
        if case == "water-1-frequency":
            texts[1] = "-"
        print(
            f"| {case} | {count} | {merit:,.3g} | {abs(still).max():.1f} | "
            f"{int(np.sum(abs(still) > 4))} | {' | '.join(texts)} | "
            f"{runs['flagged'].sum()} |"
        )


def main(words: list[str]) -> None:
    """Run seeds of a case, or print the table."""
    if words[0] == "table":
        table(Path(words[1]))
        return
    file, case, first, end = Path(words[1]), words[2], int(words[3]), int(words[4])
    done: set[int] = set()
    if file.exists():
        rows = pd.read_csv(file)
        done = set(rows["seed"][rows["case"] == case])
    run(case, 0)  # compiles
    for seed in range(first, end):
        if seed not in done:
            row = pd.DataFrame([run(case, seed)])
            new = not file.exists()
            row.to_csv(file, mode="a", header=new, index=False, float_format="%.9g")


if __name__ == "__main__":
    main(sys.argv[1:])
