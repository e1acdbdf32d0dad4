"""The error budget of range images: terms, their sum, coverage, what is not known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag
from amulor.cube.terms import RANGE_PREFIX, TERMS
from amulor.imaging.geometry import beams_of, medium_of, receivers_of
from amulor.optics import rays
from amulor.simulation import simulate
from amulor.survey import Survey

CALIBRATION = """
[calibration]
date = 2026-05-01
delay_uncertainty = "{delay} ns"
receiver_position_uncertainty = "{place} mm"
direction_uncertainty = "{turn} deg"
group_index_uncertainty = {index}
"""
STATED = CALIBRATION.format(delay=0.1, place=3, turn=0.5, index=0.001)
WINDOW = '[instrument.window]\ndistance = "30 cm"\nthickness = "2 cm"\n'


@pytest.fixture(scope="module")
def text(plate_text: str) -> str:
    return plate_text.replace('["39 MHz"]', '["39 MHz", "97 MHz"]')


@pytest.fixture(scope="module")
def target(text: str) -> xr.Dataset:
    return rejection.open_water(simulate(Survey.from_text(text), rng=2))


def surveyed(cube: xr.Dataset, text: str) -> xr.Dataset:
    return cube.assign_attrs(survey=Survey.from_text(text).to_toml())


def terms_of(image: xr.Dataset) -> dict[str, Any]:
    names = [f"{RANGE_PREFIX}{name}" for name in TERMS]
    return {
        name.removeprefix(RANGE_PREFIX): image[name].values
        for name in names
        if name in image
    }


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("tail", ["", STATED])
def test_the_squares_of_the_terms_add_up_in_every_pixel(target, text, tail, measured):
    cube = surveyed(target, text + tail)
    if measured:
        cube = cube.assign_attrs(late_echo="present")
    image = imaging.range_image(cube, polarization="VH")
    cubes.check(image, "range_image")
    terms = terms_of(image)
    known = {"delay", "group_index", "geometry"} if tail else set()
    known |= {"late_echo"} if measured else set()
    assert known <= set(terms)
    usable = image["slant_range"].notnull().values
    assert usable.sum() > 50
    total = image["slant_range_uncertainty"].values
    squares = np.sum([term**2 for term in terms.values()], axis=0)
    assert_allclose(squares[usable], total[usable] ** 2, rtol=1e-12)
    for term in terms.values():
        assert (term[usable] > 0).all()
        assert np.isnan(term[~usable]).all()
    common = image["slant_range_common_uncertainty"].values
    shared = np.sum([terms[name] ** 2 for name in known] or [0 * total], axis=0)
    assert (common[usable] ** 2 >= shared[usable] * (1 - 1e-12)).all()
    assert (common[usable] <= total[usable]).all()


def test_what_nobody_knows_is_said_and_is_no_zero(target, text):
    image = imaging.range_image(target, polarization="VH")
    assert image.attrs["uncertainty_unknown"] == "delay group_index geometry"
    assert image.attrs["late_echo_correction"] == "absent from this simulation"
    measured = target.assign_attrs(late_echo="present")
    del measured.attrs["survey"]
    image = imaging.range_image(measured, polarization="VH", interval=(1.0, 2.5))
    unknown = image.attrs["uncertainty_unknown"].split()
    assert unknown == ["late_echo", "delay", "group_index", "geometry"]
    assert image.attrs["late_echo_correction"].startswith("not known: no survey")
    assert not {f"{RANGE_PREFIX}{name}" for name in unknown} & set(image.data_vars)
    # Half of what geometry needs is not enough.
    some = surveyed(target, text + '[calibration]\ndirection_uncertainty = "1 deg"\n')
    image = imaging.range_image(some, polarization="VH")
    assert image.attrs["uncertainty_unknown"] == "delay group_index geometry"


def test_a_delay_of_a_tenth_of_a_nanosecond_is_covered_when_stated(target, text):
    turn = np.exp(2j * np.pi * target["modulation_frequency"] * 1e-10)
    late = (target["in_phase"] + 1j * target["quadrature"]) * turn
    delayed = target.assign(
        in_phase=target["in_phase"].copy(data=late.real),
        quadrature=target["quadrature"].copy(data=late.imag),
    )
    sure = imaging.range_image(delayed, polarization="VH")
    honest = imaging.range_image(surveyed(delayed, text + STATED), polarization="VH")
    error = (honest["slant_range"] - honest["truth_slant_range"]).values
    usable = np.isfinite(error)
    index = target["geometry"].attrs["group_index"]
    assert_allclose(
        np.median(error[usable]), speed_of_light * 1e-10 / 2 / index, rtol=0.1
    )
    assert np.all(
        error[usable] < 1.5 * honest["slant_range_uncertainty"].values[usable]
    )
    assert np.all(error[usable] > 3.5 * sure["slant_range_uncertainty"].values[usable])
    assert_allclose(
        terms_of(honest)["delay"][usable], speed_of_light * 1e-10 / 2 / index, rtol=0.02
    )


@pytest.mark.parametrize("tail", ["", WINDOW], ids=["wet", "window"])
def test_each_term_is_what_the_error_itself_does(text, tail):
    made = Survey.from_text(text + tail)
    cube = rejection.open_water(simulate(made, rng=2))
    cube = surveyed(cube, text + tail + STATED)
    image = imaging.range_image(cube, polarization="VH")
    terms, usable = terms_of(image), image["slant_range"].notnull().values
    path = _path(image, np.where(usable, image["slant_range"], 1.5))

    def moved(**change: Any) -> Any:
        geometry = dict(cube["geometry"].attrs) | change
        other = cube.copy()
        other["geometry"].attrs.update(geometry)
        return rays.slant_range_of_path(
            path, beams_of(other), receivers_of(other), medium=medium_of(other)
        )

    index = cube["geometry"].attrs["group_index"]
    straight = moved()
    assert_allclose(straight[usable], image["slant_range"].values[usable], atol=1e-8)
    by_index = moved(group_index=index + 0.001) - straight
    assert_allclose(terms["group_index"][usable], np.abs(by_index)[usable], rtol=2e-3)
    place = np.array(cube["geometry"].attrs["receiver_position"])
    squares = sum(
        (moved(receiver_position=place + 0.003 * axis) - straight) ** 2
        for axis in np.eye(3)
    )
    turned = cube.assign_coords(azimuth=cube["azimuth"] + np.radians(0.5))
    by_turn = (
        rays.slant_range_of_path(
            path, beams_of(turned), receivers_of(cube), medium=medium_of(cube)
        )
        - straight
    )
    least = np.sqrt(squares + by_turn**2)
    assert (terms["geometry"] > 0.99 * least)[usable].all()
    assert_allclose(terms["geometry"][usable], least[usable], rtol=0.05)


def _path(image: xr.Dataset, slant_range: Any, **change: Any) -> Any:
    """Return the optical path of a scene, with another instrument than stated."""
    beam = beams_of(
        image.assign_coords(
            azimuth=image["azimuth"] + change.get("azimuth", 0.0),
            elevation=image["elevation"] + change.get("elevation", 0.0),
        )
    )
    medium = medium_of(image)
    medium = replace(medium, group_index=medium.group_index + change.get("index", 0.0))
    receiver = receivers_of(image) + change.get("place", np.zeros(3))
    return rays.optical_path(slant_range, beam, receiver, medium=medium)


def coverage(text: str, draws: int, seed: int) -> tuple[float, float]:
    """Return how many draws of all errors hold the truth in 68 and 95 % intervals."""
    made = Survey.from_text(text + STATED)
    cube = rejection.open_water(simulate(made, rng=seed))
    one = cube.sel(polarization=["VH"]).isel(row=slice(0, 2), column=slice(0, 3))
    image = imaging.range_image(one)
    truth = image["truth_slant_range"].values
    noise = image["slant_range_uncertainty_signal"].values
    rng = np.random.default_rng(seed)
    off = []
    for _ in range(draws):
        path = _path(
            image,
            truth,
            place=rng.normal(0, 3e-3, 3),
            azimuth=rng.normal(0, np.radians(0.5)),
            elevation=rng.normal(0, np.radians(0.5)),
            index=rng.normal(0, 1e-3),
        )
        path = path + speed_of_light * rng.normal(0, 1e-10)
        # Samples of the noise that the cube states, about the phase of this path.
        slope = 1 / (2 * image["geometry"].attrs["group_index"])
        path = path + rng.normal(0, 1, truth.shape) * noise / slope
        phase = 2 * np.pi * path * one["modulation_frequency"].values[:, None, None]
        signal = one.amulor.amplitude.values * np.exp(
            1j * phase[:, None] / speed_of_light
        )
        drawn = one.assign(
            in_phase=one["in_phase"].copy(data=signal.real),
            quadrature=one["quadrature"].copy(data=signal.imag),
        )
        found = imaging.range_image(drawn, interval=(0.8, 2.4))
        z = (found["slant_range"] - truth) / found["slant_range_uncertainty"]
        # Errors are one for all pixels: each draw counts once.
        off.append(abs(float(z.values[1, 1])))
    off = np.array(off)
    return float(np.mean(off < 1)), float(np.mean(off < 1.96))


def test_intervals_hold_over_draws_of_delay_place_and_index(text):
    inside, outside = coverage(text, 50, seed=5)
    assert abs(inside - 0.683) < 3 * np.sqrt(0.683 * 0.317 / 50)
    assert abs(outside - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 50)


@pytest.mark.slow
def test_intervals_hold_over_many_draws(text):
    inside, outside = coverage(text, 500, seed=6)
    assert abs(inside - 0.683) < 3 * np.sqrt(0.683 * 0.317 / 500)
    assert abs(outside - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 500)


def joint_cube(target: xr.Dataset) -> xr.Dataset:
    """Return a target signal with ranges that no channel alone would give."""
    specs = cubes.LEVELS["target_signal"].variables
    truth = target["truth_slant_range"].values
    maps = {
        "joint_slant_range": truth + 0.0123,
        "joint_slant_range_uncertainty": np.full(truth.shape, 5e-4),
        "joint_slant_range_common_uncertainty": np.full(truth.shape, 3e-4),
        "joint_slant_range_bound": np.full(truth.shape, 4e-4),
        "joint_wrong_interval_probability": np.full(truth.shape, 1e-6),
    }
    return target.assign(
        {
            name: xr.Variable(
                specs[name].dimensions,
                values,
                {"long_name": specs[name].long_name, "units": specs[name].units},
            )
            for name, values in maps.items()
        }
    )


def test_an_image_keeps_the_ranges_of_the_joint_estimation(target, text):
    cube = surveyed(joint_cube(target), text + STATED)
    image = imaging.range_image(cube)
    cubes.check(image, "range_image")
    usable = image["slant_range"].notnull().values
    assert usable.sum() > 50
    assert_allclose(
        image["slant_range"].values[usable],
        cube["joint_slant_range"].values[usable],
        rtol=1e-15,
    )
    terms = terms_of(image)
    assert_allclose(terms["water_model"][usable], 3e-4)
    assert_allclose(terms["signal"][usable], 4e-4)
    expected = 5e-4**2 + sum(
        terms[name] ** 2 for name in ("delay", "group_index", "geometry")
    )
    total = image["slant_range_uncertainty"].values
    assert_allclose(total[usable] ** 2, expected[usable])
    common = image["slant_range_common_uncertainty"].values
    assert_allclose(common[usable] ** 2, expected[usable] - 4e-4**2)
    assert_allclose(image["slant_range_bound"].values[usable], 4e-4)
    assert_allclose(image["slant_range_wrong_interval"].values[usable], 1e-6)
    assert "joint" in image.attrs["history"]
    # Both channels have the same ranges.
    other = imaging.range_image(cube, polarization="VH")
    assert_allclose(other["slant_range"], image["slant_range"])


def test_a_joint_range_outside_of_the_interval_is_ambiguous(target):
    cube = joint_cube(target)
    image = imaging.range_image(cube, interval=(0.5, 1.0))
    flag = image["quality_flag"].values
    seen = np.isfinite(cube["joint_slant_range"].values)
    assert ((flag & QualityFlag.AMBIGUOUS) != 0)[seen & (flag < 16)].all()
    assert image["slant_range"].isnull().all()
