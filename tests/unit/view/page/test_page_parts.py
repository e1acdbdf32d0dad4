"""Parts of the page: spectra, strides, notes, layers of clouds, sites and traces."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import io, rejection, samples
from amulor.errors import CubeError, FormatError
from amulor.io.shapes import Shape
from amulor.survey import Survey
from amulor.view import page
from amulor.view.page import pictures, recording, security, sites, space, traces
from amulor.view.page.space import Space


@pytest.fixture(scope="module")
def ladder() -> xr.Dataset:
    cube = samples.cube("ladder").isel(row=slice(0, 4), column=slice(0, 6))
    return cube.isel(shot=slice(0, None, 8))


@pytest.fixture(scope="module")
def target(ladder: xr.Dataset) -> xr.Dataset:
    return rejection.open_water(ladder)


def test_a_spectrum_has_amplitude_phase_and_error(ladder, target) -> None:
    names = ladder.amulor.polarizations
    cubes = {"before": ladder, "after": target}
    found = recording.spectrum(cubes, names[1], 2, 3)
    assert found is not None
    assert found["frequency"] == ladder["modulation_frequency"].values.tolist()
    for name, cube in cubes.items():
        pixel = cube.isel(polarization=1, row=2, column=3)
        signal = pixel["in_phase"].values + 1j * pixel["quadrature"].values
        assert found[name]["amplitude"] == pytest.approx(np.abs(signal).tolist())
        assert found[name]["phase"] == pytest.approx(np.angle(signal).tolist())
        error = np.sqrt(
            (pixel["in_phase_uncertainty"] ** 2 + pixel["quadrature_uncertainty"] ** 2)
            / 2
        )
        assert found[name]["uncertainty"] == pytest.approx(error.values.tolist())
    water = found["water"]
    assert "uncertainty" not in water
    pixel = target.isel(polarization=1, row=2, column=3)
    assert water["amplitude"] == pytest.approx(
        np.hypot(pixel["water_in_phase"], pixel["water_quadrature"]).values.tolist()
    )
    assert recording.spectrum(cubes, "XX", 0, 0) is None
    assert recording.spectrum({"before": None, "after": None}, names[0], 0, 0) is None
    assert recording._listed(np.array([1.0, np.nan, np.inf])) == [1.0, None, None]


def test_spectra_of_a_page_have_six_numbers_a_sample(ladder) -> None:
    name = ladder.amulor.polarizations[0]
    size = ladder.isel(polarization=0)["in_phase"].size
    found = recording.spectra({"before": ladder, "after": None}, name, most=6 * size)
    assert list(found) == ["before"]
    one = ladder.isel(polarization=0)
    error = np.hypot(one["in_phase_uncertainty"], one["quadrature_uncertainty"])
    assert found["before"].dtype == np.dtype("<f4")
    assert_allclose(
        found["before"], [one["in_phase"], one["quadrature"], error / np.sqrt(2)],
        rtol=1e-6,
    )  # fmt: skip
    assert recording.spectra({"before": ladder}, name, most=6 * size - 1) == {}


@pytest.mark.parametrize(
    ("shape", "stride"),
    # Ten million pixels, and 8192 along a side.
    [((2500, 4000), 1), ((2501, 4000), 2), ((1, 8192), 1), ((1, 8193), 2),
     ((16385, 1), 3), ((10_000, 10_000), 4)],
)  # fmt: skip
def test_large_images_are_drawn_by_strides(shape, stride) -> None:
    shown: Any = page.recording_of(scenes.plane((0, 0, 1), 1.5, rows=2, columns=2))
    shown.channel = lambda name=None: SimpleNamespace(
        shown=SimpleNamespace(shape=shape)
    )
    assert shown.stride("none") == stride


def test_a_recording_says_what_it_does_not_hold(ladder, target) -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=4, columns=6)
    alone = page.recording_of(image, name="image.nc")
    scene = alone.describe()
    assert (scene["rows"], scene["columns"], scene["stride"]) == (4, 6, 1)
    assert (scene["name"], scene["spectrum"], scene["water_in"]) == (
        "image.nc", False, False
    )  # fmt: skip
    assert any(note.startswith("A range image alone") for note in scene["notes"])
    assert alone.one_row("none", 0) is None
    assert alone.digest() == ""
    with pytest.raises(CubeError, match=r"^image\.nc has no channel 'XX', only"):
        alone.channel("XX")
    with pytest.raises(CubeError, match=r"^image\.nc has no map 'x' in channel"):
        alone.layer(alone.channels[0], "x", 1)
    both = page.recording_of(image, name="image.nc", samples=target)
    assert both.has_spectrum
    with pytest.raises(CubeError, match=r"^the samples have .*'row': 2"):
        page.recording_of(image, samples=target.isel(row=[0, 1]))
    cloud = xr.Dataset(attrs={"level": "point_cloud"})
    with pytest.raises(
        CubeError, match=r"^c is of level 'point_cloud'; the page shows"
    ):
        page.recording_of(cloud, name="c")
    shots = [name for name in ladder.variables if str(name).startswith("open_water_")]
    dry = page.recording_of(ladder.drop_vars(shots))
    assert dry.notes == [
        "No open-water shots in this file: the water is still in the ranges."
    ]
    row = page.recording_of(target).one_row(target.amulor.polarizations[1], 2)
    assert row is not None
    assert_allclose(
        row["water_in_phase"],
        target["water_in_phase"].isel(polarization=1, row=[2]),
    )
    assert "in_phase" not in row


def test_samples_of_a_target_have_the_water_again(target) -> None:
    found = recording._with_water(target)
    assert found.attrs["level"] == "samples"
    for name in ("in_phase", "quadrature"):
        assert_allclose(found[name], target[name] + target[f"water_{name}"])


def test_steps_of_a_picture_are_across_and_down() -> None:
    image = scenes.plane((0, 0, 1), 1.5, own=1e-5, rows=6, columns=8).copy(deep=True)
    ranges = image["slant_range"].values
    ranges[:] = 1.5
    ranges[3:, :] += 0.2
    ranges[:, 5:] += 0.1
    picture = pictures.MemoryPicture(image)
    found = recording._steps(picture, 1)
    assert found[0].tolist() == [0, 0, 0, 0, 1, 0, 0, 0]
    assert found[:, 0].tolist() == [0, 0, 2, 0, 0, 0]
    assert found[2, 4] == 3


@pytest.fixture
def large(tmp_path: Path) -> tuple[pictures.LargePicture, xr.Dataset]:
    """Return a picture of 40 x 30 pixels in a file, and its image."""
    image = scenes.plane((0.1, 0.05, 1), 1.5, own=1e-4, rows=40, columns=30)
    path = tmp_path / "large.nc"
    io.write_cube(image, path)
    return pictures.large_picture(path), image


@pytest.mark.parametrize("band", [7, 256])
def test_a_picture_in_a_file_is_read_by_bands(large, monkeypatch, band) -> None:
    picture, image = large
    monkeypatch.setattr(pictures, "_BAND", band)
    assert picture.shape == (40, 30)
    for stride in (1, 3, 8):
        found = picture.values("slant_range", stride)
        assert found.dtype == np.float32
        assert_allclose(
            found, image["slant_range"].values[::stride, ::stride], rtol=1e-6
        )
    assert picture.values("quality_flag", 1).dtype == np.uint16
    rows, columns = np.array([0, 6, 7, 39]), np.array([3, 29])
    beams = picture.beams()(rows, columns)
    expected = pictures.reader_of(image)(rows, columns)
    assert_allclose(beams, expected)
    part = picture.around([5, 17], [2])
    assert part["slant_range"].shape == (40, 30)
    assert picture.place(17, 2) == (17, 2)
    monkeypatch.setattr(pictures, "_MESH", 4)
    thin = picture.around([5, 17], [2])
    # Four rows and columns over the scan, and those that are measured.
    assert picture.place(17, 2) == (3, 1)
    assert thin["slant_range"].shape == (6, 5)
    assert_allclose(
        thin["slant_range"],
        image["slant_range"].values[[0, 5, 13, 17, 26, 39]][:, [0, 2, 9, 19, 29]],
    )
    with pytest.raises(
        CubeError, match=r"^large\.nc is too large for products .*40 x 30"
    ):
        picture.whole()


def test_a_damaged_file_of_a_picture_is_refused(large, tmp_path: Path) -> None:
    content = bytearray((tmp_path / "large.nc").read_bytes())
    content[len(content) // 2] ^= 1
    other = tmp_path / "other.nc"
    other.write_bytes(content)
    with pytest.raises(FormatError, match="is damaged: its bytes are not the ones"):
        pictures.large_picture(other)


def cloud_of(count: int, **fields: Any) -> Space:
    place = np.arange(3.0 * count).reshape(count, 3) / 100
    return Space("cloud", Shape(position=place, **fields))


def test_a_cloud_is_described_by_its_ends() -> None:
    shown = cloud_of(3, up="-y", statements=("title: Jar", "simulated: yes", " "))
    scene = shown.describe()
    assert (scene["title"], scene["simulated"], scene["beams"]) == ("Jar", True, True)
    assert scene["centre"] == [0.03, 0.04, 0.05]
    assert scene["size"] == pytest.approx([0.06] * 3)
    assert scene["rounding"] == pytest.approx(0.06 / 2**25)
    # Neighbors are apart by the root of three times 3 cm.
    assert scene["spacing"] == pytest.approx(0.03 * np.sqrt(3), rel=1e-5)
    assert (scene["points"], scene["total"], scene["triangles"]) == (3, 3, 0)
    assert (scene["mesh"], scene["closer"], scene["colour"]) == (False, False, False)
    assert scene["notes"][-1].startswith("The file has no uncertainties")
    plain = cloud_of(3).describe()
    assert (plain["title"], plain["simulated"], plain["beams"]) == (
        "cloud", False, False
    )  # fmt: skip


def test_a_part_of_a_cloud_says_so() -> None:
    part = cloud_of(3, total=10, statements=("axes: z up", "uncertainty: of range"),
                    scalars={"uncertainty": np.ones(3)})  # fmt: skip
    assert part.describe()["notes"] == [
        "3 of 10 points are drawn, one of every 4.", "Axes: z up.",
        "Uncertainty: of range.",
    ]  # fmt: skip
    part.within = lambda box: Shape(position=np.zeros((0, 3)))
    assert part.describe()["notes"][0].endswith(" A closer view loads more points.")
    mesh = cloud_of(3, total=10, faces=np.array([[0, 1, 2]]))
    assert not mesh.describe()["notes"][0].startswith("3 of 10")
    assert mesh.describe()["triangles"] == 1
    assert np.frombuffer(mesh.values("faces"), "<u4").tolist() == [0, 1, 2]


def test_values_of_a_cloud_keep_the_order_of_its_points() -> None:
    colour = np.arange(15, dtype=np.uint8).reshape(5, 3)
    sigma = {
        "sigma_x": np.full(5, 2),
        "sigma_y": np.full(5, 3),
        "sigma_z": np.full(5, 6),
    }
    scalars = {"number": np.arange(5.0), **sigma, "empty": np.full(5, np.nan)}
    shown = cloud_of(5, colour=colour, scalars=scalars)
    number = np.frombuffer(shown.values("number"), "<f4")
    position = np.frombuffer(shown.values("position"), "<f4").reshape(-1, 3)
    assert_allclose(position + shown.centre, (number[:, None] * 3 + [0, 1, 2]) / 100,
                    atol=1e-6)  # fmt: skip
    assert sorted(number) != list(number)
    found = np.frombuffer(shown.values("colour"), "u1").reshape(-1, 3)
    assert_allclose(found[:, 0], 3 * number)
    # The root of 4 + 9 + 36.
    assert_allclose(np.frombuffer(shown.values("uncertainty"), "<f4"), 7.0)
    kinds = {entry["name"]: (entry["unit"], entry["kind"]) for entry in shown.layers}
    assert next(iter(kinds)) == "uncertainty"
    assert kinds["sigma_x"] == ("m", "hidden")
    assert kinds["number"] == ("", "range")
    assert "empty" not in kinds
    for name in ("empty", "faces", "other"):
        with pytest.raises(CubeError, match=f"^cloud has no numbers '{name}'$"):
            shown.values(name)
    single = space._single(np.array([1e300, np.inf, 2.0]))
    assert np.isnan(single[:2]).all()
    assert single[2] == 2


def test_further_points_come_with_their_values_and_colors() -> None:
    shown = cloud_of(3, scalars={"a": np.arange(3.0)},
                     colour=np.zeros((3, 3), np.uint8))  # fmt: skip
    boxes = []

    def within(box: np.ndarray) -> Shape:
        boxes.append(box.tolist())
        return Shape(position=np.array([[0.03, 0.05, 0.05]]))

    shown.within = within
    content = shown.closer([-1, -2, -3], [1, 2, 3])
    assert_allclose(boxes[0], [[-0.97, -1.96, -2.95], [1.03, 2.04, 3.05]])
    assert np.frombuffer(content[:4], "<u4").tolist() == [1]
    assert_allclose(np.frombuffer(content[4:16], "<f4"), [0, 0.01, 0], atol=1e-7)
    assert np.isnan(np.frombuffer(content[16:20], "<f4")).all()
    assert content[20:] == b"\0\0\0"


def test_the_spacing_of_few_points_is_that_of_their_size() -> None:
    assert cloud_of(1)._spacing() == 1e-3
    same = Space("s", Shape(position=np.zeros((4, 3))))
    assert same._spacing() == 1e-3
    pair = Space("p", Shape(position=np.array([[0, 0, 0.0], [0, 0, 0], [5, 0, 0]])))
    # Two of three are at one place: a thousandth of the size.
    assert pair._spacing() == pytest.approx(5e-3)


def test_a_site_tells_its_pairs_and_change() -> None:
    first = {
        "source": "a", "target": "b", "points": 10, "median_distance_m": -2.5e-3,
        "misfit": 1.5, "moved_points": 3, "loose": ("x", "y"), "trust": 0.5,
    }  # fmt: skip
    second = {**first, "source": "c", "misfit": 2.0, "median_distance_m": 1e-3}
    registration: Any = SimpleNamespace(pairs=(first, second), remarks=("slow",))
    found = sites._residuals(registration)
    assert [one["source"] for one in found] == ["c", "a"]
    assert found[1] == {
        "source": "a", "target": "b", "points": 10, "distance": -2.5e-3, "misfit": 1.5,
        "moved": 3, "directions": 4, "trust": 0.5,
    }  # fmt: skip
    change: Any = SimpleNamespace(
        value=np.array([1.0, np.nan, 2.0]), significant=np.array([True, False, False]),
        epochs=("one", "two"), false_alarms=0.05,
    )  # fmt: skip
    assert sites._statements(registration, change) == [
        "registration: 2 pairs of scans overlap; their surfaces differ by up to 2.5 mm "
        "(median of a pair). The scatter is up to 2.00 times the stated noise (c on b)",
        "registration: slow",
        "change: from visit one to two, along the normal; 1 of 2 places changed "
        "significantly, of these at most 5% by chance",
    ]
    registration.pairs, registration.remarks = (), ()
    assert sites._statements(registration, None) == []
    assert sites._noted("a  bump\nof 2 +- 1") == "change a bump of 2 ± 1"
    assert sites._bytes("#0072B2") == [0, 0x72, 0xB2]


def test_changes_are_given_to_points_of_both_visits() -> None:
    change: Any = SimpleNamespace(
        value=np.array([1.0, np.nan, 3.0]), uncertainty=np.array([0.1, 0.2, 0.3]),
        significant=np.array([True, True, False]), radius=0.1, epochs=("one", "two"),
        position=np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]),
    )  # fmt: skip
    epoch = np.array([0, 0, 1, 0, 2, 0])
    cloud: Any = SimpleNamespace(
        position=np.array([[0.05, 0, 0], [1, 0, 0], [2.09, 0, 0], [2.2, 0, 0],
                           [0, 0, 0], [0, 0, 0]]),
        moving=np.arange(6) == 5,
        of_epoch=lambda name: epoch == ["one", "two"].index(name),
    )  # fmt: skip
    found = sites._of_points(cloud, change)
    assert_allclose(found["change"], [1, np.nan, 3, np.nan, np.nan, np.nan])
    assert_allclose(found["change_significant"], [1, *[np.nan] * 5])
    assert_allclose(found["change_uncertainty"],
                    [0.1, np.nan, 0.3, np.nan, np.nan, np.nan])  # fmt: skip


def test_traces_keep_every_second_sample_beyond_the_most(
    plate: Survey, monkeypatch
) -> None:
    monkeypatch.setattr(traces, "MOST_SAMPLES", 4)
    kept: Any = traces.Traces(plate, SimpleNamespace())
    for number in range(18):
        key: Any = SimpleNamespace(frequency=39e6, polarization="VV")
        kept.take(key, number)
        left = [record for _, record in kept._samples[39e6, "VV"]]
        step = np.diff(left)
        assert len(left) <= 4
        assert set(step) in (set(), {1}, {2}, {4}, {8})
    assert left == [0, 8, 16]
    for channel, frequency in (("XX", 0), ("VV", 1), ("VV", -1)):
        with pytest.raises(CubeError, match="the scan has no channel"):
            kept.over_time(channel, frequency)


@pytest.mark.parametrize(
    ("sizes", "kinds"),
    [([256_000], ["http.request"]), ([256_001], ["http.disconnect"]),
     ([200_000, 56_000, 1], ["http.request", "http.request", "http.disconnect"])],
)  # fmt: skip
def test_a_body_is_cut_off_at_its_limit(sizes, kinds) -> None:
    waiting = iter(sizes)

    async def receive() -> Any:
        return {"type": "http.request", "body": b"x" * next(waiting)}

    async def taken() -> list[str]:
        limited = security._limited(receive)
        return [(await limited())["type"] for _ in sizes]

    assert asyncio.run(taken()) == kinds
