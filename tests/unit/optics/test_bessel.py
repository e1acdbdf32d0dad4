"""The Bessel function of the compiled loops, against the library's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special

from amulor.optics import _quadrature as bessel


def _error(x: np.ndarray) -> np.ndarray:
    table = bessel.bessel()
    return np.abs([bessel.j0(each, table) for each in x] - special.j0(x))


def test_the_table_interpolates_at_ten_chebyshev_nodes_of_each_cell() -> None:
    x = np.linspace(0, bessel.NO_WAVE, 8001, endpoint=False)
    # The tenth derivative, at most C(10, 5) / 2^10, over 2^9 10!, in half a unit.
    bound = math.comb(10, 5) / 2**10 / (2**9 * math.factorial(10)) / 2**10
    assert _error(x).max() < bound + 4e-15


@pytest.mark.parametrize(("first", "last"), [(26, 28), (28, 40), (40, 70), (70, 2000)])
def test_the_series_is_off_by_its_first_term_that_is_left_out(
    first: float, last: float
) -> None:
    assert first >= bessel.NO_WAVE
    # The fifth term of P in Hankel's expansion, DLMF 10.17.3.
    fifth = 13043905875 / 2147483648 / first**8
    bound = fifth * np.sqrt(2 / np.pi / first)
    assert _error(np.linspace(first, last, 4001)).max() < bound + 4e-15
