"""Steps of rounded outputs are found, and their error is stated."""

from __future__ import annotations

import numpy as np
import pytest

from amulor import imaging, rejection
from amulor.errors import CubeError
from amulor.imaging.instrument_tests import instrument_tests
from amulor.rejection.observation import Observation
from amulor.rejection.resolution import resolution_of, step_of, with_resolution
from amulor.simulation import simulate
from amulor.studies.trust.scenes.instrument import Recorded, resolution, with_outputs
from amulor.studies.trust.surveys import plate, survey

PLATE = plate(2.6, lean=20.0)
rng = np.random.default_rng(5)


@pytest.mark.parametrize("step", [1e-9, 3.7e-5, 0.25])
def test_a_grid_of_values_has_a_step(step: float) -> None:
    values = step * rng.integers(-300, 300, 500) + 0.3 * step
    assert step_of(values) == pytest.approx(step, rel=1e-6)


def test_a_grid_written_with_few_digits_has_a_step() -> None:
    values = np.round(2.114e-4 * rng.integers(-30, 30, 500), 9)
    assert step_of(values) == pytest.approx(2.114e-4, rel=1e-4)


@pytest.mark.parametrize(
    "values",
    [
        rng.normal(size=1000),
        rng.normal(size=8),
        rng.normal(size=1000).astype(np.float32).astype(float),
        np.repeat(rng.normal(size=20), 30),
        np.ones(100),
        np.empty(0),
    ],
    ids=["many", "few", "single precision", "repeated", "equal", "none"],
)
def test_values_without_a_grid_have_no_step(values: np.ndarray) -> None:
    assert step_of(values) == 0


def test_a_step_below_the_noise_changes_nothing() -> None:
    scan = Observation(cube=simulate(survey(2, PLATE, columns=6, rows=4), rng=1))
    noise = float(np.median(scan.covariance.in_phase[0, 0] ** 0.5))
    recorded = Recorded(2, 1, cube=scan.cube)
    fine = 0.2 * noise / float(recorded.echo[0, 0])
    cube = with_outputs(scan.cube, *resolution(fine)(recorded))
    rounded = Observation(cube=cube)
    assert resolution_of(rounded).scan[0, 0] == 0
    assert with_resolution(scan, resolution_of(scan)) is scan


def test_rounding_is_in_the_stated_errors_once() -> None:
    cube = simulate(survey(1, PLATE, columns=16, rows=4), rng=1)
    recorded = Recorded(1, 1, cube=cube)
    step = 0.03 * float(recorded.echo[0, 0])
    rounded = Observation(cube=with_outputs(cube, *resolution(0.03)(recorded)))
    steps = resolution_of(rounded)
    assert steps.scan[0, 0] == pytest.approx(step)
    corrected = with_resolution(rounded, steps)
    # Variance of a uniform distribution as wide as the step.
    added = corrected.covariance.in_phase - rounded.covariance.in_phase
    np.testing.assert_allclose(added[0, 0], step**2 / 12)
    assert corrected.shots is not None
    shared = corrected.shots.common_covariance
    assert shared is not None
    np.testing.assert_allclose(shared.quadrature[0, 0], step**2 / 12)
    assert with_resolution(corrected, steps) is corrected


def test_coarse_outputs_are_named_and_their_ranges_hold() -> None:
    cube = simulate(survey(1, PLATE, columns=16, rows=6), rng=1)
    outputs = resolution(0.03)(Recorded(1, 1, cube=cube))
    target = rejection.combined(with_outputs(cube, *outputs), interval=(2.1, 3.1))
    image = imaging.range_image(target, interval=(2.1, 3.1))
    (test,) = [t for t in instrument_tests(image) if t.name == "resolution"]
    assert "resolution of the demodulator" in test.cause
    error = image["slant_range"] - cube.amulor.truth["slant_range"]
    off = np.abs(error / image["slant_range_uncertainty"]).values
    # Without the rounding error, half of these pixels were more than 3.5 off.
    assert np.nanmax(off) < 3


def test_water_below_the_resolution_has_no_ratio() -> None:
    cube = simulate(survey(1, PLATE, columns=4, rows=2), rng=1)
    recorded = Recorded(1, 1, cube=cube)
    coarse = with_outputs(cube, *resolution(10.0)(recorded))
    with pytest.raises(CubeError, match="0 V in all"):
        rejection.water_ratio(coarse)
