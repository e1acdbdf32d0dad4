"""The compiled loops give what the same loops give without compilation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.joint._kernels.bundles import (
    Covariances,
    Derivatives,
    Echo,
    Model,
    Parameters,
    Places,
    Samples,
    Signals,
    Solutions,
    Sums,
    WaterModel,
    WaterTable,
)
from amulor.rejection.joint._kernels.model import (
    fill_phasors,
    integrate,
    interpolate,
    water_at,
)
from amulor.rejection.joint._kernels.normal import accumulate, common
from amulor.rejection.joint._kernels.search import estimate, starting_costs
from amulor.rejection.joint.samples import phasors

Results = dict[str, np.ndarray]
PIXELS, CHANNELS, FREQUENCIES, NODES, COMPONENTS = 6, 2, 5, 12, 2


def named(name: str, bundle: tuple[np.ndarray, ...]) -> Results:
    """Return the arrays of a bundle under names of their own."""
    fields = getattr(bundle, "_fields", ())
    return {f"{name} {field}": getattr(bundle, field) for field in fields}


def searched(fluctuation: float) -> Results:
    """Return what the search, its start and the water signal of some pixels are."""
    rng = np.random.default_rng(5)
    rate = 2 * np.pi * np.linspace(20e6, 140e6, FREQUENCIES) / 3e8
    samples = Samples(
        rng.standard_normal((PIXELS, CHANNELS, 2, FREQUENCIES)),
        np.abs(rng.standard_normal((PIXELS, CHANNELS, 3, FREQUENCIES))) + 1.0,
    )
    samples.weight[:, :, 1] *= 0.1
    samples.weight[1, 0, :, 2] = 0
    places = Places(
        rng.uniform(0.4, 0.6, (PIXELS, COMPONENTS)),
        rng.uniform(0.0, 0.2, PIXELS),
        np.full(PIXELS, 2.0),
        np.full(PIXELS, 8.0),
        np.linspace(0.5, 2.5, 9) * np.ones((PIXELS, 1)),
    )
    table = WaterTable(
        0.25, *rng.standard_normal((2, COMPONENTS, NODES, 2, FREQUENCIES))
    )
    echo = Echo(rate, rng.standard_normal((2, FREQUENCIES)))
    gain = 0.3 * rng.standard_normal((CHANNELS, 2, FREQUENCIES))
    grid = phasors(np.arange(1.8, 8.2, 0.15), echo)
    # The last two pixels start from a path that is known.
    known = np.array([np.nan] * (PIXELS - 2) + [4.0, 5.0])
    shape = {
        "amplitude": (PIXELS, CHANNELS),
        "influence": (PIXELS, CHANNELS, 2, FREQUENCIES),
    }
    solutions = Solutions(
        **{
            name: np.empty(
                shape.get(name, PIXELS),
                dtype=np.intp if name in ("used", "which") else float,
            )
            for name in Solutions._fields
        }
    )
    front = 0.2 * rng.standard_normal((CHANNELS, 2, FREQUENCIES))
    model = Model(table, echo, gain, fluctuation, front, rng.random(COMPONENTS))
    estimate(0, PIXELS, samples, places, model, grid, known, solutions)
    cost, strength = np.empty(PIXELS), np.empty((PIXELS, CHANNELS))
    starting_costs(samples, places, table, echo, grid, cost, strength)
    signals = Signals(np.empty(PIXELS), *np.empty((2, PIXELS, 2, FREQUENCIES)))
    path = np.append(rng.uniform(2, 8, PIXELS - 1), np.inf)
    water_at(0, PIXELS, path, places, table, rate, signals)
    phasor = np.empty((PIXELS, 2, FREQUENCIES))
    fill_phasors(np.linspace(2, 8, PIXELS), echo, phasor)
    return (
        named(f"search, fluctuation {fluctuation}", solutions)
        | named("water", signals)
        | {"start, cost": cost, "start, strength": strength, "phasors": phasor}
    )


def summed() -> Results:
    """Return normal equations, covariances, interpolated and integrated columns."""
    rng = np.random.default_rng(6)

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    shapes = 3
    first = CHANNELS + shapes
    used = first + 2 * CHANNELS * FREQUENCIES + 2 * FREQUENCIES
    weight = rng.uniform(1, 2, (PIXELS, CHANNELS, 3, FREQUENCIES))
    weight[:, :, 1] -= 1.5
    derivatives = Derivatives(
        residual=draw(PIXELS, CHANNELS, FREQUENCIES),
        weight=weight,
        base=draw(PIXELS, CHANNELS, FREQUENCIES),
        changes=draw(PIXELS, shapes, FREQUENCIES),
        foreground=draw(PIXELS, FREQUENCIES),
        echo=draw(PIXELS, FREQUENCIES),
        slope=draw(PIXELS, FREQUENCIES),
        amplitude=rng.uniform(1, 2, (PIXELS, CHANNELS)),
        is_target=np.arange(PIXELS) % 3 > 0,
    )
    found: Results = {}
    for is_free, doubts in ((False, False), (True, False), (True, True)):
        size = used if is_free else first
        size += 2 * CHANNELS * FREQUENCIES + 1 if doubts else 0
        sums = Sums(np.zeros((2, size, size)), np.zeros((2, size)), np.zeros(2))
        parameters = Parameters(
            strength=rng.uniform(1, 2, CHANNELS),
            factor=draw(FREQUENCIES),
            phase_per_path=rng.uniform(1, 3, FREQUENCIES),
            first_departure=first,
            first_echo=first + 2 * CHANNELS * FREQUENCIES,
            first_doubt=used if doubts else -1,
            is_free=is_free,
        )
        accumulate(0, 2, derivatives, parameters, sums)
        found |= named(f"normal, free {is_free}, shots {doubts}", sums)
    root = rng.standard_normal((CHANNELS, FREQUENCIES, shapes + 3, shapes + 3))
    water = WaterModel(
        strength=rng.random(CHANNELS),
        gain=draw(CHANNELS, FREQUENCIES),
        departure=draw(CHANNELS, FREQUENCIES),
        foreground=derivatives.foreground,
        water=derivatives.slope,
        changes=derivatives.changes,
        covariance=root @ np.swapaxes(root, -1, -2),
    )
    out = Covariances(*np.empty((3, PIXELS, CHANNELS, FREQUENCIES)))
    common(0, PIXELS, water, out)
    columns = draw(shapes, COMPONENTS, NODES, FREQUENCIES)
    between = np.empty((PIXELS, shapes, FREQUENCIES), dtype=complex)
    depth = np.append(rng.uniform(0, 4, PIXELS - 1), np.inf)
    coefficient = rng.random((PIXELS, COMPONENTS))
    table, filled = columns.view(float), between.view(float)
    interpolate(0, PIXELS, depth, 0.3, coefficient, table, filled)
    integral = np.empty((shapes, COMPONENTS, 4, FREQUENCIES), dtype=complex)
    profile = rng.random((shapes, COMPONENTS, 10))
    integrate(profile, draw(10, FREQUENCIES), 4, 2, integral)
    return found | named("common", out) | {"between": between, "integral": integral}


@pytest.mark.slow
def test_all_compiled_loops_give_what_they_give_uncompiled(tmp_path: Path) -> None:
    file = tmp_path / "uncompiled.npz"
    subprocess.run(
        [sys.executable, __file__, str(file)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        check=True,
        timeout=120,
    )
    compiled = searched(0.0) | searched(0.3) | summed()
    with np.load(file) as plain:
        assert set(plain) == {*compiled, "is_compiled"}
        assert not plain["is_compiled"]
        assert np.isfinite(plain["search, fluctuation 0.3 path"]).sum() >= 4
        for name, values in compiled.items():
            # Sums in another order, which a search magnifies by some powers of ten.
            assert_allclose(values, plain[name], rtol=1e-7, atol=1e-9, err_msg=name)


if __name__ == "__main__":
    is_compiled = hasattr(estimate, "py_func")
    np.savez(
        sys.argv[1],
        is_compiled=is_compiled,
        **(searched(0.0) | searched(0.3) | summed()),
    )
