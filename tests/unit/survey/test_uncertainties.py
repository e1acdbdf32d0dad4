"""Errors that a survey has where it states none: phases, group index, moments."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.errors import SurveyError
from amulor.optics.water import seawater
from amulor.survey import Survey, properties
from amulor.survey.properties import group_index_uncertainty, phase_uncertainty
from amulor.survey.water import SALINITIES, TEMPERATURES, state_of

MIXER = math.sqrt(0.01**2 / 8 + 3 * math.radians(1.0) ** 2 / 8)


def survey_of(
    stated: float | None = None, count: int = 3, demodulator: str = "digital"
) -> Any:
    instrument = SimpleNamespace(
        phase_uncertainty=stated,
        modulation_frequencies=(1.0,) * count,
        lock_in=SimpleNamespace(demodulator=demodulator),
    )
    return SimpleNamespace(instrument=instrument)


@pytest.mark.parametrize(
    ("stated", "count", "words", "degrees"),
    [
        # Half a degree, three times as much uncalibrated, six times at one frequency.
        (None, 3, {}, 1.5),
        (None, 1, {}, 3.0),
        (None, 3, {"phases_measured": True}, 0.5),
        (None, 1, {"phases_measured": True}, 0.5),
        (None, 3, {"leakage_measured": True}, 1.2),
        (None, 3, {"leakage_measured": True, "phases_measured": True}, 0.4),
        (None, 3, {"frequencies": 1}, 3.0),
        (None, 1, {"frequencies": 2}, 1.5),
        # A stated error that no other phase tests: Student's quantile of two degrees.
        (0.1, 3, {}, 0.1),
        (0.1, 1, {}, 0.1 * 4.303 / 1.96),
        (0.1, 1, {"phases_measured": True}, 0.1),
        (0.1, 3, {"frequencies": 1}, 0.1 * 4.303 / 1.96),
    ],
)
def test_phases_have_typical_errors_unless_they_are_known(
    stated: float | None, count: int, words: dict[str, Any], degrees: float
) -> None:
    survey = survey_of(None if stated is None else math.radians(stated), count)
    assert phase_uncertainty(survey, **words) == pytest.approx(math.radians(degrees))


@pytest.mark.parametrize(("count", "factor"), [(1, 6.0), (3, 3.0)])
def test_analog_mixers_add_their_gain_and_angle(count: int, factor: float) -> None:
    analog = survey_of(None, count, "analog")
    typical = math.radians(0.5)
    assert phase_uncertainty(analog) == pytest.approx(
        factor * math.hypot(typical, MIXER)
    )
    assert phase_uncertainty(analog, phases_measured=True) == pytest.approx(
        math.hypot(typical, factor * MIXER)
    )
    assert phase_uncertainty(analog, demodulator_measured=True) == pytest.approx(
        factor * typical
    )
    stated = survey_of(0.01, 3, "analog")
    assert phase_uncertainty(stated) == 0.01
    assert math.degrees(MIXER) == pytest.approx(0.64, abs=0.006)


def sea_of(calibration: dict[str, Any] | None = None, **water: Any) -> Survey:
    """Return a survey of sea water, some of whose state is not known."""
    text = "\n".join(
        [
            'name = "Sea"', "[water]", 'kind = "pure"',
            *(f"{name} = {value}" for name, value in water.items()),
            "[instrument]", 'wavelength = "532 nm"', 'power = "20 mW"',
            "modulation_depth = 0.8", 'polarizations = ["VH"]',
            'modulation_frequencies = ["39 MHz"]', "[instrument.receiver]",
            'position = ["10 cm", "0 m", "0 m"]', 'azimuth = "-3 deg"',
            'radius = "2 cm"', 'acceptance = "0.06 rad"', "[scan]", "columns = 2",
            "rows = 2", 'dwell = "100 ms"', 'azimuth_span = "1 deg"',
            'elevation_span = "1 deg"',
            *(["[calibration]"] if calibration else []),
            *(f"{name} = {value}" for name, value in (calibration or {}).items()),
        ]
    )  # fmt: skip
    return Survey.from_text(text)


def index(temperature: Any, salinity: Any) -> Any:
    return seawater.group_index(532e-9, temperature=temperature, salinity=salinity)


def test_an_unknown_state_spreads_the_group_index() -> None:
    known = sea_of(temperature='"15 degC"', salinity=20.0)
    assert group_index_uncertainty(known) is None
    state = state_of(known.water)
    assert state == {"temperature": 15.0, "salinity": 20.0}
    low, high = SALINITIES
    salty = sea_of(temperature='"15 degC"')
    nominal = state_of(salty.water)
    # Evenly over all salinities, from that which is assumed.
    values = index(15.0, np.linspace(low, high, 20_001))
    expected = np.sqrt(np.mean((values - index(**nominal)) ** 2))
    found = group_index_uncertainty(salty)
    assert found == pytest.approx(expected, rel=2e-3)
    warm = sea_of(salinity=20.0)
    cold, hot = TEMPERATURES
    nominal = state_of(warm.water)
    values = index(np.linspace(cold, hot, 20_001), 20.0)
    expected = np.sqrt(np.mean((values - index(**nominal)) ** 2))
    assert group_index_uncertainty(warm) == pytest.approx(expected, rel=2e-3)


def test_a_measured_state_has_its_errors() -> None:
    stated: dict[str, Any] = {
        "temperature_uncertainty": '"0.7 degC"',
        "salinity_uncertainty": 1.5,
    }
    survey = sea_of(stated, temperature='"15 degC"', salinity=20.0)
    by_temperature = (index(15.5, 20.0) - index(14.5, 20.0)) / 1.0
    by_salinity = (index(15.0, 20.5) - index(15.0, 19.5)) / 1.0
    expected = math.hypot(0.7 * by_temperature, 1.5 * by_salinity)
    assert group_index_uncertainty(survey) == pytest.approx(expected, rel=1e-6)
    # One of them is not enough, unless the other one spreads as it is unknown.
    one: dict[str, Any] = {"temperature_uncertainty": '"0.7 degC"'}
    assert (
        group_index_uncertainty(sea_of(one, temperature='"15 degC"', salinity=20.0))
        is None
    )
    salty = sea_of(one, temperature='"15 degC"')
    spread = group_index_uncertainty(sea_of(temperature='"15 degC"'))
    assert spread is not None
    nominal = state_of(salty.water)["salinity"]
    slope = index(15.5, nominal) - index(14.5, nominal)
    assert group_index_uncertainty(salty) == pytest.approx(
        math.hypot(spread, 0.7 * slope)
    )
    # At the limits of the formula by one side.
    edge = sea_of(stated, temperature='"0 degC"', salinity=43.0)
    by_temperature = (index(0.5, 43.0) - index(0.0, 43.0)) / 0.5
    by_salinity = (index(0.0, 43.0) - index(0.0, 42.5)) / 0.5
    expected = math.hypot(0.7 * by_temperature, 1.5 * by_salinity)
    assert group_index_uncertainty(edge) == pytest.approx(expected, rel=1e-6)


def test_a_stated_index_has_a_stated_error() -> None:
    survey = sea_of({"group_index_uncertainty": 2e-4})
    assert group_index_uncertainty(survey) == 2e-4
    fixed = sea_of(group_index=1.36)
    assert group_index_uncertainty(fixed) is None


def test_water_of_no_scattering_has_no_moments() -> None:
    clear = sea_of(temperature='"15 degC"')
    optics: Any = SimpleNamespace(phase_function=None, scattering=0.0)
    assert properties._moments(clear, optics) == (0.0, 0.0, 0.0)


def test_crosstalk_is_one_value_or_one_for_each_frequency(plate: Survey) -> None:
    name = "instrument.errors"
    for amplitude in (1e-3, [1e-3]):
        survey = plate.with_({name: {"crosstalk": {"amplitude": amplitude}}})
        assert survey.instrument.errors is not None
    with pytest.raises(
        SurveyError, match=r"crosstalk\.amplitude has 2 values for 1 mod"
    ):
        plate.with_({name: {"crosstalk": {"amplitude": [1e-3, 2e-3]}}})
