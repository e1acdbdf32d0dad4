"""Phasor lines of windows: phases, edges, coherence of samples of known lines."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from spotted_scans import scan_of, spots

from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.phasor_lines import (
    _coherence,
    _edges,
    _fit_block,
    _fit_lines,
    _fit_windows,
    _Lines,
    _residuals,
    _surface,
)

LINE = np.linspace(-1, 1, 5)
Y, X = (part.ravel() for part in np.meshgrid(LINE, LINE, indexing="ij"))


def same_errors(shape: tuple[int, ...], size: float) -> Covariance:
    return Covariance(np.full(shape, size**2), np.full(shape, size**2), np.zeros(shape))


@pytest.mark.parametrize("phase", [0.4, 1.9, -2.5])
def test_a_line_has_the_phase_of_the_target_and_the_water_across_it(
    phase: float,
) -> None:
    turned = phase + 0.05 * X - 0.02 * Y**2
    water = 0.2 - 0.1j + 0.03 * X
    signal = (spots((4, 25), 1) * np.exp(1j * turned) + water).astype(complex)
    lines, contrast = _fit_lines(
        signal, same_errors((4, 25), 1e-4), np.ones((4, 25), bool), 5
    )
    # Modulo half a turn.
    assert_allclose(np.sin(lines.phase[:, 0] - phase), 0.0, atol=2e-3)
    assert_allclose(lines.phase[:, 1], 0.05, atol=5e-3)
    assert_allclose(lines.phase[:, 5], -0.02, atol=5e-3)
    side = np.exp(-1j * lines.phase[:, 0])
    assert_allclose(lines.offset, ((0.2 - 0.1j) * side).imag, atol=3e-3)
    assert_array_equal(lines.freedom, 13.0)
    assert (lines.covariance[:, 0, 0] < 1e-5).all()
    assert_array_equal(lines.coherence, 0.0)
    # A contrast is that of bright and dark samples, in standard errors of both outputs.
    size = np.abs(contrast).max(axis=1) * np.sqrt(2) * 1e-4
    assert ((size > 0.25) & (size < 0.7)).all()


@pytest.mark.parametrize(("usable", "known"), [(17, False), (18, True)])
def test_a_line_needs_six_samples_beyond_its_unknowns(usable: int, known: bool) -> None:
    signal = spots((1, 25), 2) * np.exp(0.4j) + 0.1
    use = (np.arange(25) < usable)[np.random.default_rng(3).permutation(25)][None]
    lines, _ = _fit_lines(signal, same_errors((1, 25), 1e-4), use, 5)
    assert lines.freedom == usable - 12
    assert np.isfinite(lines.covariance[0, 0, 0]) == known
    # The mask of the caller stays as it is.
    assert use.sum() == usable


def test_a_single_edge_is_no_line() -> None:
    sides = np.stack([np.where(part > 0.2, 1.0, 0.3) for part in (X, Y, X + Y)])
    corner = np.where((X > 0.2) & (Y > 0.2), 1.0, 0.3)[None]
    signal = np.concatenate([sides, corner, spots((2, 25), 5)]) * np.exp(0.4j) + 0.1
    lines, _ = _fit_lines(signal, same_errors((6, 25), 1e-4), np.ones((6, 25), bool), 5)
    assert_allclose(lines.edge[:4], 1.0, atol=1e-3)
    assert (lines.edge[4:] < 0.6).all()
    assert np.isinf(lines.covariance[:4, 0, 0]).all()
    assert np.isfinite(lines.covariance[4:, 0, 0]).all()


def test_edges_of_a_window_are_normalized_without_their_smooth_part() -> None:
    edges, surface = _edges(5), _surface(5)
    assert_allclose(edges @ surface, 0.0, atol=1e-12)
    # The step between the second and the third column, with a unit norm.
    step = (X > -0.25).astype(float)
    step -= surface @ np.linalg.lstsq(surface, step, rcond=None)[0]
    step /= np.linalg.norm(step)
    assert np.abs(edges @ step).max() == pytest.approx(1.0)
    corner = ((X < -0.25) & (Y > 0.25)).astype(float)
    corner -= surface @ np.linalg.lstsq(surface, corner, rcond=None)[0]
    corner /= np.linalg.norm(corner)
    assert np.abs(edges @ corner).max() == pytest.approx(1.0)


def views_of(
    signal: np.ndarray, error: float
) -> tuple[list[np.ndarray], tuple[int, ...]]:
    """Return windows of planes as a block takes them; signal (plane, window, 25)."""
    shape = len(signal), 1, 1, signal.shape[1], 5, 5
    parts = [signal, *(np.full(signal.shape, v) for v in (error**2, error**2, 0.0))]
    parts.append(np.ones(signal.shape, bool))
    return [part.reshape(shape) for part in parts], shape


def test_lines_of_all_frequencies_point_to_the_bright_side() -> None:
    bright = spots((20, 25), 7)
    phases = np.array([0.3, 1.8, -2.6, -1.2])
    water = np.array([0.05, 0.03j, -0.04, 0.02 + 0.02j])
    signal = bright * np.exp(1j * phases)[:, None, None] + water[:, None, None]
    views, _ = views_of(signal, 1e-4)
    block = _fit_block(views, 5)
    assert block.phase.shape == (4, 1, 1, 20, 6)
    known = np.isfinite(block.covariance[..., 0, 0])
    assert known.mean() > 0.8
    off = np.angle(np.exp(1j * (block.phase[:, 0, 0, :, 0] - phases[:, None])))
    assert_allclose(off[known[:, 0, 0]], 0.0, atol=1e-3)
    side = (water * np.exp(-1j * phases)).imag
    expected = np.broadcast_to(side[:, None], off.shape)
    assert_allclose(
        block.offset[:, 0, 0][known[:, 0, 0]], expected[known[:, 0, 0]], atol=1e-3
    )
    # The offset goes down as the phase goes up, by the length along the line.
    along = block.offset_terms[:, 0, 0, :, 1] / -2 / block.offset_terms[:, 0, 0, :, 2]
    whole = (signal * np.exp(-1j * phases)[:, None, None]).real.mean(axis=2)
    assert (np.sign(along) == np.sign(whole))[known[:, 0, 0]].all()


def test_edges_that_all_frequencies_share_are_coherent() -> None:
    rng = np.random.default_rng(8)
    bright = spots((30, 25), 9)
    phases = np.array([0.3, 1.8, -2.6, -1.2])
    noise = 1e-3 * (
        rng.standard_normal((4, 30, 25)) + 1j * rng.standard_normal((4, 30, 25))
    )
    step = np.where(X + 0.4 * Y > 0.1, 0.02, 0.0)
    found = []
    for size in (0.0, 1.0):
        turned = phases[:, None, None] + size * step
        signal = bright * np.exp(1j * turned) + 0.1 + noise
        views, _ = views_of(signal, 1e-3)
        block = _fit_block(views, 5)
        coherence = block.coherence[:, 0, 0]
        assert_array_equal(coherence, np.broadcast_to(coherence[:1], coherence.shape))
        found.append(np.median(coherence[0][np.isfinite(coherence[0])]))
        # By residuals that point alike in all planes.
        errors = same_errors((30, 25), 1e-3)
        rest = np.stack(
            [
                _residuals(
                    plane, errors, np.ones((30, 25), bool), block.phase[k, 0, 0], 5
                )
                for k, plane in enumerate(signal)
            ]
        )
        known = np.isfinite(block.covariance[:, 0, 0, :, 0, 0])
        rest *= known[..., None]
        power = np.linalg.norm(rest, axis=2, keepdims=True)
        rest /= np.where(power > 0, power, 1.0)
        assert_allclose(
            coherence[0], _coherence(rest, np.full(30, 13.0)), rtol=1e-6, atol=1e-9
        )
    assert abs(found[0]) < 1.0
    assert found[1] > 2.5


def test_windows_are_those_of_their_block(monkeypatch: pytest.MonkeyPatch) -> None:
    signal = spots((9, 7), 4) * np.exp(1j * np.array([0.3, 0.9]))[:, None, None] + 0.1
    cube = scan_of(signal)
    cube["in_phase"].values[0, 0, 4, 4] = np.nan
    scan = Observation(cube=cube)
    whole = _fit_windows(scan, scan.covariance, 5)
    assert whole.phase.shape == (2, 1, 5, 3, 6)
    assert_array_equal(whole.freedom[0, 0], 12.0)
    assert_array_equal(whole.freedom[1, 0], 13.0)
    module = sys.modules["amulor.rejection.phasor_lines"]
    monkeypatch.setattr(module, "_AT_ONCE", 6)
    parts = _fit_windows(scan, scan.covariance, 5)
    for name, values in vars(whole).items():
        assert_allclose(getattr(parts, name), values, rtol=1e-9, atol=1e-12)
    # One window alone is the same as in its place of the scan.
    part = Observation(cube=cube.isel(row=slice(2, 7), column=slice(1, 6)))
    alone = _fit_windows(part, part.covariance, 5)
    assert_allclose(alone.phase[:, :, 0, 0], whole.phase[:, :, 2, 1], atol=1e-9)


def test_a_factor_on_the_variances_scales_all_errors_of_lines() -> None:
    rng = np.random.default_rng(2)
    shape = (1, 1, 2, 3)
    lines = _Lines(
        phase=np.zeros((*shape, 6)),
        covariance=rng.random((*shape, 6, 6)),
        misfit=rng.random(shape),
        freedom=np.full(shape, 13.0),
        edge=np.zeros(shape),
        offset=np.zeros(shape),
        offset_terms=rng.random((*shape, 3)),
        coherence=np.array([[[[2.4, 2.6, 0.0], [-5.0, np.inf, 2.499]]]]),
    )
    before = {name: values.copy() for name, values in vars(lines).items()}
    factor = np.array([[[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]]])
    lines.scale(factor)
    assert_allclose(lines.misfit, before["misfit"] / factor)
    assert_allclose(lines.covariance, before["covariance"] * factor[..., None, None])
    assert_allclose(lines.offset_terms, before["offset_terms"] * factor[..., None])
    expected = [[True, False, True], [True, False, True]]
    assert_array_equal(lines.smooth[0, 0], expected)
