"""Ratios of several frequencies are weighted by their errors, and by their spread."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.rejection.ratios import _weighted_mean


def test_the_mean_is_weighted_by_variances_and_its_error_grows_with_the_spread() -> (
    None
):
    errors = np.array([0.1, 0.2])  # weights 100 and 25
    # By hand: (100 + 50) / 125; spread 100 x 0.04 + 25 x 0.64 = 20 for one degree.
    mean, error = _weighted_mean(np.array([1.0, 2.0]), errors)
    assert mean == pytest.approx(1.2)
    assert error == pytest.approx(np.sqrt(20 / 125))
    # These agree, so that their error is that of the weights alone.
    mean, error = _weighted_mean(np.array([1.0, 1.1]), errors)
    assert mean == pytest.approx(1.02)
    assert error == pytest.approx(np.sqrt(1 / 125))
