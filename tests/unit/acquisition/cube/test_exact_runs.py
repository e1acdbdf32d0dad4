"""Temperature runs, references and closed shutters with given signals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from exact_samples import plate_at, samples
from numpy.testing import assert_allclose

from amulor.acquisition import (
    from_reference,
    from_shutter,
    from_temperatures,
)
from amulor.acquisition.cube import calibrate
from amulor.errors import CubeError
from amulor.survey import Survey


def warm(small: Survey, temperature: float | None, phase: object, **more: object):
    survey = small.with_({"scan.instrument_temperature": temperature})
    return plate_at(1.0, phase, survey=survey.to_toml(), **more)


def test_the_phase_per_degree_is_a_weighted_line(small: Survey) -> None:
    degrees = np.array([10.0, 24.0, 17.0, 13.0])
    sizes = np.array([1.0, 0.5, 2.0, 1.0])
    phases = np.array([0.1, 0.5, 0.25, 0.21])
    plates = [
        warm(small, degree, np.array([phase, 3.0 - 0.01 * degree]), size=(size, 0.1))
        for degree, size, phase in zip(degrees, sizes, phases, strict=True)
    ]
    result = from_temperatures(plates)
    assert result.reference_temperature == 16.0
    first, second = result.temperature
    order = np.argsort(degrees)
    assert first.temperatures == (10.0, 13.0, 17.0, 24.0)
    # Weighted by the squares of amplitude over error, 1 mV.
    weight = (sizes[order] / 1e-3) ** 2
    warmer = degrees[order] - 16
    phase = phases[order] - phases[0]
    centre = np.average(warmer, weights=weight)
    spread = (weight * (warmer - centre) ** 2).sum()
    slope = (weight * (warmer - centre) * phase).sum() / spread
    level = np.average(phase, weights=weight) - slope * centre
    assert first.phase_per_degree == pytest.approx(slope)
    assert_allclose(first.phases, phase - level, atol=1e-9)
    # Four phases scatter about two unknowns by much more than 1 mrad.
    excess = (weight * (phase - level - slope * warmer) ** 2).sum() / 2
    assert excess > 10
    assert first.uncertainty == pytest.approx(math.sqrt(excess / spread))
    assert second.phase_per_degree == pytest.approx(-0.01)
    assert second.uncertainty == pytest.approx(1 / math.sqrt(spread))


def test_a_temperature_run_has_three_plates_two_degrees_apart(small: Survey) -> None:
    plates = [warm(small, degree, 0.0) for degree in (10.0, 11.0, 12.0)]
    assert len(from_temperatures(plates).temperature) == 2
    near = [warm(small, degree, 0.0) for degree in (10.0, 11.0, 11.9)]
    cold = [warm(small, degree, 0.0) for degree in (10.0, None, 12.0)]
    no_survey = [*plates[:2], plate_at(1.0)]
    dark = [warm(small, degree, 0.0) for degree in (10.0, 11.0, 12.0)]
    dark[2]["quality_flag"][1] = 4
    for cubes, text in (
        (plates[:2], "2 cubes; at least 3 are needed, at different temperatures"),
        (
            near,
            "the temperatures differ by 1.9 degC; at least 2 degC are needed",
        ),
        (
            cold,
            "cube 2 states no temperature; state scan.instrument_temperature in the "
            "survey of each recording",
        ),
        (
            no_survey,
            "cube 3 states no temperature; state scan.instrument_temperature in the "
            "survey of each recording",
        ),
        (
            dark,
            "no pixel in the middle of the scan shows a target at 50 MHz; let the "
            "plate fill the middle half of the scan",
        ),
    ):
        with pytest.raises(CubeError) as caught:
            from_temperatures(cubes)
        assert str(caught.value) == text


def test_phases_of_a_reference_are_those_of_its_cube() -> None:
    cube = samples(0.0).assign_attrs(
        time_coverage_start="2026-06-10T12:00:00Z",
        reference_phase_rad=[0.1, 0.2, 0.3, 0.4],
        reference_phase_uncertainty_rad=[0.01, 0.02],
        reference_time_s=np.arange(8) + 100.0,
        reference_drift_rad=np.arange(8) / 10,
    )
    result = from_reference(cube)
    assert str(result.date) == "2026-06-10"
    found = [
        (e.modulation_frequency, e.polarization, e.phase, e.uncertainty, e.times)
        for e in result.reference
    ]
    assert found == [
        (20e6, "VV", 0.1, 0.01, (0.0, 1.0)),
        (20e6, "VH", 0.2, 0.01, (2.0, 3.0)),
        (50e6, "VV", 0.3, 0.02, (4.0, 5.0)),
        (50e6, "VH", 0.4, 0.02, (6.0, 7.0)),
    ]
    assert [e.changes for e in result.reference] == [
        (0.0, 0.1), (0.2, 0.3), (0.4, 0.5), (0.6, 0.7)
    ]  # fmt: skip
    assert from_reference(cube.assign_attrs(time_coverage_start=None)).date is None


def closed(signal: object, **attributes: object) -> xr.Dataset:
    return samples(
        np.asarray(signal) * np.ones((2, 2, 1, 4)), shutter="closed", **attributes
    )


def test_leakage_is_the_mean_of_shutters_with_the_error_of_its_change() -> None:
    value = np.array([[1.0, 2j], [3.0, 4.0]])[..., None, None]
    cubes = [closed(value), closed(value + 0.1j), closed(value + 0.4j)]
    cubes[0] = cubes[0].assign_attrs(time_coverage_start="2026-06-11T00:00:00Z")
    result = from_shutter(cubes)
    assert str(result.date) == "2026-06-11"
    mean = value[..., 0, 0] + 0.5j / 3
    # Three cubes of four samples of 1 mV each; half a volt of change is most of it.
    statistical = 1e-3 / 2 / math.sqrt(3)
    error = math.hypot(statistical, 0.4 / math.sqrt(12))
    for leak, expected in zip(result.leakage, mean.ravel(), strict=True):
        assert_allclose(leak.scan, [expected.real, expected.imag])
        assert_allclose(leak.open_water, leak.scan)
        assert leak.scan_uncertainty == pytest.approx(error)
        assert leak.change == pytest.approx(0.4)
    (one,) = {leak.change for leak in from_shutter(cubes[:1]).leakage}
    assert one is None
    dark = closed(value, dark_uncertainty=np.array([1, 2, 3, 4]) * 1e-2)
    errors = [leak.scan_uncertainty for leak in from_shutter([dark]).leakage]
    assert_allclose(errors, np.hypot(1e-3 / 2, np.array([1, 2, 3, 4]) * 1e-2))


def test_shutters_must_be_alike() -> None:
    first = closed(1.0)
    others = {
        "polarization": samples(1.0, channels=("VV", "VP"), shutter="closed"),
        "frequency": samples(1.0, frequencies=(20e6, 51e6), shutter="closed"),
    }
    for other in others.values():
        with pytest.raises(CubeError) as caught:
            from_shutter([first, other])
        assert str(caught.value) == (
            "the cubes with the shutter closed differ in frequencies or channels; "
            "record all of them with one survey"
        )
    empty = closed(1.0)
    empty["in_phase"][1, 0] = np.nan
    with pytest.raises(CubeError) as caught:
        from_shutter([empty])
    assert str(caught.value) == (
        "a channel has no sample with the shutter closed; record it with: amulor "
        "acquire --shutter-closed"
    )


def test_unequal_errors_of_outputs_are_averaged() -> None:
    cube = closed(1.0)
    like = cube["in_phase"]
    cube = cube.assign(
        in_phase_uncertainty=like.copy(data=np.full(like.shape, 3e-3)),
        quadrature_uncertainty=like.copy(data=np.full(like.shape, 5e-3)),
    )
    mean, error = calibrate.mean_output(cube)
    assert_allclose(mean, 1)
    assert_allclose(error, math.sqrt((9e-6 + 25e-6) / 2 / 4))
    # A single sample of a channel is enough.
    cube["quadrature"][0, 0, 0, 1:] = np.nan
    assert calibrate.mean_output(cube)[1][0, 0] == pytest.approx(math.sqrt(17e-6))
