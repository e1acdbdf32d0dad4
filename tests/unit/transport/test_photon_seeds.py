"""The table of `benchmarks/measure_photon_seeds.py` against plain loops."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


def test_the_table_of_seeds_has_their_deviations_and_chi_squares(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    seeds = importlib.import_module("measure_photon_seeds")
    rng = np.random.default_rng(5)
    count, variance = 100, rng.uniform(0.5e-4, 2e-4, 100)
    light = 1 + np.sqrt(variance) * rng.normal(size=count)
    light[7] = 1 + 6 * np.sqrt(variance[7])
    turning = np.array([[2e-4, 1e-4], [1e-4, 1e-4]])
    signal = rng.multivariate_normal((0.5, -0.3), turning, size=count)
    rows = pd.DataFrame(
        {
            "case": "target-3", "seed": range(count), "seconds": 2.0, "light": light,
            "in_phase": signal[:, 0], "quadrature": signal[:, 1], "still": variance,
            "real": 2e-4, "cross": 1e-4, "imaginary": 1e-4, "flagged": 0,
        }
    )  # fmt: skip
    rows.to_csv(tmp_path / "seeds.csv", index=False)
    seeds.table(tmp_path / "seeds.csv")
    printed = capsys.readouterr().out.splitlines()[2]
    cells = [cell.strip() for cell in printed.strip("|").split("|")]
    deviation = [
        (light[k] - np.delete(light, k).mean())
        / np.sqrt(variance[k] * (1 + 1 / (count - 1)))
        for k in range(count)
    ]
    away = signal - signal.mean(axis=0)
    square = sum(a @ np.linalg.solve(turning, a) for a in away) / (2 * (count - 1))
    assert cells[:2] == ["target-3", "100"]
    relative = np.var(light, ddof=1) / np.mean(light) ** 2
    assert float(cells[2]) == pytest.approx(1 / relative / 2.0, rel=0.01)
    assert float(cells[3]) == pytest.approx(np.max(np.abs(deviation)), abs=0.06)
    assert cells[4] == "1"
    still = float(cells[5].split()[0])
    assert still == pytest.approx(np.mean(np.square(deviation)), rel=0.02)
    assert float(cells[6].split()[0]) == pytest.approx(square, rel=0.02)
    assert cells[7] == "0"
