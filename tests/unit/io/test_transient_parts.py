"""Parts of transients, slabs and navigation: scenes, places, pulses, fixes, angles."""

from __future__ import annotations

from datetime import UTC, date, datetime, time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import FormatError
from amulor.io import Histograms, trajectories, transients
from amulor.io import navigation_logs as logs
from amulor.io.histograms import Coefficients
from amulor.io.slab_response import mean_delay

PATH = Path("scan.npz")


def drawn(*shape: int, **fields: Any) -> Histograms:
    given = {
        "path": PATH, "digest": "", "counts": np.ones(shape), "bin_width": 1e-9,
        "labels": (), "thickness": None, "direct_counts": None, **fields,
    }  # fmt: skip
    return Histograms(**given)


def test_a_scene_is_one_of_the_file() -> None:
    single, two = drawn(1, 1, 1, 4), drawn(2, 1, 1, 4, labels=("near", "far"))
    assert transients.scene_number(single, None) == 0
    assert [transients.scene_number(two, scene) for scene in (0, 1)] == [0, 1]
    for scene, words in (
        (None, "2 scenes (near, far); choose one with scene, 0 to 1"),
        (2, "2 scenes (near, far), but no scene 2; choose from 0 to 1"),
        (-1, "2 scenes (near, far), but no scene -1; choose from 0 to 1"),
    ):
        with pytest.raises(FormatError) as refused:
            transients.scene_number(two, scene)
        assert str(refused.value) == f"scan.npz: field 'counts' has {words}"
    known: Any = SimpleNamespace(title="Foam")
    assert transients.scene_title(two, known, 1) == "Foam, distance label far"
    assert transients.scene_title(single, None, 0) == "scan"


def test_beams_of_a_square_start_on_an_even_grid() -> None:
    found = transients.pixel_origins((2, 3), 0.4, "down")
    assert_allclose(found["origin_x"], [[-0.2, 0, 0.2]] * 2)
    assert_allclose(found["origin_y"], [[-0.2] * 3, [0.2] * 3])
    assert_allclose(found["origin_z"], np.zeros((2, 3)))
    turned = transients.pixel_origins((2, 3), 0.4, "right")
    assert_allclose(turned["origin_x"], found["origin_y"])
    assert_allclose(turned["origin_y"], found["origin_x"])
    assert transients.pixel_origins((2, 3), None, "down") == {}
    assert_allclose(transients.pixel_origins((1, 2), 0.4, "down")["origin_y"], 0)
    for side in (0.0, -1.0, np.inf):
        with pytest.raises(ValueError, match="scan_side must be finite and above 0 m"):
            transients.pixel_origins((2, 3), side, "down")


def test_an_index_is_at_least_one() -> None:
    assert transients.at_least_one(1, "n") == 1.0
    for wrong in (0.999, np.inf, np.nan):
        with pytest.raises(ValueError, match=r"^n must be finite and at least 1"):
            transients.at_least_one(wrong, "n")


def test_frequencies_between_harmonics_are_named() -> None:
    frequency = np.array([10e6, 20e6 * (1 + 0.4e-6), 20e6 * (1 + 1e-6), 25e6])
    found = transients._repetition(frequency, 10e6)
    assert found["repetition_frequency"] == 10e6
    assert_allclose(found["frequencies_between_harmonics"], frequency[2:])
    assert transients._repetition(frequency[:1], 10e6) == {
        "repetition_frequency": 10e6, "frequencies_between_harmonics": None
    }  # fmt: skip
    assert transients._repetition(frequency, None) == {}


def found_of(signal: complex) -> Coefficients:
    return Coefficients(
        signal=np.full((1, 1), signal), variance_in_phase=np.full((1, 1), 4.0),
        variance_quadrature=np.full((1, 1), 4.0), covariance=np.zeros((1, 1)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("fields", "error"),
    # Of counts 30 and 10 with weights 1 and i: their sum; of samples with a noise of
    # 0.5 V, two of them; of a code a thousandth of its light.
    [({}, 40.0), ({"noise": 0.5}, 0.5), ({"coded": True}, 0.04**2)],
)  # fmt: skip
def test_a_recorded_pulse_is_divided_out_with_its_error(fields, error) -> None:
    pulse, weight = np.array([30.0, 10.0]), np.array([[1.0, 1j]])
    histograms = drawn(1, 1, 1, 2, reference=pulse, **fields)
    found = transients._deconvolved(histograms, found_of(60 - 20j), weight)
    spectrum = 30 + 10j
    factor = spectrum.conjugate() * 40 / (1000 + error)
    assert_allclose(found.signal, [[(60 - 20j) * factor]])
    size = abs((60 - 20j) * factor)
    added = size**2 * error / 2 / 1000
    for variance in (found.variance_in_phase, found.variance_quadrature):
        assert_allclose(variance, [[4 * abs(factor) ** 2 + added]])
    assert_allclose(found.covariance, 0, atol=1e-9)


@pytest.mark.parametrize(("count", "refused"), [(24.0, True), (26.0, False)])
def test_a_pulse_is_five_times_its_noise(count: float, refused: bool) -> None:
    # The noise of n photons is their root: 5 of it are 25 photons.
    histograms = drawn(1, 1, 1, 2, reference=np.array([count, 0.0]))
    weight = np.array([[1.0, 1.0]])
    if not refused:
        assert transients._deconvolved(histograms, found_of(1.0), weight)
        return
    with pytest.raises(
        FormatError, match="the recorded pulse is not significant above"
    ):
        transients._deconvolved(histograms, found_of(1.0), weight)


def test_outputs_are_volts_with_their_uncertainties() -> None:
    coefficients = Coefficients(
        signal=np.array([[3 + 4j]]), variance_in_phase=np.array([[9.0]]),
        variance_quadrature=np.array([[16.0]]), covariance=np.array([[2.0]]),
    )  # fmt: skip
    volt = transients.VOLTS_PER_COUNT
    found = transients._outputs(coefficients, axis=1)
    assert {name: value.item() for name, value in found.items()} == pytest.approx(
        {"in_phase": 3 * volt, "quadrature": 4 * volt, "in_phase_uncertainty": 3 * volt,
         "quadrature_uncertainty": 4 * volt,
         "in_phase_quadrature_covariance": 2 * volt**2}
    )  # fmt: skip
    assert found["in_phase"].shape == (1, 1, 1)
    dark = transients._outputs(coefficients, axis=1, missing=np.array([[True]]))
    assert all(np.isnan(value).all() for value in dark.values())


def test_a_delay_is_the_difference_of_mean_arrivals() -> None:
    counts = np.array([[0.0, 3, 1, 0], [0, 0, 0, 2], [4, 0, 0, 0]])
    slabs: Any = SimpleNamespace(counts=counts, histograms=drawn(1, 1, 2, 4))
    assert_allclose(mean_delay(slabs), [1.25e-9, 3e-9])


def test_fixes_are_interpolated_between_near_ones_only() -> None:
    times = np.array([0.0, 1, 2, 3, 20, 21])
    places = np.stack([times**2, -times, 0 * times], axis=1)
    sigma = np.tile([[0.3, 0.1, 0.2]], (6, 1))
    sigma[2] = 0.6, 0.8, 0.5
    at = np.array([-0.1, 0.0, 1.5, 2.0, 10.0, 21.0, 21.1])
    position, spread = logs._resampled(times, places, sigma, at=at)
    assert np.isnan(position[[0, 4, 6]]).all()
    assert_allclose(position[[1, 2, 3, 5], 0], [0, 2.25, 4, 441])
    assert_allclose(position[[1, 2, 3, 5], 1], [0, -1.5, -2, -21])
    # A second difference of 2 m leaves a quarter of a meter; the larger of both ends.
    assert_allclose(spread[2], [np.hypot(0.6, 0.25), 0.8, 0.5])
    assert_allclose(spread[1], [np.hypot(0.3, 0.25), 0.1, 0.2])
    # Turned, and with one time twice: the first counts.
    again = [5, 4, 3, 2, 1, 0, 0]
    turned, _ = logs._resampled(
        times[again], places[again], sigma[again], at=np.array([1.5])
    )
    assert_allclose(turned[0, 0], 2.25)


def test_times_of_a_day_go_on_across_midnight() -> None:
    log = logs._NmeaLog(PATH)
    log.day = date(2026, 5, 4)
    noon = datetime(2026, 5, 4, 12, tzinfo=UTC).timestamp()
    assert log._moment(time(12)) == noon
    log.fixes.append([noon + 12 * 3600 - 1, 0, 0, 0])
    # One second after midnight, of a day whose date has not come yet.
    assert log._moment(time(0, 0, 1)) == noon + 12 * 3600 + 1
    log.attitudes.append([noon + 13 * 3600, 0])
    assert log._moment(time(1, 30)) == noon + 13.5 * 3600
    log.day = date(2026, 5, 5)
    assert log._moment(time(1, 30)) == noon + 13.5 * 3600


def test_attitudes_have_their_uncertainties_and_parts_of_seconds() -> None:
    log = logs._NmeaLog(PATH)
    words = [
        "PASHR",
        "102030.25",
        "90.0",
        "T",
        "1.0",
        "-2.0",
        "0.5",
        "0.05",
        "",
        "0.1",
        "2",
        "1",
    ]
    log._take_attitude(7, words)
    assert (log.attitudes, log.lines) == ([], [])
    log.day = date(2026, 5, 4)
    log._take_attitude(7, words)
    log._take_attitude(8, words[:8])
    moment = datetime(2026, 5, 4, 10, 20, 30, tzinfo=UTC).timestamp() + 0.25
    rows = [[moment, 90, -2, 1, 0.05, np.nan, spread] for spread in (0.1, np.nan)]
    assert_allclose(log.attitudes, rows)
    assert log.lines == [7, 8]


def test_lines_that_are_no_sentences_are_counted() -> None:
    log = logs._NmeaLog(PATH)
    good = logs.nmea_sentence("GPXXX,1").encode()
    for line in (b"", b"  \n", b"noise\n", good, good.replace(b"1*", b"2*"), b"$x*zz"):
        log.take(1, line)
    assert dict(log.broken) == {
        "line without a sentence": 1, "sentence with a wrong checksum or field": 2
    }  # fmt: skip
    with pytest.raises(FormatError, match=r"^scan\.npz: has no date \(ZDA or RMC\);"):
        log.trajectory("EPSG:32632", (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("angles", "words"),
    [((2 * np.pi, np.pi / 2, np.pi), None),
     ((6.3, 0.0, 0.0), "line 1: heading 361 deg is beyond 360 deg"),
     ((0.0, -1.6, 0.0), "line 1: pitch -91.67 deg is beyond 90 deg"),
     ((0.0, 0.0, 3.2), "line 1: roll 183.3 deg is beyond 180 deg")],
)  # fmt: skip
def test_angles_have_their_limits(angles, words) -> None:
    columns = [np.array([0.0, angle]) for angle in angles]
    place = lambda number: f"line {number}"  # noqa: E731
    if words is None:
        trajectories._refuse_wrong_angles(*columns, place)
        return
    with pytest.raises(FormatError) as refused:
        trajectories._refuse_wrong_angles(*columns, place)
    assert str(refused.value) == f"{words}; check constants.angle_unit"


def test_a_heading_is_increased_about_the_upward_axis() -> None:
    north = trajectories.quaternions_of(
        np.array([[[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], np.full((3, 3), np.nan)])
    )
    assert np.isnan(north[1]).all()
    turned = trajectories._turned_about_up(north, np.array([np.pi / 2, 0.1]))
    forward = trajectories.matrices_of(turned)[0, :, 2]
    # From north to east.
    assert_allclose(forward, [1, 0, 0], atol=1e-12)
    assert np.isnan(turned[1]).all()
    assert trajectories._turned_about_up(north, np.zeros(2)) is north
    assert np.isnan(trajectories.matrices_of(north)[1]).all()


def test_the_norm_of_a_quaternion_is_kept() -> None:
    stated = np.array([[0.0, 0, 0, 2], [0, 0, 0, 0], [np.nan, 0, 0, 1]])
    for axes in ("FRD in NED", "FLU in ENU"):
        found = trajectories.in_enu(stated, axes)
        assert np.linalg.norm(found[0]) == pytest.approx(2)
        assert np.isnan(found[1:]).all()


def test_echoes_that_overlap_leave_a_bump_in_the_smallest_scene() -> None:
    time_bin = np.arange(400.0)

    def scene(middle: float) -> np.ndarray:
        return np.asarray(100.0 + 1e5 * np.exp(-0.5 * ((time_bin - middle) / 8) ** 2))

    near, far = scene(180.0), scene(220.0)
    found = transients.overlap_of(np.stack([near, far]))
    # Halfway both echoes have the same height, and the ground of 100 is no bump.
    height = 1e5 * np.exp(-0.5 * 2.5**2)
    assert found.argmax() == 200
    assert found.max() == pytest.approx(height, rel=0.02)
    assert not found[:150].any()
    assert not found[250:].any()
    apart = transients.overlap_of(np.stack([scene(100.0), scene(300.0)]))
    assert apart.max() < 1
