"""Scatter of independent photon runs beside their stated errors, and figures of merit.

    python benchmarks/measure_photon_seeds.py run FOLDER CASE FIRST END
    python benchmarks/measure_photon_seeds.py table FOLDER

The first form simulates a case with the seeds from FIRST up to END and writes
FOLDER/CASE-FIRST.json; a file that exists is kept, so a study can be resumed and
divided over processes. CASE is one of CASES: light of a target at a number of
attenuation lengths, or light of the water. The second form reads all files and prints a
table. Each run is compared with the mean of all other seeds of its case. The deviation
of the complex signal, at 0 and 200 MHz, has two components, so its chi-square has two
degrees of freedom. The figure of merit is 1 / (relative variance x seconds of processor
time), with the variance from the scatter of the seeds.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
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


def run(case: str, seed: int) -> dict[str, Any]:
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
        tally = run_of(NARROW, 500_000, seed, [0.0, 200e6], target=target, threads=1)
        signal, covariance = tally.target_signal, tally.target_covariance
    ends = [0, -1]
    return {
        "seed": seed,
        "seconds": time.process_time() - start,
        "real": signal.real[ends].tolist(),
        "imaginary": signal.imag[ends].tolist(),
        "covariance": covariance[ends].tolist(),
        "heavy_tail": tally.heavy_tail_of("water" if case in WATER else "target"),
    }


def table(folder: Path) -> None:
    """Print deviations, chi-square and figures of merit of all cases."""
    print(
        "| case | runs | FOM | largest deviation | beyond 4 sigma | chi-square over "
        "freedom at 0 MHz (p) | at 200 MHz (p) | flagged |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for case in CASES:
        runs: list[dict[str, Any]] = []
        for path in sorted(folder.glob(f"{case}-*.json")):
            runs += json.loads(path.read_text())
        runs = list({each["seed"]: each for each in runs}.values())
        if len(runs) < 3:
            continue
        light = np.array([[each["real"], each["imaginary"]] for each in runs])
        covariance = np.array([each["covariance"] for each in runs])
        count = len(runs)
        # The mean of the others has the covariance of one run over their number.
        away = (light - light.mean(axis=0)) * count / (count - 1)
        own = covariance * count / (count - 1)
        still = away[:, 0, 0] / np.sqrt(own[:, 0, 0, 0])
        turned = np.einsum("nij,nj->ni", np.linalg.pinv(own[:, 1]), away[:, :, 1])
        square = np.sum(turned * away[:, :, 1], axis=1)
        # About the mean of all, a degree of freedom is lost in each component.
        sums = (np.sum(still**2), np.sum(square))
        sums = tuple(value * (count - 1) / count for value in sums)
        chance = [
            float(stats.chi2.sf(value, (count - 1) * freedom))
            for value, freedom in zip(sums, (1, 2), strict=True)
        ]
        seconds = np.mean([each["seconds"] for each in runs])
        merit = light[:, 0, 0].mean() ** 2 / light[:, 0, 0].var(ddof=1) / seconds
        ratios = (sums[0] / (count - 1), sums[1] / (count - 1) / 2)
        texts = [
            f"{ratio:.2f} ({p:.2g})" for ratio, p in zip(ratios, chance, strict=True)
        ]
        if case == "water-1-frequency":
            texts[1] = "-"
        print(
            f"| {case} | {count} | {merit:,.3g} | {abs(still).max():.1f} | "
            f"{int(np.sum(abs(still) > 4))} | {' | '.join(texts)} | "
            f"{sum(each['heavy_tail'] for each in runs)} |"
        )


def main(words: list[str]) -> None:
    """Run seeds of a case, or print the table."""
    folder = Path(words[1])
    if words[0] == "table":
        table(folder)
        return
    case, first, end = words[2], int(words[3]), int(words[4])
    output = folder / f"{case}-{first}.json"
    if output.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    run(case, 0)  # compiles
    runs = [run(case, seed) for seed in range(first, end)]
    part = output.with_suffix(".part")
    part.write_text(json.dumps(runs))
    part.rename(output)


if __name__ == "__main__":
    main(sys.argv[1:])
