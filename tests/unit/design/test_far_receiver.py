"""A receiver that stands far aside sees nothing near, and the light stays in bounds."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.design import evaluate
from amulor.simulation import expectation
from amulor.survey import Survey


@pytest.mark.parametrize("water", ["as stated", "II"])
def test_light_of_a_far_receiver_is_that_of_the_simulation(water: str) -> None:
    survey = Survey.preset("amulor-2010-long").with_(
        {"scan.columns": 1, "scan.rows": 1, "scan.azimuth_span": 0.0,
         "scan.elevation_span": 0.0, "instrument.lock_in.phase_floor": 0.0}
    )  # fmt: skip
    if water == "II":
        sea = {"kind": "jerlov", "type": "II", "source": "williamson-hollins-2022"}
        survey = survey.with_({"water": sea})
    frequencies = survey.instrument.modulation_frequencies
    found = evaluate(survey, distance=5.6, frequency=list(frequencies))
    # The echo over the noise of one sample turns into a range: u(R) = v u / (4 pi f s).
    expected = expectation(survey).signal_to_noise[:, 0]
    index = 1.34 if water == "as stated" else 1.38
    scale = 299792458.0 / index / (4 * np.pi * np.array(frequencies))
    own = np.sqrt(sum(found[name] ** 2 for name in ("shot", "dark"))).values.ravel()
    # The index of sea water is 1.37 to 1.39 at 405 nm; noise is stated to 1 %.
    np.testing.assert_allclose(own, scale / expected, rtol=0.02)
    assert not found["saturated"].any()
    assert float(found["saturation"].max()) < 0.1
