"""Joint estimation on cubes: what it must refuse, what must not change it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import xarray as xr
from late_echo import late_transfer, with_echo
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.stats import chi2

from amulor import cube as cubes
from amulor import rejection, simulate
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.errors import CubeError
from amulor.rejection.joint import estimate
from amulor.survey import Survey

Sweep = Callable[..., Survey]
INTERVAL = (0.8, 4.0)
#: Joint estimation with an instrument that is what the survey says, to the last bit,
#: and light that is not late: so it is simulated.
joint = functools.partial(
    rejection.joint,
    delay_uncertainty=0.0,
    group_index_uncertainty=0.0,
    receiver_position_uncertainty=0.0,
    late_echo_uncertainty=0.0,
)


@pytest.fixture(scope="module")
def found(samples: xr.Dataset) -> xr.Dataset:
    return joint(samples, interval=INTERVAL)


def test_the_result_is_a_target_signal_cube(found: xr.Dataset) -> None:
    cubes.check(found, "target_signal")
    assert found["joint_slant_range"].dims == ("row", "column")
    assert found.attrs["joint_fluctuation"] == pytest.approx(0.05, rel=0.15)


def test_the_slant_range_is_that_of_the_scene(found: xr.Dataset) -> None:
    truth = found.amulor.truth["slant_range"].values
    error = found["joint_slant_range"].values - truth
    z = error / found["joint_slant_range_uncertainty"].values
    assert (found["quality_flag"].values == 0).mean() > 0.95
    # 72 pixels: four standard errors of their mean square.
    assert abs(np.mean(z**2) - 1) < 4 * np.sqrt(2 / z.size)


def test_the_bound_is_that_of_phases_whose_water_is_known(sweep: Sweep) -> None:
    # Shots leave 0.1 % of the error to the water where nothing but noise is in them.
    calm = {
        'signal_fluctuation = "5 %"': "",
        'phase_floor = "0.06 deg"': 'phase_floor = "0 deg"',
    }
    samples = simulate(sweep(**calm), rng=4)
    found = joint(samples, interval=INTERVAL)
    truth, noise = samples.amulor.truth, samples["in_phase_uncertainty"].values
    size = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values
    turn = 4 * np.pi * samples["modulation_frequency"].values * 1.38 / speed_of_light
    information = ((turn[:, None, None, None] * size / noise) ** 2).sum(axis=(0, 1))
    assert_allclose(
        found["joint_slant_range_bound"].values, information**-0.5, rtol=0.003
    )


def test_what_is_taken_out_is_the_water_up_to_the_target(found: xr.Dataset) -> None:
    truth = found.amulor.truth
    water = truth["water_in_phase"].values + 1j * truth["water_quadrature"].values
    # The truth holds the mean water signal, which the shots settle to 1 %.
    size = np.abs(water).max(axis=(1, 2, 3), keepdims=True)
    assert_allclose(found.amulor.water_signal.values / size, water / size, atol=0.02)


def test_it_does_without_open_water(samples: xr.Dataset) -> None:
    bare = samples.drop_vars(
        [name for name in samples.data_vars if str(name).startswith("open_water_")]
    )
    found = joint(bare, interval=INTERVAL)
    truth = found.amulor.truth["slant_range"].values
    error = found["joint_slant_range"].values - truth
    z = error / found["joint_slant_range_uncertainty"].values
    assert np.sqrt(np.mean(z**2)) < 1.5


def test_truth_and_the_stated_water_are_not_read(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    other = samples.drop_vars(
        [name for name in samples.data_vars if str(name).startswith("truth_")]
    )
    text = other.attrs["survey"]
    for old, new in (("0.255", "0.9"), ("0.595", "0.1"), ("0.001", "0.5")):
        assert old in text
        text = text.replace(old, new)
    again = joint(other.assign_attrs(survey=text), interval=INTERVAL)
    np.testing.assert_array_equal(
        again["joint_slant_range"], found["joint_slant_range"]
    )


def test_scale_of_the_signal_changes_nothing_else(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    factor = 8.0
    scaled = samples.copy(deep=True)
    for name in scaled.data_vars:
        units = scaled[name].attrs.get("units")
        if not str(name).startswith("truth_") and units in ("V", "V2"):
            scaled[name] = scaled[name] * factor ** (2 if units == "V2" else 1)
            scaled[name].attrs["units"] = units
            scaled[name].attrs["long_name"] = samples[name].attrs["long_name"]
    again = joint(scaled, interval=INTERVAL)
    for name in ("slant_range", "slant_range_uncertainty"):
        assert_allclose(again[f"joint_{name}"], found[f"joint_{name}"], rtol=1e-6)
    assert_allclose(again["in_phase"], factor * found["in_phase"], rtol=1e-4, atol=1e-9)


def test_open_water_pixels_are_told_from_targets(sweep: Sweep) -> None:
    survey = sweep(**{'width = "30 cm"': 'width = "5 cm"'})
    cube = simulate(survey, rng=6)
    hit = cube.amulor.truth["target"].values >= 0
    assert 0.1 < hit.mean() < 0.9
    flag = joint(cube, interval=INTERVAL)["quality_flag"].values[0, 0]
    seen = (flag & QualityFlag.NO_TARGET) == 0
    np.testing.assert_array_equal(seen, hit)


def test_lost_and_saturated_samples_are_flagged_and_left_out(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    broken = samples.copy(deep=True)
    broken["in_phase"][2, 0, 1, 1] = np.nan
    broken["saturated"][3, 0, 2, 2] = 1
    broken["in_phase"][3, 0, 2, 2] = 1e3
    again = joint(broken, interval=INTERVAL)
    flag = again["quality_flag"].values
    assert flag[2, 0, 1, 1] == QualityFlag.MISSING
    assert flag[3, 0, 2, 2] & QualityFlag.SATURATED
    moved = abs(again["joint_slant_range"] - found["joint_slant_range"])
    assert float((moved / found["joint_slant_range_uncertainty"]).max()) < 3


def test_two_surfaces_in_one_pixel_are_flagged(samples: xr.Dataset) -> None:
    mixed = samples.copy(deep=True)
    frequency = samples["modulation_frequency"].values
    echo = 0.5 * np.abs(samples.amulor.signal.values[0, 0, 3, 5])
    delay = 4 * np.pi * frequency * 1.38 * 2.4 / speed_of_light
    mixed["in_phase"][:, 0, 3, 5] += echo * np.cos(delay)
    mixed["quadrature"][:, 0, 3, 5] += echo * np.sin(delay)
    flag = joint(mixed, interval=INTERVAL)["quality_flag"].values[0, 0]
    assert flag[3, 5] & QualityFlag.WATER_RESIDUAL
    assert (flag != 0).sum() <= 3


def test_an_echo_that_is_late_is_flagged_where_each_pixel_agrees(
    samples: xr.Dataset,
) -> None:
    transfer = late_transfer(samples["modulation_frequency"].values, length=0.04)
    found = joint(with_echo(samples, transfer), interval=INTERVAL)
    error = found["joint_slant_range"] - samples.amulor.truth["slant_range"]
    missed = np.abs(error / found["joint_slant_range_uncertainty"]) > 1.96
    assert missed.mean() > 0.9
    flag = found["quality_flag"].values[0, 0] & QualityFlag.WATER_RESIDUAL
    assert (flag != 0).mean() > 0.9


def test_frequencies_close_together_leave_the_interval_open(plate_text: str) -> None:
    text = plate_text.replace('["39 MHz"]', '["100 MHz", "100.2 MHz"]')
    text = text.replace('["VV", "VH"]', '["VV"]')
    text = text.replace('"0.06 deg"', '"1 deg"')
    found = joint(simulate(Survey.from_text(text), rng=1), interval=INTERVAL)
    wrong = found["joint_wrong_interval_probability"].values
    flag = found["quality_flag"].values[0, 0]
    # 0.2 MHz apart the phases of neighbouring intervals differ by 0.7 degrees only.
    assert np.nanmedian(wrong) > 0.1
    assert ((flag & QualityFlag.AMBIGUOUS) != 0).mean() > 0.9


def test_what_cannot_be_estimated_is_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="one modulation frequency, 12 MHz"):
        joint(samples.isel(modulation_frequency=[0]))
    bare = samples.copy()
    del bare.attrs["survey"]
    with pytest.raises(CubeError, match="no attribute 'survey'"):
        joint(bare)
    silent = samples.copy(deep=True)
    silent["in_phase_uncertainty"][:] = 0
    silent["in_phase_quadrature_covariance"][:] = 0
    with pytest.raises(CubeError, match="must be above 0 V"):
        joint(silent)
    text = samples.attrs["survey"]
    keyhole = text.replace('acceptance = "0.08 rad"', 'acceptance = "1e-4 rad"')
    far = text.replace('"0.07 m",', '"5000 m",')
    assert text not in (keyhole, far)
    # 38 degrees seen through a view that is a degree or two wide.
    wide = samples.assign_coords(azimuth=10 * samples["azimuth"])
    with pytest.raises(CubeError, match="split the scan"):
        joint(wide.assign_attrs(survey=keyhole))
    with pytest.raises(CubeError, match="does not see the beam"):
        joint(samples.assign_attrs(survey=far))
    with pytest.raises(ValueError, match="each of the 6 modulation frequencies"):
        joint(samples, echo_transfer=np.ones(3))
    with pytest.raises(ValueError, match="interval must run"):
        joint(samples, interval=(3.0, 1.0))


def test_a_small_second_echo_contradicts_the_model_as_chi_square_says(
    samples: xr.Dataset,
) -> None:
    mixed = samples.copy(deep=True)
    delay = 4 * np.pi * samples["modulation_frequency"].values * 1.38 * 2.4
    echo = 0.004 * np.abs(samples.amulor.signal.values[0, 0, 3, 5])
    echo = echo * np.exp(1j * delay / speed_of_light)
    mixed["in_phase"][:, 0, 3, 5] += echo.real
    mixed["quadrature"][:, 0, 3, 5] += echo.imag
    found = joint(mixed, interval=INTERVAL)
    cause = found["water_residual_cause"].values[:, 0]
    assert (cause[:, 3, 5] == WaterResidualCause.MODEL_MISFIT).all()
    chance = found["joint_misfit_probability"].values
    assert chance[3, 5] < 1e-4
    # Two of six samples are left out: eight outputs, of a path and an amplitude.
    misfit = float(found["joint_misfit"][3, 5])
    assert chance[3, 5] == pytest.approx(chi2.sf(6 * misfit, 6), rel=1e-6)
    good = found["quality_flag"].values[0, 0] == 0
    assert (cause[0][good] == 0).all()
    assert chance[good].min() > 1e-4
    assert np.mean(chance[good]) == pytest.approx(0.5, abs=4 * 0.29 / good.sum() ** 0.5)


def test_an_echo_that_is_late_states_the_shift_and_its_limit(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    transfer = late_transfer(samples["modulation_frequency"].values, length=0.04)
    late = joint(with_echo(samples, transfer), interval=INTERVAL)
    assert (late["water_residual_cause"] == WaterResidualCause.MODEL_DEPARTURE).all()
    # Three tenths of all other uncertainty: a delay that is common goes unseen.
    shift, limit = (late[f"joint_departure{each}"].values for each in ("", "_limit"))
    total = late["joint_slant_range_uncertainty"].values
    assert_allclose(limit, 0.3 * np.sqrt(total**2 - shift**2), rtol=1e-6)
    assert (shift > limit).all()
    assert (found["joint_departure"].values == 0).all()
    assert (found["water_residual_cause"].values == 0).all()


@pytest.mark.parametrize(("off", "named"), [(0.3, "0.3"), (-0.4, "-0.4")])
def test_a_window_at_several_distances_is_refused(monkeypatch, off, named) -> None:
    medium = SimpleNamespace(window_distance=0.1)
    emitter = SimpleNamespace(position=(0.0, 0.0, 0.05))
    survey = SimpleNamespace(instrument=SimpleNamespace(emitter=emitter))
    frame = SimpleNamespace(medium=medium, survey=survey)
    extent = SimpleNamespace(azimuth=np.zeros(3), elevation=np.zeros(3))
    monkeypatch.setattr(estimate, "_extent_of", lambda scan: extent)
    monkeypatch.setattr(estimate, "shot_directions", lambda *_: np.zeros((2, 1)))
    monkeypatch.setattr(estimate, "frame_of", lambda *_: frame)
    # The second of two bands is farther from the window, or nearer.
    places = {0: np.full((1, 2), 0.05), 1: np.array([[0.05, 0.05 + off]])}
    scan: Any = SimpleNamespace(
        head=SimpleNamespace(shots=None), bands=[(0, 1), (1, 2)],
        tile=lambda begin, end: SimpleNamespace(origin_z=places[begin]),
    )  # fmt: skip
    with pytest.raises(CubeError, match=f"origin_z is up to {named} m off the emitter"):
        estimate.common_of(
            scan, interval=None, transfer=np.ones(1), instrument=cast(Any, None)
        )
