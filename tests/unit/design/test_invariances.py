"""What must hold for any instrument, water and target."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.design import evaluate
from amulor.survey import Survey

from .conftest import SURVEY

TANK = Survey.from_text(SURVEY)

instruments = st.fixed_dictionaries(
    {
        "power": st.floats(1e-3, 0.2),
        "radius": st.floats(5e-3, 5e-2),
        "field_of_view": st.floats(0.02, 0.1),
        "reflectance": st.floats(0.05, 0.9),
        "frequency": st.floats(5e6, 300e6),
        "dwell": st.floats(1e-2, 1.0),
    }
)
methods = st.sampled_from(["none", "open-water", "joint"])


@settings(deadline=None, max_examples=12)
@given(instrument=instruments, method=methods, attenuation=st.floats(0.05, 1.5))
def test_noise_rises_with_distance_and_falls_with_power(
    instrument, method, attenuation
) -> None:
    # One axis for both, so that near targets are in view.
    fixed = {**instrument, "baseline": 0.0, "attenuation": attenuation}
    echo = evaluate(TANK, **fixed, distance=np.linspace(0.3, 8, 12))
    assert np.all(np.diff(echo["shot"]) > 0)
    assert np.all(np.diff(echo["signal"]) < 0)
    fixed["power"] = instrument["power"] * np.array([1.0, 3.0, 10.0])
    strong = evaluate(TANK, **fixed, distance=2.0, method=method)
    for name in ("standard_uncertainty", "total_error", "dark"):
        assert np.all(np.diff(strong[name]) <= 0)
    # Twice the light is the root of two better, in counting it.
    if method != "joint":
        assert_allclose(strong["shot"] * fixed["power"] ** 0.5, strong["shot"][0]
                        * fixed["power"][0] ** 0.5, rtol=1e-6)  # fmt: skip


@settings(deadline=None, max_examples=12)
@given(instrument=instruments, distance=st.floats(0.5, 6))
def test_noise_rises_with_the_turbidity_of_the_water(instrument, distance) -> None:
    found = evaluate(
        TANK,
        **instrument,
        baseline=0.0,
        distance=distance,
        attenuation=np.geomspace(0.05, 2, 10),
    )
    assert np.all(np.diff(found["shot"]) > 0)
    assert np.all(np.diff(found["signal"]) < 0)


@settings(deadline=None, max_examples=8)
@given(instrument=instruments, factor=st.floats(1.5, 8))
def test_a_phase_floor_is_a_length_that_falls_with_the_frequency(
    instrument, factor
) -> None:
    first = instrument.pop("frequency")
    found = evaluate(
        TANK,
        **instrument,
        distance=1.0,
        frequency=[first, first * factor],
        scattering=0.0,
        absorption=0.1,
    )
    floor, shot = found["phase_floor"].values, found["shot"].values
    assert_allclose(floor[0] / floor[1], factor, rtol=1e-9)
    assert_allclose(shot[0] / shot[1], factor, rtol=1e-9)
