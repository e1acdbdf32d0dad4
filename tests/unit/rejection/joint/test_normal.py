"""Normal equations of what the pixels share, against written-out least squares."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.joint._kernels.bundles import Derivatives, Parameters, Sums
from amulor.rejection.joint._kernels.normal import accumulate


@pytest.mark.parametrize("doubts", [False, True])
def test_normal_equations_are_those_of_the_written_out_least_squares(
    doubts: bool,
) -> None:
    rng = np.random.default_rng(8)
    count, channels, frequencies, parameters = 3, 2, 4, 2

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    left, base = draw(count, channels, frequencies), draw(count, channels, frequencies)
    changes, foreground = draw(count, parameters, frequencies), draw(count, frequencies)
    echo, slope = draw(count, frequencies), draw(count, frequencies)
    factor, rate = draw(frequencies), rng.uniform(1, 3, frequencies)
    strength = rng.uniform(1, 2, channels)
    amplitude = rng.uniform(1, 2, (count, channels))
    is_target = np.array([True, False, True])
    weight = rng.uniform(1, 2, (count, channels, 3, frequencies))
    weight[:, :, 1] -= 1.5
    first_departure = channels + parameters
    first_echo = first_departure + 2 * channels * frequencies
    first_doubt = first_echo + 2 * frequencies
    used = first_doubt + (2 * channels * frequencies + 1 if doubts else 0)
    sums = Sums(np.zeros((2, used, used)), np.zeros((2, used)), np.zeros(2))
    derivatives = Derivatives(
        residual=left,
        weight=weight,
        base=base,
        changes=changes,
        foreground=foreground,
        echo=echo,
        slope=slope,
        amplitude=amplitude,
        is_target=is_target,
    )
    shared = Parameters(
        strength=strength,
        factor=factor,
        phase_per_path=rate,
        first_departure=first_departure,
        first_echo=first_echo,
        first_doubt=first_doubt if doubts else -1,
        is_free=True,
    )
    accumulate(0, 2, derivatives, shared, sums)
    # A trial step needs the sum of squares alone.
    trial = Sums(np.zeros((2, 0, 0)), np.zeros((2, 0)), np.zeros(2))
    without = derivatives._replace(changes=changes[:, :0])
    accumulate(0, 2, without, shared._replace(is_free=False), trial)
    assert_allclose(trial.square, sums.square, rtol=1e-12)
    expected = np.zeros((used, used)), np.zeros(used), 0.0
    for n in range(count):
        rows, own, rest = [], [], []
        for c in range(channels):
            for f in range(frequencies):
                row = np.zeros(used, dtype=complex)
                row[c] = base[n, c, f]
                row[channels : channels + parameters] = strength[c] * changes[n, :, f]
                at = first_departure + c * frequencies + f
                row[at] = strength[c] * foreground[n, f]
                row[at + channels * frequencies] = 1j * strength[c] * foreground[n, f]
                late = amplitude[n, c] * echo[n, f]
                row[first_echo + f] = late
                row[first_echo + frequencies + f] = 1j * late
                if doubts:
                    at = first_doubt + c * frequencies + f
                    row[at] = strength[c] * foreground[n, f]
                    row[at + channels * frequencies] = 1j * row[at]
                    row[used - 1] = strength[c] * base[n, c, f]
                full = echo[n, f] * factor[f]
                mine = np.zeros(channels + 1, dtype=complex)
                mine[c] = full
                way = 1j * rate[f] * amplitude[n, c] * full
                mine[channels] = way + strength[c] * slope[n, f]
                xx, xy, yy = weight[n, c, :, f]
                root = np.linalg.cholesky(np.array([[xx, xy], [xy, yy]])).T
                rows.append(root @ np.stack([row.real, row.imag]))
                own.append(root @ np.stack([mine.real, mine.imag]))
                rest.append(root @ [left[n, c, f].real, left[n, c, f].imag])
        jacobian, mine, residual = (np.concatenate(x) for x in (rows, own, rest))
        if is_target[n]:
            project = np.eye(len(residual)) - mine @ np.linalg.pinv(mine)
            jacobian, residual = project @ jacobian, project @ residual
        expected[0][...] += jacobian.T @ jacobian
        expected[1][...] += jacobian.T @ residual
        expected = (*expected[:2], expected[2] + residual @ residual)
    assert_allclose(sums.matrix.sum(axis=0), expected[0], atol=1e-10)
    assert_allclose(sums.vector.sum(axis=0), expected[1], atol=1e-10)
    assert sums.square.sum() == pytest.approx(expected[2], rel=1e-12)
