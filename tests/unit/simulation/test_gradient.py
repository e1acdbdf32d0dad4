"""Simulated water whose concentration changes with the distance."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from amulor.simulation import simulate
from amulor.simulation.gradient import GradientModel, with_gradient
from amulor.simulation.models import DEFAULT_MODEL
from amulor.survey import Survey
from amulor.survey.instrument_errors import Gradient

#: Attenuation of a water without geometry [1/m], and its turn per distance [1/m].
LOSS, TURN = 0.5, 4.0
REDUCED = 0.3
OUTPUTS = ("in_phase", "quadrature")


class Slab:
    """Uniform water that shines by exp(-2 LOSS z + i TURN z) from each distance."""

    title = "slab"
    late_echo = "absent"

    def echo(self, modulation_frequency: Any, **others: Any) -> Any:
        return np.ones(np.shape(others["surface"]["depth"]), dtype=complex)

    def column(self, modulation_frequency: Any, **others: Any) -> Any:
        rate = -2 * LOSS + 1j * TURN
        end = np.asarray(others["end"], dtype=float)
        return (np.exp(rate * np.minimum(end, 1e3)) - 1) / rate


def column(change: float, end: Any) -> Any:
    water = SimpleNamespace(reduced_attenuation=REDUCED)
    model = GradientModel(Slab(), Gradient(change_per_meter=change))
    arguments: dict[str, Any] = {"survey": None, "view": None, "water": water}
    return model.column(np.array([1e7]), end=end, **arguments)


@pytest.mark.parametrize("change", [0.3, -0.4])
def test_each_distance_counts_by_its_concentration_and_the_loss_before(change) -> None:
    def more(z: float) -> float:
        """Integral of the concentration less one, up to a distance [m]."""
        return quad(lambda x: max(1 + change * x, 0) - 1, 0, z)[0]

    def light(z: float) -> complex:
        passed = np.exp(-2 * LOSS * z + 1j * TURN * z - 2 * REDUCED * more(z))
        return max(1 + change * z, 0) * passed

    for end in (1.3, 2.6, np.inf):
        limit = min(end, 25.0)
        expected = (
            quad(lambda z: light(z).real, 0, limit, limit=200)[0]
            + 1j * quad(lambda z: light(z).imag, 0, limit, limit=200)[0]
        )
        found = complex(column(change, np.array([end]))[0])
        assert abs(found - expected) < 0.01 * abs(expected)


def test_without_a_change_the_water_is_uniform(plate: Survey) -> None:
    uniform = Slab().column(None, end=np.array([0.5, 2.0, np.inf]))
    assert_allclose(column(0.0, np.array([0.5, 2.0, np.inf])), uniform, rtol=1e-12)
    assert with_gradient(DEFAULT_MODEL, plate) is DEFAULT_MODEL


@pytest.mark.slow
def test_scan_and_references_have_the_gradient(plate: Survey) -> None:
    errors = {"gradient": {"change_per_meter": 0.2}}
    changed = plate.with_({"instrument.errors": errors})
    cubes = [simulate(survey, rng=1) for survey in (plate, changed)]
    assert "water +0.2 per meter" in cubes[1].attrs["source"]
    for prefix in ("open_water_", "truth_water_"):
        before, after = (
            float(
                np.hypot(cube[f"{prefix}in_phase"], cube[f"{prefix}quadrature"]).mean()
            )
            for cube in cubes
        )
        # Most light comes from the first meter.
        assert 1.01 < after / before < 1.2
    # The echo is weaker by the loss on its way.
    echo = [
        np.hypot(cube["truth_target_in_phase"], cube["truth_target_quadrature"])
        for cube in cubes
    ]
    assert float((echo[1] / echo[0]).max()) < 1


def test_the_first_slice_and_the_light_from_beyond_the_last_count_once() -> None:
    # Ten times more in each meter: 1.25 on the mean of 5 cm.
    near = complex(column(10.0, np.array([0.05]))[0])
    uniform = complex(Slab().column(None, end=np.array([0.05]))[0])
    passed = np.exp(-2 * REDUCED * 10 * 0.025**2 / 2)
    assert near == pytest.approx(1.25 * passed * uniform, rel=1e-9)
    # From 30 m on there is as much as there, and as much was lost.
    change = -0.02
    beyond = column(change, np.array([40.0])) - column(change, np.array([30.0]))
    light = Slab().column(None, end=np.array([40.0])) - Slab().column(
        None, end=np.array([30.0])
    )
    strength = 0.4 * np.exp(2 * REDUCED * 0.02 * 30.0**2 / 2)
    assert_allclose(beyond, light * strength, rtol=1e-3)
