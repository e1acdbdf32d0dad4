"""Photon transport of open water: what a survey becomes, and whose light it is."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.simulation import transport
from amulor.survey import Survey
from amulor.transport import DiscReceiver, GaussianReceiver, Tally

WHOLE = {
    "water.asymmetry": 0.95,
    "water.forward_fraction": None,
    "water.second_moment": None,
    "water.phase_function_at_180": None,
    "scan.azimuth": 0.1,
    "scan.elevation": -0.05,
    "instrument.receiver.azimuth": 0.0,
}
WINDOW = {
    "instrument.window": {
        "distance": 0.2, "thickness": 0.03, "refractive_index": 1.5, "group_index": 1.52
    }
}  # fmt: skip
PEAKED = {"kind": "henyey-greenstein", "asymmetry": 0.95}
LAYERED = {
    "water": {
        "kind": "layers",
        "group_index": 1.38,
        "refractive_index": 1.34,
        "layers": [
            {
                "absorption": 0.2,
                "scattering": 0.3,
                "phase_function": PEAKED,
                "thickness": 2.0,
            },
            {"absorption": 0.1, "scattering": 0.7, "phase_function": PEAKED},
        ],
    },
    "scan.azimuth": 0.1,
    "instrument.receiver.azimuth": 0.0,
}


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the calls of photon transport."""
    calls: list[Any] = []

    def simulate(*arguments: Any, **options: Any) -> Any:
        calls.append((*arguments, options))
        return SimpleNamespace(delayed=lambda path, *, group_index: (path, group_index))

    monkeypatch.setattr(transport, "simulate", simulate)
    return calls


def test_open_water_has_the_beam_and_receiver_of_its_survey(
    plate: Survey, asked: list[Any]
) -> None:
    survey = plate.with_(
        {**WHOLE, "instrument.emitter.beam_radius": 2e-3,
         "instrument.emitter.beam_divergence": 3e-3}
    )  # fmt: skip
    found = transport.monte_carlo_response(survey, [0.0, 1e7])
    medium, source, receiver, frequency, options = asked[0]
    assert isinstance(found, SimpleNamespace)
    assert medium.unbounded
    assert (medium.group_index, medium.layers[0].absorption) == (1.38, 0.255)
    assert medium.layers[0].scattering == pytest.approx(0.595)
    assert_allclose(source.position, survey.instrument.emitter.position)
    assert_allclose(source.direction, rays.direction(0.1, -0.05))
    assert (source.radius, source.divergence) == (2e-3, 3e-3)
    assert isinstance(receiver, GaussianReceiver)
    assert_allclose(receiver.position, [0.07, 0, 0])
    assert_allclose(receiver.direction, [0, 0, 1], atol=1e-15)
    assert (receiver.radius, receiver.acceptance_angle) == (0.02, 0.08)
    assert frequency.tolist() == [0, 1e7]
    assert options == {
        "histories": 50_000_000, "seed": 1, "target": None, "relative_error": 0.01,
        "progress": None, "spread": None,
    }  # fmt: skip
    thin = transport.monte_carlo_response(plate.with_(WHOLE), [0.0], seed=4,
                                          relative_error=0.1)  # fmt: skip
    assert thin is not None
    assert (asked[1][1].radius, asked[1][1].divergence) == (0, 0)
    assert (asked[1][4]["seed"], asked[1][4]["relative_error"]) == (4, 0.1)
    sharp = plate.with_({**WHOLE, "instrument.receiver.edge": "sharp"})
    transport.monte_carlo_response(sharp, [0.0])
    assert isinstance(asked[2][2], DiscReceiver)


def test_the_far_end_of_the_water_is_black(plate: Survey, asked: list[Any]) -> None:
    survey = plate.with_({**WHOLE, "water.column_end": 3.0})
    transport.monte_carlo_response(survey, [0.0])
    target = asked[0][4]["target"]
    way = rays.direction(0.1, -0.05)
    assert_allclose(target.position, 3 * way)
    assert_allclose(target.normal, -way)
    assert target.reflectance == 0


def test_a_window_is_a_gap_before_the_water(plate: Survey, asked: list[Any]) -> None:
    survey = plate.with_({**WHOLE, **WINDOW})
    found = transport.monte_carlo_response(survey, [0.0])
    medium, source, receiver, *_ = asked[0]
    gap = 1.34 * (0.2 + 0.03 / 1.5)
    passage, water = medium.layers
    assert (passage.absorption, passage.scattering) == (0, 0)
    assert passage.thickness == pytest.approx(gap)
    assert water.absorption == 0.255
    begin = source.position[2]
    assert begin == pytest.approx(0.23)
    assert medium.edges == pytest.approx((begin - gap, begin, math.inf))
    assert_allclose(receiver.position, [0.07, 0, begin - gap])
    assert receiver.acceptance_angle == pytest.approx(0.08 / 1.34)
    # Light needs no time for the gap.
    assert found == (pytest.approx(-gap), 1.38)


def test_layers_begin_before_the_instrument(plate: Survey, asked: list[Any]) -> None:
    survey = plate.with_(LAYERED)
    transport.monte_carlo_response(survey, [0.0])
    medium = asked[0][0]
    assert medium.edges == (0, 2, math.inf)
    assert [layer.absorption for layer in medium.layers] == [0.2, 0.1]
    assert [layer.scattering for layer in medium.layers] == [0.3, 0.7]
    back = survey.with_({"instrument.receiver.position": (0.07, 0.0, -0.25)})
    transport.monte_carlo_response(back, [0.0])
    medium = asked[1][0]
    assert medium.edges == (-0.25, 2, math.inf)
    assert medium.layers[0].thickness == 2.25
    ahead = survey.with_({"instrument.receiver.position": (0.07, 0.0, 0.5)})
    transport.monte_carlo_response(ahead, [0.0])
    assert asked[2][0].edges == (0, 2, math.inf)
    behind = survey.with_({"instrument.emitter": {"position": (0.0, 0.0, -0.5)}})
    transport.monte_carlo_response(behind, [0.0])
    assert asked[3][0].edges == (-0.5, 2, math.inf)


@pytest.mark.parametrize("through", ["layers of water", "the window"])
def test_a_receiver_may_not_look_askew_through_layers(
    plate: Survey, asked: list[Any], through: str
) -> None:
    stated = LAYERED if through == "layers of water" else {**WHOLE, **WINDOW}
    tilted = plate.with_({**stated, "instrument.receiver.azimuth": 0.01})
    with pytest.raises(SurveyError, match=f"looks through {through} at an angle"):
        transport.monte_carlo_response(tilted, [0.0])
    assert not asked
    transport.monte_carlo_response(
        plate.with_({**WHOLE, "instrument.receiver.azimuth": 0.01}), [0.0]
    )
    assert len(asked) == 1


def tally(batches: list[list[complex]], frequency: list[float]) -> Tally:
    values = np.array(batches, dtype=complex)
    return Tally(
        modulation_frequency=np.array(frequency), parts=("water",),
        batches=values[:, None, None, :], histories_of=np.full(len(values), 10),
        groups=2, contribution=(1.0, 1.0, 1.0), seed=1, next_batch=len(values),
        batch_size=10, problem="", seconds=0.0,
    )  # fmt: skip


def test_the_half_power_frequency_of_two_batches_by_hand() -> None:
    root = math.sqrt(0.5)
    # Means 2, 1.8, 1.0: crosses 0.7071 of 2 between 10 and 30 MHz.
    found = tally([[2, 1.8, 0.9], [2, 1.8, 1.1]], [0.0, 10e6, 30e6])
    cut_off, error = transport.half_power(found)
    part = (0.9 - root) / (0.9 - 0.5)
    assert cut_off == pytest.approx(10e6 + 20e6 * part)
    # The last amplitude has an error of 0.1, half of it relative to the first.
    assert error == pytest.approx(part * 0.05 * 20e6 / 0.4)
    # An error of all light alike is none of the ratio.
    together = tally([[1.9, 1.71, 0.95], [2.1, 1.89, 1.05]], [0.0, 10e6, 30e6])
    assert transport.half_power(together)[1] == pytest.approx(0, abs=1e-3)
    flat = tally([[2, 1.9], [2, 1.9]], [0.0, 1e6])
    assert np.isnan(transport.half_power(flat)).tolist() == [True, True]
    for frequency in ([1.0, 2.0], [0.0, 0.0]):
        with pytest.raises(ValueError, match="must rise from 0 Hz"):
            transport.half_power(tally([[2, 1], [2, 1]], frequency))


def test_normalized_amplitudes_have_the_error_beyond_the_first_by_hand() -> None:
    found = tally([[2, 0.9j], [2, 1.1j]], [0.0, 1e7])
    assert_allclose(
        transport.relative_amplitude_uncertainty(found), [0, 0.05], atol=1e-12
    )
    shared = tally([[1.9, 0.95j], [2.1, 1.05j]], [0.0, 1e7])
    assert_allclose(transport.relative_amplitude_uncertainty(shared), 0, atol=1e-12)
    first = tally([[1.8, 1.0], [2.2, 1.0]], [0.0, 1e7])
    # The first has 10 %, the second by it 10 % of its half.
    assert_allclose(transport.relative_amplitude_uncertainty(first), [0, 0.05])
