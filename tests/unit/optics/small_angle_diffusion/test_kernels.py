"""Compiled loops of the small-angle models against the same loops as written."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics import _quadrature as _panel_kernels
from amulor.optics._quadrature import RULE
from amulor.optics.small_angle_diffusion import _kernels


def _kernel_arguments(name):
    rng = np.random.default_rng(46)
    n = _panel_kernels.ORDER
    column = _kernels.Column(
        loss=0.4,
        spreading=0.012,
        aperture=4e-4,
        acceptance=6.4e-3,
        slant=0.01,
        nearest=2.0,
        closest=0.0,
        standoff=0.0,
        start=0.0,
        end=40.0,
    )
    work = rng.uniform(0.1, 1.0, (6, n))
    phases = np.linspace(0.1, 7.0, 9)
    series = [rng.normal(size=n), rng.normal(size=n)]
    turns = [rng.uniform(0, 100, 9) for _ in range(2)]
    sums = [np.zeros(9), np.zeros(9)]
    rule = RULE
    table = np.array([[0.2, 0.01, 0.2, 0.02, 0.08, 0.1, 0.01, 0.1, 0.0, np.inf]])
    return {
        "sine_cosine": (123.4,),
        "_exponential": (-45.6,),
        "_area": (1.5, column),
        "_offset": (1.5, column),
        "_level": (1.5, column),
        "_slope": (1.5, column),
        "_scale": (0.01, column),
        "_bound": (1.5, 2.5, column),
        "_geometry": (table[0],),
        "_prepare": (_kernels.Geometry(*table[0]),),
        "_break_points": (column, np.zeros(64)),
        "_sample": (2.0, 0.5, 1.8, column, rule, work, work.view(np.int64)),
        "expand": (work[0], rule[0], np.zeros(n)),
        "_unresolved": (1.5, 2.5, 1.8, column, rule, work),
        "_add_slow": (0.9, phases, *series, turns[0], *sums),
        "_add_fast": (90.0, phases, *series, *turns, *sums),
        "add_panel": (
            _panel_kernels.Panel(0.9, 2.1, *series),
            phases,
            rule,
            np.zeros((2, n)),
            np.zeros((2, 9)),
            np.zeros((2, 9)),
        ),
        "j0": (12.3, _panel_kernels.bessel()),
        "polynomial": (_panel_kernels.bessel(), 3, 0.4),
        "_turns": (phases, 2e6, np.zeros(9)),
        "_add_column": (
            column,
            phases,
            rule,
            work,
            np.zeros((2, 9)),
            np.zeros((2, 9)),
        ),
        "water_column": (
            table,
            phases[None],
            rule,
            np.zeros((1, 9), dtype=complex),
        ),
    }[name]


def _named_kernels():
    """Return all compiled functions of the modules by name."""
    return {
        name: function
        for module in (_kernels, _panel_kernels)
        for name, function in vars(module).items()
        if hasattr(function, "py_func")
    }


@pytest.mark.parametrize("name", sorted(_named_kernels()))
def test_compiled_and_plain_kernel_agree(name):
    compiled, plain = _kernel_arguments(name), _kernel_arguments(name)
    kernel = _named_kernels()[name]
    answers = kernel(*compiled), kernel.py_func(*plain)
    # Fused multiply-add rounds once where plain Python rounds twice.
    tolerance = {"rtol": 1e-12, "atol": 1e-12}
    if answers[0] is not None:
        assert_allclose(answers[0], answers[1], **tolerance)
    for one, other in zip(compiled, plain, strict=True):
        if isinstance(one, np.ndarray) and one.dtype != np.int64:
            used = np.abs(one) < 1e15  # the rest are numbers taken apart in bits
            assert_allclose(one[used], other[used], **tolerance)


def test_inline_functions_keep_all_digits():
    x = np.random.default_rng(3).uniform(-1e7, 1e7, 2000)
    both = np.array([_panel_kernels.sine_cosine(value) for value in x])
    # Absolute, as the sums need it: two roundings of a number below one.
    assert_allclose(both, np.stack([np.sin(x), np.cos(x)], axis=1), atol=5e-16, rtol=0)
    x = np.random.default_rng(4).uniform(-700, 700, 2000)
    parts = np.array([_kernels._exponential(value) for value in x])
    assert_allclose(parts[:, 0] * 2.0 ** parts[:, 1], np.exp(x), rtol=5e-16)
