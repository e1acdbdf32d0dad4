"""Water of phasor lines: lines that count, and where the water is sure enough."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from spotted_scans import scan_of, spots

from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.phasor_lines import _fit_scan, _fit_water, _Lines

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.phasor_lines")


def lines_of(shape: tuple[int, ...]) -> _Lines:
    """Return good lines through windows, with any numbers."""
    rng = np.random.default_rng(1)
    return _Lines(
        phase=rng.standard_normal((*shape, 6)),
        covariance=np.full((*shape, 6, 6), 1e-4),
        misfit=np.full(shape, 13.0),
        freedom=np.full(shape, 13.0),
        edge=np.full(shape, 0.3),
        offset=rng.standard_normal(shape),
        offset_terms=rng.random((*shape, 3)),
        coherence=np.zeros(shape),
    )


def test_lines_without_sign_of_an_edge_give_the_water(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[str, Any] = {}

    def fit(offsets: Any, sizes: Any, **options: Any) -> str:
        given.update(options, offsets=offsets, sizes=sizes)
        return "water"

    monkeypatch.setattr(module, "fit_smooth_water", fit)
    bright = np.arange(1, 2 * 9 * 11 + 1).reshape(2, 9, 11) / 100
    cube = scan_of(bright * np.exp(0.3j))
    cube["in_phase"].values[0, 0, 8, 10] = np.nan
    scan = Observation(cube=cube)
    lines = lines_of((2, 1, 5, 7))
    limit = chi2.isf(0.05, 13)
    lines.misfit[0, 0, 0, :2] = [0.999 * limit, 1.001 * limit]
    lines.edge[1, 0, 1, :2] = [0.399, 0.401]
    lines.coherence[0, 0, 2, :2] = [2.49, 2.51]
    lines.covariance[1, 0, 3, 1] = np.inf
    assert _fit_water(scan, lines, 5) == "water"
    first, second = given["offsets"]
    expected = np.ones((2, 5, 7), dtype=bool)
    expected[0, 0, 1] = expected[1, 1, 1] = expected[0, 2, 1] = False
    expected[1, 3, 1] = False
    assert_array_equal(first.good, expected[0])
    assert_array_equal(second.good, expected[1])
    assert_array_equal(first.phase, lines.phase[0, 0, ..., 0])
    assert_array_equal(second.offset, lines.offset[1, 0])
    assert_array_equal(second.terms, lines.offset_terms[1, 0])
    # The 95 % quantile of the amplitudes that have a number.
    sizes = [np.quantile(bright[0].ravel()[:-1], 0.95), np.quantile(bright[1], 0.95)]
    assert_allclose(given["sizes"], sizes)
    assert given["planes"] == (2, 1)
    assert given["window"] == 5
    assert_allclose(given["azimuth"][0], 0.002 * np.arange(2, 9))
    assert_allclose(given["elevation"][:, 0], -0.002 * np.arange(2, 7))
    # A frequency without any number has a size of one.
    cube["in_phase"].values[1] = np.nan
    _fit_water(Observation(cube=cube), lines, 5)
    assert given["sizes"][1] == 1.0


class Scan:
    """A scan of which lines, water and its error are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        signal = spots((9, 11), 2) * np.exp(1j * np.array([0.3, 0.9]))[:, None, None]
        self.cube = scan_of(signal + 0.2)
        self.lines = lines_of((2, 1, 5, 7))
        self.error = np.full((2, 1, 9, 11), 1e-3)
        self.misfit = np.ones((2, 1))
        self.target: Any = np.ones((2, 1, 9, 11), dtype=complex)
        one = SimpleNamespace(at=lambda azimuth, elevation: np.ones((2, 1, 1, 1)))

        def before(signal: Any, *_: Any) -> Any:
            square = self.error**2
            # Errors across the target do not count.
            return signal - self.target, Covariance(square, square + 1.0, 0 * square)

        water = SimpleNamespace(before=before, misfit=self.misfit)
        monkeypatch.setattr(module, "_noise_scale", lambda *_: one)
        monkeypatch.setattr(module, "_fit_windows", lambda *_: self.lines)
        monkeypatch.setattr(module, "_errors_of", lambda *_: "errors")
        monkeypatch.setattr(module, "_fit_water", lambda *_: water)

    def run(self) -> Any:
        return _fit_scan(Observation(cube=self.cube), 5)


def test_water_is_subtracted_where_most_of_it_is_sure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scan = Scan(monkeypatch)
    assert scan.run().by_water.all()
    # A tenth of the median target, in more than four fifths of the pixels: 80 of 99.
    for error, pixels, sure in (
        (0.099, 99, True), (0.101, 19, True), (0.101, 20, False), (0.101, 99, False),
    ):  # fmt: skip
        scan.error[0].reshape(-1)[:] = 1e-3
        scan.error[0].reshape(-1)[:pixels] = error
        assert_array_equal(scan.run().by_water.ravel(), [sure, True])
    scan.error[:] = 1e-3
    for misfit, sure in ((1.99, True), (2.01, False)):
        scan.misfit[1, 0] = misfit
        assert_array_equal(scan.run().by_water.ravel(), [True, sure])
    # A frequency without numbers has no water.
    scan.misfit[:] = 1.0
    scan.cube["in_phase"].values[1] = np.nan
    assert_array_equal(scan.run().by_water.ravel(), [True, False])


def test_more_than_half_of_the_windows_with_an_edge_are_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scan = Scan(monkeypatch)
    for count, edges in ((0, False), (17, False), (18, True)):
        coherence = np.zeros(35)
        coherence[:count] = 3.0
        scan.lines.coherence[:] = coherence.reshape(5, 7)
        assert scan.run().has_edges is edges
    # Windows that were not tested do not count.
    coherence[:] = np.inf
    coherence[:3] = [3.0, 3.0, 0.0]
    scan.lines.coherence[:] = coherence.reshape(5, 7)
    assert scan.run().has_edges is True
    coherence[:2] = 0.0
    scan.lines.coherence[:] = coherence.reshape(5, 7)
    assert scan.run().has_edges is False
