"""Range images and point clouds: right ranges, true uncertainties, reasons."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey


@pytest.fixture(scope="module")
def target(plate: Survey) -> xr.Dataset:
    return rejection.open_water(simulate(plate, rng=2))


def _dry(text: str) -> str:
    """Return a survey without water signal and without noise."""
    for old, new in (
        ('phase_function_at_180 = "0.001 1/sr"', 'phase_function_at_180 = "0 1/sr"'),
        ('signal_fluctuation = "5 %"', ""),
        ('phase_floor = "0.06 deg"', 'phase_floor = "0 deg"'),
        ('power = "20 mW"', 'power = "1e9 W"'),
        ('"10 %"', '"10 %"\nsaturation = "1e20 V"'),
    ):
        assert old in text
        text = text.replace(old, new)
    return text


WINDOW = '[instrument.window]\ndistance = "30 cm"\nthickness = "2 cm"\n'


@pytest.mark.parametrize("tail", ["", WINDOW], ids=["wet", "window"])
@pytest.mark.parametrize(
    "frequencies", ['["39 MHz"]', '["39 MHz", "47 MHz", "120 MHz"]']
)
def test_without_water_and_noise_the_range_is_exact(
    plate_text: str, tail: str, frequencies: str
) -> None:
    text = _dry(plate_text).replace('["39 MHz"]', frequencies) + tail
    cube = simulate(Survey.from_text(text), rng=1)
    image = imaging.range_image(rejection.keep_water(cube), polarization="VV")
    cubes.check(image, "range_image")
    # 1e20 photoelectrons leave nothing above rounding and 1e-9 of the iteration.
    assert_allclose(image["slant_range"], image["truth_slant_range"], rtol=0, atol=2e-8)
    cloud = imaging.point_cloud(image)
    cubes.check(cloud, "point_cloud")
    # The plate stands across the forward axis, 1.5 m away.
    assert_allclose(cloud["z"], 1.5, rtol=0, atol=3e-8)
    right = cloud["x"].values.reshape(6, 12)
    assert (np.diff(right, axis=1) > 0).all()
    down = cloud["y"].values.reshape(6, 12)
    assert (np.diff(down, axis=0) > 0).all()


def test_an_interval_leads_past_the_first_ambiguity(plate_text: str) -> None:
    # At 390 MHz the interval is 0.28 m; the plate stands in the sixth one.
    text = _dry(plate_text).replace('["39 MHz"]', '["390 MHz"]')
    target = rejection.keep_water(simulate(Survey.from_text(text), rng=1))
    # The survey's own plate lies beyond it: ranges are off by whole intervals, all of
    # them flagged, and the image says so.
    first = imaging.range_image(target, polarization="VV")
    late = first["truth_slant_range"] - first["slant_range"]
    # Five of them, but for the baseline of the instrument.
    assert_allclose(late, 5 * 299792458.0 / (2 * 1.38 * 390e6), rtol=0.01)
    assert (first["quality_flag"].values & QualityFlag.RELATIVE).all()
    assert "repeat after 0.2785 m" in first.attrs["interval_unsettled"]
    right = imaging.range_image(target, polarization="VV", interval=(1.4, 1.65))
    assert_allclose(right["slant_range"], right["truth_slant_range"], atol=1e-8)
    both = imaging.range_image(target, polarization="VV", interval=(1.2, 1.8))
    assert (both["quality_flag"].values & QualityFlag.AMBIGUOUS).all()
    assert np.isnan(both["slant_range"]).all()


def test_a_range_does_without_a_third_of_its_samples(plate_text: str) -> None:
    text = plate_text.replace('["39 MHz"]', '["39 MHz", "47 MHz", "120 MHz"]')
    target = rejection.open_water(simulate(Survey.from_text(text), rng=4))
    flags = target["quality_flag"]
    assert not flags.values[:, :, 2, 4:6].any()
    flags.values[2, :, 2, 4] |= QualityFlag.OUTLIER
    flags.values[1:, :, 2, 5] |= QualityFlag.OUTLIER
    image = imaging.range_image(target, polarization="VV", interval=(1.2, 1.8))
    assert image["quality_flag"].values[2, 4] == 0
    assert image["quality_flag"].values[2, 5] == QualityFlag.OUTLIER
    # What is left are 39 and 47 MHz, as if there were no others.
    others = imaging.range_image(
        target.isel(modulation_frequency=[0, 1]).assign(
            quality_flag=flags[:2] & ~QualityFlag.OUTLIER
        ),
        polarization="VV",
        interval=(1.2, 1.8),
    )
    for name in ("slant_range", "slant_range_uncertainty"):
        assert_allclose(image[name][2, 4], others[name][2, 4], rtol=1e-6)


def test_unusable_pixels_have_a_flag_and_no_number(plate_text: str) -> None:
    text = plate_text.replace('width = "30 cm"', 'width = "5 cm"')
    cube = simulate(Survey.from_text(text), rng=4)
    cube["in_phase"][0, 0, 2, 6] = np.nan
    cube["saturated"][0, 0, 3, 6] = 1
    image = imaging.range_image(rejection.open_water(cube), polarization="VV")
    flag = image["quality_flag"].values
    assert flag.dtype == np.int16
    beside = image["truth_target"].values < 0
    assert (flag[beside] & QualityFlag.NO_TARGET).all()
    assert flag[2, 6] == QualityFlag.MISSING
    assert flag[3, 6] & QualityFlag.SATURATED
    unusable = (flag & cubes.UNUSABLE) != 0
    assert (np.isnan(image["slant_range"].values) == unusable).all()
    assert (np.isnan(image["slant_range_uncertainty"].values) == unusable).all()
    cloud = imaging.point_cloud(image)
    assert cloud.sizes["point"] == (~unusable).sum()
    assert not unusable[cloud["row"], cloud["column"]].any()


def test_the_channel_must_be_chosen_and_be_there(target: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="--polarization"):
        imaging.range_image(target)
    with pytest.raises(CubeError, match="no channel 'RR', but VV, VH"):
        imaging.range_image(target, polarization="RR")


def test_samples_are_not_taken_for_a_target_signal(plate: Survey) -> None:
    with pytest.raises(CubeError, match="amulor reject"):
        imaging.range_image(simulate(plate, rng=1), polarization="VV")


@pytest.mark.parametrize("interval", [(2.0, 1.0), (-1.0, 1.0), (1.0, 1.0)])
def test_an_empty_interval_is_refused(
    target: xr.Dataset, interval: tuple[float, float]
) -> None:
    with pytest.raises(ValueError, match="interval must run"):
        imaging.range_image(target, polarization="VV", interval=interval)


def test_the_photon_limit_is_what_counting_alone_gives(plate_text: str) -> None:
    # Without phase floor, fluctuation and excess noise the two must agree, but for
    # the photons of the water that the limit leaves out; so leave it out as well.
    text = plate_text
    for old, new in (
        ('phase_function_at_180 = "0.001 1/sr"', 'phase_function_at_180 = "0 1/sr"'),
        ('signal_fluctuation = "5 %"', ""),
        ('"0.06 deg"', '"0 deg"'),
        ('"10 %"', '"10 %"\nexcess_noise_factor = 1.0'),
    ):
        text = text.replace(old, new)
    cube = simulate(Survey.from_text(text), rng=5)
    image = imaging.range_image(rejection.keep_water(cube), polarization="VH")
    noise = image["slant_range_uncertainty_counting"]
    ratio = noise / image["slant_range_photon_limit"]
    # The limit counts a way out and back alike; bistatic geometry differs by 1e-3.
    assert_allclose(ratio, 1, rtol=3e-3)


@pytest.mark.slow
def test_no_truth_is_read(plate: Survey) -> None:
    cube = simulate(plate, rng=8)
    lying = cube.copy()
    for name in lying.data_vars:
        if str(name).startswith("truth_"):
            lying[name] = lying[name] * 0 + 1.0
    with_truth, with_lies, without = (
        imaging.range_image(rejection.open_water(c), polarization="VV")
        for c in (
            cube,
            lying,
            cubes.attach(
                cubes.without_groups(cube), cube.amulor.open_water, "open_water"
            ),
        )
    )
    for image in (with_lies, without):
        np.testing.assert_array_equal(image["slant_range"], with_truth["slant_range"])
        np.testing.assert_array_equal(image["quality_flag"], with_truth["quality_flag"])


def test_a_parallel_scan_puts_points_side_by_side() -> None:
    x, y = np.meshgrid([-0.1, 0.0, 0.1], [-0.05, 0.05])
    shape = (1, 1, *x.shape)
    phase = 2 * np.pi * 50e6 * 2 * 1.2 / 299792458.0
    signal = np.full(shape, np.exp(1j * phase))
    cube = cubes.build(
        "target_signal",
        {
            "in_phase": signal.real,
            "quadrature": signal.imag,
            "in_phase_uncertainty": np.full(shape, 1e-3),
            "quadrature_uncertainty": np.full(shape, 1e-3),
            "water_in_phase": np.zeros(shape),
            "water_quadrature": np.zeros(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        },
        {
            "modulation_frequency": [50e6],
            "polarization": ["none"],
            "azimuth": np.zeros(x.shape),
            "elevation": np.zeros(x.shape),
            "origin_x": x,
            "origin_y": y,
            "origin_z": np.zeros(x.shape),
        },
        geometry={
            "group_index": 1.0,
            "refractive_index": 1.0,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("target_signal", title="wall", source="by hand"),
    )
    # Without a survey nothing says that the wall is in the first interval of 3 m.
    unsettled = imaging.range_image(cube)
    assert (unsettled["quality_flag"].values & QualityFlag.RELATIVE).all()
    assert unsettled.attrs["interval_unsettled"].startswith("nothing says")
    cloud = imaging.point_cloud(imaging.range_image(cube, interval=(0.0, 2.9)))
    assert_allclose(cloud["z"], 1.2, rtol=1e-12)
    assert_allclose(cloud["x"], x.ravel())
    assert_allclose(cloud["y"], y.ravel())
    # 1e-3 rad at 50 MHz in air: c / (4 pi f) times it.
    sigma = 299792458.0 / (4 * np.pi * 50e6) * 1e-3
    assert_allclose(cloud["slant_range_uncertainty"], sigma, rtol=1e-6)


@pytest.mark.parametrize("distance", ['"2.78 m"', '"0.004 m"'])
def test_the_ends_of_the_ambiguity_interval_make_no_gross_errors(
    plate_text: str, distance: str
) -> None:
    # 39 MHz repeat after 2.785 m: noise of millimetres must not wrap unseen.
    text = plate_text.replace('["0 m", "0 m", "1.5 m"]', f'["0 m", "0 m", {distance}]')
    text = text.replace('["7 cm", "0 m", "0 m"]', '["0 m", "0 m", "0 m"]')
    text = text.replace('"-2.672 deg"', '"0 deg"').replace('"10 %"', '"0.1 %"')
    text = text.replace('"0.06 deg"', '"0.5 deg"')
    # In calm water, where the plate is seen through 1.8 attenuation lengths.
    text = text.replace('"5 %"', '"0.1 %"').replace('"0.595 1/m"', '"0.4 1/m"')
    cube = simulate(Survey.from_text(text), rng=3)
    image = imaging.range_image(rejection.open_water(cube), polarization="VV")
    flags = image["quality_flag"].values
    assert ((flags & cubes.QualityFlag.NO_TARGET) == 0).mean() > 0.9
    assert ((flags & cubes.QualityFlag.AMBIGUOUS) != 0).mean() > 0.9
    usable = (flags & cubes.UNUSABLE) == 0
    error = abs(image["slant_range"] - image["truth_slant_range"]).values
    assert (error[usable] < 0.2).all()
    assert np.isfinite(image["slant_range_uncertainty"].values[usable]).all()


def test_a_usable_pixel_has_a_finite_uncertainty_close_to_the_window(
    plate_text: str,
) -> None:
    text = _dry(plate_text).replace('"1.5 m"', '"0.322 m"') + WINDOW
    cube = simulate(Survey.from_text(text), rng=3)
    image = imaging.range_image(rejection.keep_water(cube), polarization="VV")
    usable = (image["quality_flag"].values & cubes.UNUSABLE) == 0
    assert usable.any()
    noise = image["slant_range_uncertainty_counting"].values
    assert np.isfinite(noise[usable]).all()


def test_water_left_in_does_not_empty_the_picture_of_several_frequencies(
    plate_text: str,
) -> None:
    text = plate_text.replace('["39 MHz"]', '["39 MHz", "61 MHz", "97 MHz"]')
    cube = simulate(Survey.from_text(text), rng=3)
    image = imaging.range_image(rejection.keep_water(cube), polarization="VV")
    assert image["slant_range"].notnull().mean() > 0.9
