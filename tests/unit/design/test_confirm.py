"""Scans and photons confirm a design, or say in one line what differs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import paper_goal
import pytest

from amulor.design import confirm as module
from amulor.design.confirm import Photons, Scans, confirm, scans
from amulor.errors import SurveyError
from amulor.survey import Survey

HELD = Scans(
    distance=1.5, predicted=1e-3, achieved=1e-3, ratio=1.0, ratio_error=0.02,
    offset=0.0, offset_error=1e-5, residual_bias=0.0, ranges=1000,
)  # fmt: skip


def _photons(**changed: float) -> Photons:
    values = {
        "echo": 1.0, "echo_error": 0.01, "shift": 1e-3, "shift_error": 1e-5,
        "water": 1.0, "water_error": 0.01, "frequency": 39e6,
    } | changed  # fmt: skip
    return Photons(
        histories=1, **{name: np.array([value]) for name, value in values.items()}
    )


def _differences(
    seen: Scans = HELD, *, late: float = 0.25e-3, **changed: float
) -> list[str]:
    return module._differences("best", seen, _photons(**changed), late, 2e-3)


def test_what_holds_is_not_talked_about() -> None:
    # Three quarters of the delay over what is stated for it: 5 % of them, and half
    # the delay as a rectangle: sqrt(0.0375^2 + 0.1443^2) = 0.149, so 5.03 of them.
    assert pytest.approx(5.03, abs=0.005) == module.TAKEN_OFF
    assert _differences() == []
    assert _differences(replace(HELD, ratio=1.12)) == []


def test_each_thing_that_differs_gets_a_line() -> None:
    (line,) = _differences(replace(HELD, ratio=1.2))
    assert "1.20 ± 0.02" in line
    (line,) = _differences(echo=0.8)
    assert "the echo is 0.80" in line
    (line,) = _differences(water=1.3)
    assert "water before the target is 1.30" in line
    # 1.26 mm are taken off; of 2.5 mm that photons find 1.24 mm stay, five times what
    # is stated for it.
    (line,) = _differences(shift=2.5e-3)
    assert "1.24 ± 0.01 mm of late light" in line
    # What is less than a quarter of the accuracy asked for does not matter.
    assert _differences(shift=1.4e-3, late=0.25e-3) == []


@pytest.mark.slow
def test_simulated_scans_scatter_as_predicted_and_photons_agree() -> None:
    found = confirm(paper_goal.goal(), paper_goal.choice().best.parameters, repeats=6)
    assert found.scans.ranges == 6 * 16 * 9
    assert found.scans.ratio == pytest.approx(1.0, abs=0.1)
    # Of 864 ranges the relative error of a standard deviation is 1 / sqrt(2 864).
    assert found.scans.ratio_error == pytest.approx(0.024, rel=0.7)
    assert abs(found.scans.offset) < 5 * found.scans.offset_error + 1e-4
    assert found.photons is not None
    np.testing.assert_allclose(found.photons.echo, 1.0, atol=0.1)
    assert found.said == ()
    assert found.to_dict()["scans"]["holds"] is True


@pytest.mark.study
def test_a_prediction_for_another_instrument_does_not_hold(plate: Survey) -> None:
    """Scans at a third of the power are no confirmation of the whole."""
    still = {"water.signal_fluctuation": 0.0, "instrument.lock_in.phase_floor": 0.0}
    whole = plate.with_(still)
    dim = whole.with_({"instrument.power": plate.instrument.power / 3})
    at_full = scans(whole, "open-water", interval=(1.0, 2.0), repeats=4)
    at_third = scans(dim, "open-water", interval=(1.0, 2.0), repeats=4)
    assert at_full.holds
    assert at_third.holds
    # Shot noise goes with the root of the power: sqrt(3).
    assert at_third.achieved / at_full.achieved == pytest.approx(3**0.5, rel=0.1)
    mistaken = replace(at_third, ratio=at_third.achieved / at_full.predicted)
    assert not mistaken.holds


def test_three_scans_are_the_least(plate: Survey) -> None:
    with pytest.raises(ValueError, match="at least 3"):
        scans(plate, "open-water", repeats=2)


@pytest.mark.slow
def test_a_design_that_sees_nothing_is_said(plate: Survey) -> None:
    dark = plate.with_({"instrument.power": 1e-12})
    with pytest.raises(SurveyError, match="fewer than half"):
        scans(dark, "none", interval=(1.0, 2.0), repeats=3)
