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
from amulor.cube.schema import RANGE_PREFIX, TERMS
from amulor.errors import SurveyError
from amulor.imaging.budget import age_in_words
from amulor.imaging.observation import geometry_of
from amulor.simulation import simulate
from amulor.survey import Survey, water_properties

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


AGED = CALIBRATION + 'delay_growth = "3 ps"\n'
AGED = AGED.format(delay=0.1, place=3, turn=0.5, index=0.001)
WARM = 'delay_per_degree = "20 ps"\ninstrument_temperature_uncertainty = "5 degC"\n'


def delay_of(image: xr.Dataset) -> np.ndarray:
    """Return the delay that the term of the delay stands for [s]."""
    term = image["slant_range_uncertainty_delay"].values
    slant = image["slant_range"].values
    geometry = geometry_of(image)
    more = geometry.slant_range(geometry.optical_path(slant) + 1e-4)
    return term / ((more - slant) / 1e-4) / speed_of_light


@pytest.mark.parametrize(
    ("start", "end", "warm", "delays"),
    [
        # Noon of 1 May to noon of 31 May: 30 days of 3 ps, and 20 ps times 5 degC.
        ("2026-05-31T10:00:00Z", "2026-05-31T14:00:00Z", False, (0.1, 0.09)),
        ("2026-05-31T10:00:00Z", "2026-05-31T14:00:00Z", True, (0.1, 0.09, 0.1)),
        ("2026-05-31T12:00:00.000Z", None, False, (0.1, 0.09)),
        # A calibration after the scan is as old.
        ("2026-04-21T12:00:00Z", None, False, (0.1, 0.03)),
        ("2026-05-01T12:00:00", None, False, (0.1,)),
    ],
)
def test_a_calibration_ages(target, text, start, end, warm, delays):
    cube = surveyed(target, text + AGED + (WARM if warm else ""))
    cube = cube.assign_attrs(time_coverage_start=start)
    if end is not None:
        cube = cube.assign_attrs(time_coverage_end=end)
    found = delay_of(imaging.range_image(cube, polarization="VH"))
    assert np.isfinite(found).any()
    expected = np.sqrt(np.sum(np.square(delays))) * 1e-9
    assert_allclose(found[np.isfinite(found)], expected, rtol=1e-3)


def test_a_calibration_of_unknown_age_is_no_known_delay(target, text):
    image = imaging.range_image(surveyed(target, text + AGED), polarization="VH")
    assert "slant_range_uncertainty_delay" not in image
    assert "delay" in image.attrs["uncertainty_unknown"].split()
    assert np.isnan(imaging.error_budget(image).age)


def test_the_age_is_said_in_words(target, text):
    cube = surveyed(target, text + STATED)
    cube = cube.assign_attrs(time_coverage_start="2026-05-13T12:00:00Z")
    budget = imaging.error_budget(imaging.range_image(cube, polarization="VH"))
    assert budget.age == pytest.approx(12)
    assert age_in_words(budget.age) == ", 12 days before the scan"
    assert age_in_words(-3.2) == ", 3 days after the scan"


@pytest.mark.parametrize(
    ("tail", "needed"),
    [
        ('delay_growth = "1 ps"', "date is missing"),
        ('delay_uncertainty = "1 ns"\ndelay_per_degree = "1 ps"', "belong together"),
        (WARM, "adds to delay_uncertainty"),
    ],
)
def test_half_of_what_ages_is_refused(text, tail, needed):
    with pytest.raises(SurveyError, match=needed):
        Survey.from_text(f"{text}\n[calibration]\n{tail}\n")


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
    for name, term in terms.items():
        assert (term[usable] > 0).all(), name
        assert np.isnan(term[~usable]).all()
    common = image["slant_range_common_uncertainty"].values
    shared = np.sum([terms[name] ** 2 for name in known] or [0 * total], axis=0)
    assert (common[usable] ** 2 >= shared[usable] * (1 - 1e-12)).all()
    assert (common[usable] <= total[usable]).all()


METHODS = {
    "open water": rejection.open_water,
    "open water, column left": lambda cube: rejection.open_water(cube, put_back=False),
    "combined": lambda cube: rejection.combined(cube, water_change=0.02),
    "unmixed": lambda cube: rejection.polarization(
        cube, target_ratio=1.0, water_ratio=0.1, water_ratio_uncertainty=0.02
    ),
    "nothing": lambda cube: rejection.keep_water(cube),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if "open" in name else [])
        for name in METHODS
    ],
)
def test_every_method_divides_its_errors_and_leaves_nothing_over(name, text):
    target = METHODS[name](simulate(Survey.from_text(text), rng=4))
    cubes.check(target, "target_signal")
    image = imaging.range_image(
        target, polarization=str(target["polarization"][-1].item())
    )
    terms, total = terms_of(image), image["slant_range_uncertainty"].values
    if name == "nothing":  # the error is not known, its noise is
        assert np.isnan(total).all()
        total = terms["counting"]
    usable = np.isfinite(total)
    assert usable.sum() > 50
    assert "signal" not in terms
    squares = np.sum([term**2 for term in terms.values()], axis=0)
    assert_allclose(squares[usable], total[usable] ** 2, rtol=1e-12)
    # The errors of the samples: their terms add up to what is stated, each by itself.
    signal = target.amulor.signal.values
    across = 1j * signal / np.abs(signal) ** 2
    stated = (
        (across.real * target["in_phase_uncertainty"].values) ** 2
        + (across.imag * target["quadrature_uncertainty"].values) ** 2
        + 2 * across.real * across.imag * target.amulor.covariance.values
    )
    phases = [v for v in target if str(v).startswith("phase_uncertainty_")]
    assert len(phases) == len(terms)
    found = sum(target[v].values.astype(float) ** 2 for v in phases)
    assert_allclose(found, stated, rtol=1e-5)


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


def test_one_water_described_in_two_ways_is_as_far_away(plate_text):
    before, _, rest = plate_text.replace("405 nm", "532 nm").partition("[water]")
    rest = rest[rest.index("[[targets]]") :]
    named = 'kind = "petzold"\nstation = "HAOCE 11"'
    numbers = (
        'absorption = "0.179 1/m"\nscattering = "0.219 1/m"\n'
        'phase_function = {kind = "petzold", station = "HAOCE 11"}'
    )
    sea = '\nsalinity = 35\ntemperature = "12 degC"'
    true, *told = (
        Survey.from_text(f"{before}[water]\n{water}\n{rest}")
        for water in (named + sea, named, numbers)
    )
    cube = rejection.open_water(simulate(true, rng=2))
    images = []
    for survey in told:
        seen = cube.copy(deep=True).assign_attrs(survey=survey.to_toml())
        seen["geometry"].attrs["group_index"] = water_properties(survey).group_index
        images.append(imaging.range_image(seen, polarization="VH"))
    one, other = images
    assert_allclose(one["slant_range"], other["slant_range"], rtol=0, atol=1e-9)
    for image in images:
        assert image.attrs["uncertainty_unknown"] == "delay geometry"
        miss = np.abs(image["slant_range"] - image["truth_slant_range"])
        common = image["slant_range_common_uncertainty"]
        # 35 and 12 degC are within what water may be: all of it within 1.8 errors.
        assert float((miss / image["slant_range_uncertainty"]).max()) < 2.5
        assert float((miss / common).median()) < 1.8
        # 0.2 % of 1.5 m; nothing is added where the state is stated.
        by_index = float(image["slant_range_uncertainty_group_index"].median())
        assert 2e-3 < by_index < 4e-3
    stated = imaging.range_image(cube, polarization="VH")
    assert stated.attrs["uncertainty_unknown"] == "delay group_index geometry"
    assert float(stated["slant_range_common_uncertainty"].median()) < 1e-3


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
        return geometry_of(other).slant_range(path)

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
    by_turn = geometry_of(turned).slant_range(path) - straight
    least = np.sqrt(squares + by_turn**2)
    assert (terms["geometry"] > 0.99 * least)[usable].all()
    assert_allclose(terms["geometry"][usable], least[usable], rtol=0.05)


def _path(image: xr.Dataset, slant_range: Any, **change: Any) -> Any:
    """Return the optical path of a scene, with another instrument than stated."""
    as_stated = geometry_of(image)
    medium = as_stated.medium
    medium = replace(medium, group_index=medium.group_index + change.get("index", 0.0))
    return replace(
        as_stated,
        azimuth=as_stated.azimuth + change.get("azimuth", 0.0),
        elevation=as_stated.elevation + change.get("elevation", 0.0),
        receiver=as_stated.receiver + change.get("place", np.zeros(3)),
        medium=medium,
    ).optical_path(slant_range)


def coverage(text: str, draws: int, seed: int) -> tuple[float, float]:
    """Return how many draws of all errors hold the truth in 68 and 95 % intervals."""
    made = Survey.from_text(text + STATED)
    cube = rejection.open_water(simulate(made, rng=seed))
    one = cube.sel(polarization=["VH"]).isel(row=slice(0, 2), column=slice(0, 3))
    image = imaging.range_image(one)
    truth = image["truth_slant_range"].values
    total = image["slant_range_uncertainty"].values
    known = [terms_of(image)[name] for name in ("delay", "group_index", "geometry")]
    noise = np.sqrt(total**2 - sum(term**2 for term in known))
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


@pytest.mark.slow
def test_intervals_hold_over_draws_of_delay_place_and_index(text):
    inside, outside = coverage(text, 50, seed=5)
    assert abs(inside - 0.683) < 3 * np.sqrt(0.683 * 0.317 / 50)
    assert abs(outside - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 50)


@pytest.mark.study
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


def test_a_mean_keeps_a_delay_and_a_difference_loses_it(target, text):
    cube = surveyed(target, text + STATED)
    plain = imaging.range_image(target, polarization="VH")
    image = imaging.range_image(cube, polarization="VH")
    left, right = np.zeros((2, *image["slant_range"].shape), dtype=bool)
    left[:, :4], right[:, -4:] = True, True
    mean = imaging.correlation.mean_range(image, left)
    own = imaging.correlation.mean_range(plain, left)
    terms = terms_of(image)
    names = ("delay", "group_index", "geometry")
    shared = sum(np.mean(terms[name][left]) ** 2 for name in names)
    assert_allclose(mean.uncertainty, np.sqrt(own.uncertainty**2 + shared), rtol=1e-6)
    assert mean.random == pytest.approx(own.random, rel=1e-6)
    apart = imaging.correlation.range_difference(image, left, right)
    alone = imaging.correlation.range_difference(plain, left, right)
    left_over = sum(
        (np.mean(terms[name][left]) - np.mean(terms[name][right])) ** 2
        for name in names
    )
    expected = np.sqrt(alone.uncertainty**2 + left_over)
    assert_allclose(apart.uncertainty, expected, rtol=1e-4)
    assert apart.uncertainty < 0.2 * mean.uncertainty


def test_terms_of_the_samples_are_those_of_the_rejection(target):
    """Sums the phase errors that the method states over frequencies, term by term."""
    image = imaging.range_image(target, polarization="VH")
    terms = terms_of(image)
    assert {"counting", "fluctuation", "reference", "column"} <= set(terms)
    assert "signal" not in terms
    one = target.sel(polarization="VH")
    usable = image["slant_range"].notnull().values
    frequency = one["modulation_frequency"].values[:, None, None]
    to_range = speed_of_light / (4 * np.pi * frequency * 1.38)
    each = {name: to_range * one[f"phase_uncertainty_{name}"].values for name in terms}
    # Weights of the mean over frequencies are those of the whole errors.
    whole = sum(error**2 for error in each.values())
    weight = (1 / whole) / (1 / whole).sum(axis=0)
    for name, error in each.items():
        expected = np.sqrt(np.sum((weight * error) ** 2, axis=0))
        assert_allclose(terms[name][usable], expected[usable], rtol=0.02, err_msg=name)
    assert image.attrs["open_water_shots"] == target.attrs["open_water_shots"] > 20


@pytest.mark.study
def test_counting_is_the_noise_that_samples_state(target, text):
    """The scatter over seeds is what `counting` and `fluctuation` say."""
    made = Survey.from_text(text)
    first = simulate(made, rng=0)
    images = []
    for seed in range(24):
        other = simulate(made, rng=1000 + seed)
        # The same shots each time, so that only what pixels have alone scatters.
        drawn = first.assign(in_phase=other["in_phase"], quadrature=other["quadrature"])
        images.append(
            imaging.range_image(rejection.open_water(drawn), polarization="VH")
        )
    scatter = np.std([image["slant_range"].values for image in images], axis=0, ddof=1)
    terms = terms_of(images[0])
    own = np.hypot(terms["counting"], terms["fluctuation"])
    ratio = np.sqrt(np.nanmean(scatter**2) / np.nanmean(own**2))
    # 72 pixels of 23 degrees of freedom: 1.7 %; the column that is put back scatters.
    assert 0.93 < ratio < 1.1


def test_what_shots_leave_open_is_not_known(text):
    made = Survey.from_text(text.replace("repeats = 8", "repeats = 1"))
    target = rejection.open_water(simulate(made, rng=2))
    assert np.isinf(target.attrs["open_water_drift_uncertainty"]).any()
    image = imaging.range_image(target, polarization="VH")
    assert image.attrs["uncertainty_unknown"].split()[0] == "drift"


def test_what_a_joint_estimation_counts_of_the_instrument_counts_once(target, text):
    cube = joint_cube(target)
    plain = imaging.range_image(cube)
    # The same errors, with those of the instrument in the common part.
    stated = CALIBRATION.format(delay=0.1, place=5, turn=0, index=0.002)
    terms = terms_of(imaging.range_image(surveyed(cube, text + stated)))
    instrument = sum(
        np.nan_to_num(terms[name]) ** 2 for name in ("delay", "group_index")
    )
    for name in ("uncertainty", "common_uncertainty"):
        values = cube[f"joint_slant_range_{name}"].values
        cube[f"joint_slant_range_{name}"].values[...] = np.sqrt(values**2 + instrument)
    cube = cube.assign_attrs(
        joint_delay_uncertainty_s=1e-10,
        joint_group_index_uncertainty=0.002,
        joint_receiver_position_uncertainty_m=0.0,
    )
    usable = plain["slant_range"].notnull().values
    image = imaging.range_image(cube)
    assert image.attrs["uncertainty_unknown"] == "geometry"
    found = terms_of(image)
    for name in ("delay", "group_index"):
        assert_allclose(found[name][usable], terms[name][usable], rtol=1e-5)
    assert_allclose(found["water_model"][usable], 3e-4, rtol=1e-3)
    for name in ("uncertainty", "common_uncertainty"):
        assert_allclose(
            image[f"slant_range_{name}"].values[usable],
            cube[f"joint_slant_range_{name}"].values[usable],
            rtol=1e-6,
        )
    # A survey that knows the delay better takes the place of what was assumed.
    known = text + '[calibration]\ndelay_uncertainty = "0.01 ns"\n'
    better = imaging.range_image(surveyed(cube, known))
    assert_allclose(
        terms_of(better)["delay"][usable], found["delay"][usable] / 10, rtol=1e-6
    )
    assert np.all(
        better["slant_range_uncertainty"].values[usable]
        < 0.6 * image["slant_range_uncertainty"].values[usable]
    )


@pytest.mark.parametrize(
    ("stated", "calibrated", "degrees"),
    # Six times 0.5 degrees at one frequency without calibration.
    [
        (None, {}, 3.0),
        (None, {"uncalibrated_share": 0.0}, 0.5),
        # Student's quantile for two degrees of freedom over that of a normal one.
        ("2 deg", {}, 2.0 * 4.30265 / 1.95996),
        ("2 deg", {"uncalibrated_share": 0.0}, 2.0),
    ],
)
def test_the_phases_of_an_instrument_are_uncertain(
    plate_text: str,
    target: xr.Dataset,
    stated: str | None,
    calibrated: dict[str, float],
    degrees: float,
) -> None:
    line = "" if stated is None else f'phase_uncertainty = "{stated}"\n'
    text = plate_text.replace('phase_uncertainty = "0 deg"\n', line)
    low = surveyed(target.isel(modulation_frequency=[0]), text)
    low = low.assign_attrs(calibrated)
    image = imaging.range_image(low, polarization="VV", interval=(1.0, 2.0))
    term = image["slant_range_uncertainty_instrument"].values
    # A range is c / (4 pi n f) times the phase, at 39 MHz in water of 1.38.
    expected = speed_of_light / (4 * np.pi * 1.38 * 39e6) * np.radians(degrees)
    assert_allclose(term[np.isfinite(term)], expected, rtol=5e-3)


def test_an_instrument_without_errors_of_phase_has_no_term(
    target: xr.Dataset,
) -> None:
    image = imaging.range_image(target, polarization="VV", interval=(1.0, 2.0))
    assert "slant_range_uncertainty_instrument" not in image


def test_measured_leakage_moves_weak_echoes_most(target, text):
    cube = target.assign_attrs(leakage_uncertainty_volt=np.array([2e-6, 3e-6]))
    cube = cube.isel(modulation_frequency=[1])
    image = imaging.range_image(cube, polarization="VH")
    term = image["slant_range_uncertainty_instrument"].values
    survey = Survey.from_text(text)
    index = water_properties(survey).group_index
    # The volts of the second frequency across the echo turn its phase.
    echo = np.abs(cube.amulor.signal.sel(polarization="VH").values[0])
    expected = 3e-6 / echo * speed_of_light / (4 * np.pi * 97e6 * index)
    usable = np.isfinite(term)
    assert usable.any()
    # Medians of ratios of channels, and a path longer than twice the slant range.
    assert_allclose(term[usable], expected[usable], rtol=2e-2)
    assert term[usable].max() > 1.02 * term[usable].min()


def test_calibrated_phases_add_their_error(target):
    error = np.array([0.002, 0.004])
    cube = target.assign_attrs(calibration_phase_uncertainty_rad=error)
    cube = cube.isel(modulation_frequency=[0]).assign_attrs(phase_error_gain_VH=1.0)
    before = imaging.range_image(
        target.isel(modulation_frequency=[0]), polarization="VH"
    )
    image = imaging.range_image(
        cube.assign_attrs(calibration_phase_uncertainty_rad=error[:1]),
        polarization="VH",
    )
    assert "slant_range_uncertainty_instrument" not in before
    index = float(cube["geometry"].attrs["group_index"])
    expected = 0.002 * speed_of_light / (4 * np.pi * 39e6 * index)
    term = image["slant_range_uncertainty_instrument"].values
    assert_allclose(term[np.isfinite(term)], expected, rtol=2e-3)


def test_a_calibrated_delay_is_the_term_of_the_delay(target):
    cube = target.assign_attrs(calibration_delay_uncertainty_s=20e-12)
    image = imaging.range_image(cube, polarization="VH")
    found = delay_of(image)
    assert_allclose(found[np.isfinite(found)], 20e-12, rtol=1e-3)
    assert "delay" not in image.attrs["uncertainty_unknown"].split()


def test_the_default_phase_error_is_smaller_if_the_leakage_was_measured(
    target: xr.Dataset, text: str
) -> None:
    plain = surveyed(target, text.replace('phase_uncertainty = "0 deg"\n', ""))
    plain = plain.isel(modulation_frequency=[0])
    measured = plain.assign_attrs(leakage_uncertainty_volt=0.0)
    terms = [
        terms_of(imaging.range_image(cube, polarization="VV"))["instrument"]
        for cube in (plain, measured)
    ]
    ratio = terms[1] / terms[0]
    # 0.4 of 0.5 degrees.
    assert_allclose(ratio[np.isfinite(ratio)], 0.8, rtol=1e-6)
