"""Late light is no change of the water: seven attenuation lengths of harbor water."""

from __future__ import annotations

import numpy as np
import pytest

from amulor import pipeline, rejection
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY
from amulor.rejection.observation import Observation
from amulor.rejection.reference.late_phase import late_phase
from amulor.studies.benchmark.scenes import read
from amulor.studies.trust.case import Case


@pytest.fixture(scope="module")
def case() -> Case:
    """Return a plate at 3.2 m, whose echo photon transport has computed."""
    return next(s for s in read() if s.name == "harbour-white-7-lengths").case()


def test_late_light_is_no_change_of_the_water(case: Case) -> None:
    target = rejection.open_water(case.samples, interval=case.interval)
    change = target.attrs["open_water_change"]
    # Shots and scan have the same water. Its change was 1.8 +- 0.5 %.
    assert abs(change) < 2 * target.attrs["open_water_change_uncertainty"] < 0.02
    image = pipeline.run(target, polarization="VV", interval=case.interval)
    late, error = (
        np.median(image[f"slant_range_{name}"].values)
        for name in ("late_echo", "uncertainty_late_echo")
    )
    assert error / late == pytest.approx(RELATIVE_UNCERTAINTY, rel=0.02)
    # Excess delay of the echo by photon transport.
    assert late == pytest.approx(float(np.median(case.late)), abs=2 * error)


def test_late_phases_grow_with_the_square_of_the_distance(case: Case) -> None:
    scan = Observation(cube=case.samples)
    path = np.full(scan.signal.shape[2:], 9.0)
    path[0] = 4.5
    path[1] = np.nan
    late = late_phase(scan, path)
    assert late is not None
    phase, error = late
    np.testing.assert_allclose(phase[:, 2] / phase[:, 0], 4.0, rtol=1e-9)
    assert np.isnan(phase[:, 1]).all()
    # High frequencies are less late than low ones.
    assert (phase[0, 2] > 0).all()
    assert (phase[-1, 2] < 0).all()
    np.testing.assert_allclose(error[:, 2], 0.3 * phase[:, 2])


def test_scans_without_late_light_have_no_late_phase(case: Case) -> None:
    cube = case.samples.assign_attrs(late_echo="absent")
    scan = Observation(cube=cube)
    assert late_phase(scan, np.full(scan.signal.shape[2:], 9.0)) is None
