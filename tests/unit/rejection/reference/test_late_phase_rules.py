"""Phases and responses of late light, by delays that are given."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import amulor.rejection.reference.late_phase
from amulor.errors import SurveyError
from amulor.survey.late_light import LEAST_PART

module: Any = sys.modules[amulor.rejection.reference.late_phase.__name__]
FREQUENCY = np.array([20e6, 50e6])
#: Middle of what natural water of an asymmetry may have.
NATURAL = (1 + LEAST_PART) / 2
SCAN: Any = SimpleNamespace(frequency=FREQUENCY)
PATH = np.array([[3.0, 4.0, np.nan], [5.0, 6.0, 8.0]])
#: Late path at the median distance of 5 m, by frequency [m].
DELAY = np.array([0.02, 0.015])


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Let late light be given; return what was asked for."""
    found: list[Any] = []

    def delay(survey: Any, frequency: Any, *, depth: Any, **of: Any) -> Any:
        found.append((survey, depth, of))
        return DELAY.reshape(2, 1, 1)

    def response(survey: Any, frequency: Any, *, depth: Any, **of: Any) -> Any:
        found.append((survey, depth, of))
        return np.array([[0.9j, 0.8], [0.7, 0.6 - 0.1j]])

    of = {"water": SimpleNamespace(group_index=1.25)}
    monkeypatch.setattr(module, "_late_light", lambda scan: ("survey", of))
    monkeypatch.setattr(module, "late_echo_delay", delay)
    monkeypatch.setattr(module, "late_echo_response", response)
    monkeypatch.setattr(module, "states_asymmetry_only", lambda survey: False)
    return found


def test_late_phases_are_those_beside_the_mean_path(asked: list[Any]) -> None:
    phase, error = module.late_phase(SCAN, PATH)
    ((survey, depth, _),) = asked
    assert survey == "survey"
    assert_allclose(depth, [5.0 / 2.5])
    slope = 4 * np.pi * FREQUENCY * 1.25 / 299792458.0
    weight = slope**2 / np.sum(slope**2)
    apart = DELAY - weight @ DELAY
    expected = (slope * apart)[:, None, None] * (PATH / 5.0) ** 2
    assert_allclose(phase, expected)
    assert_allclose(error, expected * module.DISPERSION_UNCERTAINTY)


def test_an_asymmetry_alone_gives_natural_water_and_its_doubt(
    asked: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, _ = module.late_phase(SCAN, PATH)
    logarithm = module.late_response(SCAN, np.array([1.0, 2.0]))
    monkeypatch.setattr(module, "states_asymmetry_only", lambda survey: True)
    phase, error = module.late_phase(SCAN, PATH)
    assert_allclose(phase, NATURAL * plain)
    relative = np.hypot(
        module.DISPERSION_UNCERTAINTY, (1 - LEAST_PART) / (1 + LEAST_PART) / np.sqrt(3)
    )
    assert_allclose(error, phase * relative)
    found = module.late_response(SCAN, np.array([1.0, 2.0]))
    assert_allclose(found, NATURAL * logarithm)


def test_responses_are_logarithms_over_frequency_and_depth(asked: list[Any]) -> None:
    found = module.late_response(SCAN, np.array([1.0, 2.0]))
    expected = np.log(np.array([[0.9j, 0.8], [0.7, 0.6 - 0.1j]]))
    assert found.shape == (2, 2)
    assert_allclose(found, expected)
    assert_allclose(asked[0][1], [1.0, 2.0])


@pytest.mark.parametrize("missing", ["path", "light", "survey"])
def test_there_may_be_no_late_light(
    asked: list[Any], monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise SurveyError("no phase function")

    path = PATH if missing != "path" else np.full((2, 3), np.nan)
    if missing == "light":
        monkeypatch.setattr(module, "_late_light", lambda scan: None)
    if missing == "survey":
        monkeypatch.setattr(module, "late_echo_delay", refuse)
        monkeypatch.setattr(module, "late_echo_response", refuse)
    assert module.late_phase(SCAN, path) is None
    if missing != "path":
        assert module.late_response(SCAN, np.array([1.0])) is None
