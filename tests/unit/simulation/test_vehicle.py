"""Simulated scans from a vehicle: each reading from where the instrument was then."""

import moving_pass
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from amulor import imaging, rejection, simulation
from amulor.errors import SurveyError
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.vehicle import VehicleMotion

MODEL = simulation.ClosureModel()
POSE = {"position": (10.0, 5.0, -8.0), "angles": (0.5, -1.5, 0.1)}
PLATE = {"position": np.array([0.2, -0.1, 2.0]), "angles": (0.2, -0.15, 0.3)}
ARM, MOUNTED = (0.1, 0.2, 0.3), (0.03, -1.45, 0.02)
#: Start of the courses above the plate, which the pose looks down upon.
START = (10.1, 4.9, -8.0)
COURSES = {
    "line": {"kind": "line", "start": START, "heading": 0.6, "speed": 0.3},
    "lawn-mower": {
        "kind": "lawn-mower", "start": START, "heading": 0.6, "speed": 0.3,
        "line_length": 0.2, "line_spacing": 0.1,
    },
    "orbit": {
        "kind": "orbit", "start": START, "radius": 0.3, "bearing": 2.0, "speed": 0.2,
    },
    "hover": {"kind": "hover", "start": START, "heading": 0.6},
}  # fmt: skip
CURRENT = (0.02, -0.01, 0.03)


def _course(name):
    """The course as a survey states it."""
    course = dict(COURSES[name])
    if name == "orbit":
        course["center"] = course.pop("start")
    return course


def _survey(plate, course, **platform):
    """A survey of two frequencies and two channels, 5 x 4 pixels, from a vehicle."""
    return plate.with_(
        {
            "targets": [
                {
                    "kind": "plate", "position": PLATE["position"].tolist(),
                    "rotation": list(PLATE["angles"]), "reflectance": 0.3,
                    "width": 30.0, "height": 30.0,
                }
            ],
            "instrument.modulation_frequencies": [39e6, 78e6],
            "instrument.lock_in.time_constant": 2e-3,
            "scan.columns": 5,
            "scan.rows": 4,
            "scan.azimuth_span": 0.1,
            "scan.elevation_span": 0.02,
            "scan.dwell": 0.02,
            "pose": {
                "position": list(POSE["position"]), "heading": POSE["angles"][0],
                "pitch": POSE["angles"][1], "roll": POSE["angles"][2],
            },
            "platform": {
                "course": course,
                "disturbance": {"current": list(CURRENT)},
                "mounting": {
                    "lever_arm": list(ARM), "heading": MOUNTED[0],
                    "pitch": MOUNTED[1], "roll": MOUNTED[2],
                },
                **platform,
            },
        }
    )  # fmt: skip


def _rendered(name, cube, survey):
    """Range and point of every reading, by the oracle."""
    scene = moving_pass.attitude(*POSE["angles"])
    plate = scene @ moving_pass.plane_of(PLATE["position"], PLATE["angles"])
    center = np.array(POSE["position"]) + scene @ PLATE["position"]
    emitter = np.array(survey.instrument.emitter.position)
    shape = cube["in_phase"].shape
    ranges, points = np.zeros(shape), np.zeros((*shape, 3))
    for place in np.ndindex(shape):
        frequency, channel, row, column = place
        # Channel by channel, frequencies in turn; output after five time constants.
        reading = channel * shape[0] + frequency
        first = (row * shape[3] + column) * shape[0] * shape[1]
        # The first output after 5 time constants is a mean over about one before it.
        begin, end = 4 * 2e-3, 0.02
        time = (first + reading) * 0.02 + (begin + end) / 2
        origin, turn = moving_pass.instrument_at(
            COURSES[name], {"lever_arm": ARM, "angles": MOUNTED}, np.array(CURRENT),
            time,
        )  # fmt: skip
        origin = origin + turn @ emitter
        beam = turn @ moving_pass.beam_of(
            float(cube["azimuth"][row, column]), float(cube["elevation"][row, column])
        )
        ranges[place] = moving_pass.distance_to_plane(origin, beam, center, plate[:, 2])
        points[place] = origin + ranges[place] * beam
    return ranges, points


@pytest.mark.parametrize("name", COURSES)
def test_each_reading_is_rendered_from_where_the_instrument_was_then(plate, name):
    survey = _survey(plate, _course(name))
    cube = simulation.simulate(survey, rng=1, model=MODEL)
    ranges, points = _rendered(name, cube, survey)
    np.testing.assert_allclose(
        cube["truth_reading_slant_range"].values, ranges, rtol=0, atol=1e-9
    )
    truth = [cube[f"truth_{axis}"].values for axis in ("east", "north", "up")]
    mean = np.moveaxis(points.mean(axis=(0, 1)), -1, 0)
    np.testing.assert_allclose(truth, mean, rtol=0, atol=1e-9)
    # The readings differ by far more than the tolerance.
    assert np.ptp(ranges, axis=(0, 1)).min() > 1e-5


def test_simulated_devices_on_a_vehicle_have_the_directions_of_the_scan(plate):
    light = simulation.scene_light(_survey(plate, _course("line")), model=MODEL)
    azimuth, elevation = np.meshgrid(np.linspace(-0.05, 0.05, 5), [0.01, 0.01 / 3])
    for scanned, expected in (
        (light.with_target.azimuth.reshape(4, 5)[:2], azimuth),
        (light.with_target.elevation.reshape(4, 5)[:2], elevation),
    ):
        np.testing.assert_allclose(scanned, expected, rtol=0, atol=1e-12)


def test_the_light_of_a_reading_is_that_of_an_instrument_that_stands_there(plate):
    """The plate is moved into the axes of the instrument at one reading."""
    survey = _survey(plate, _course("orbit"))
    cube = simulation.simulate(survey, rng=1, model=MODEL)
    frequency, channel, row, column = 1, 1, 2, 3
    time = float(cube["reading_time"][frequency, channel, row, column])
    origin, turn = moving_pass.instrument_at(
        COURSES["orbit"], {"lever_arm": ARM, "angles": MOUNTED}, np.array(CURRENT), time
    )
    scene = moving_pass.attitude(*POSE["angles"])
    center = np.array(POSE["position"]) + scene @ PLATE["position"]
    rotation = turn.T @ scene @ moving_pass.plane_of(PLATE["position"], PLATE["angles"])
    standing = survey.with_(
        {
            "platform": None,
            "targets.0.position": (turn.T @ (center - origin)).tolist(),
            "targets.0.rotation": Rotation.from_matrix(rotation)
            .as_euler("xyz")
            .tolist(),
        }
    )
    still = simulation.simulate(standing, rng=1, model=MODEL)
    for part in ("in_phase", "quadrature"):
        for source in ("target", "water"):
            name = f"truth_{source}_{part}"
            values = [
                float(scan[name][frequency, channel, row, column])
                for scan in (cube, still)
            ]
            assert values[0] == pytest.approx(values[1], rel=1e-6)


def test_readings_at_once_share_a_time_and_a_quarter_of_the_duration(plate):
    survey = _survey(
        plate.with_({"instrument.modulation_depth": 0.4}), _course("line"),
        readings="at-once",
    )  # fmt: skip
    cube = simulation.simulate(survey, rng=1, model=MODEL)
    time = cube["reading_time"].values
    assert np.ptp(time, axis=(0, 1)).max() == 0
    # Two frequencies and two channels in one dwell of 20 ms.
    np.testing.assert_allclose(np.diff(time[0, 0], axis=1), 0.02)
    with pytest.raises(SurveyError, match=r"modulation_depth to 0\.5 or less"):
        _survey(plate, _course("line"), readings="at-once").with_(
            {"instrument.modulation_depth": 0.6}
        )


def test_the_measured_trajectory_without_errors_is_the_course(plate):
    survey = _survey(plate, _course("line"))
    track = simulation.measured_trajectory(survey, rng=4)
    poses = track.at([0.1, 0.77])
    for number, time in enumerate((0.1, 0.77)):
        place, heading = moving_pass.course_at(COURSES["line"], time)
        expected = place + np.array(CURRENT) * time
        np.testing.assert_allclose(poses.position[number], expected, atol=1e-9)
        np.testing.assert_allclose(
            poses.rotation[number], moving_pass.attitude(heading, 0, 0), atol=1e-9
        )


def test_a_clock_that_starts_earlier_has_later_times(plate):
    survey = _survey(plate, _course("line"))
    track = VehicleMotion.of(survey, rng=4).measured(lead=2.5)
    place, _ = moving_pass.course_at(COURSES["line"], 0.3)
    expected = place + np.array(CURRENT) * 0.3
    np.testing.assert_allclose(track.at([2.8]).position[0], expected, atol=1e-9)


def test_errors_of_the_trajectory_have_the_stated_covariance(plate):
    """The last message of 400 trajectories: squared Mahalanobis distances are chi2(6).

    All errors of navigation are drawn at once; their mean is 6 with a standard error of
    sqrt(12 / 400).
    """
    errors = {
        "position_uncertainty": 0.01, "position_walk": 0.05, "position_noise": 0.003,
        "velocity_uncertainty": 0.01, "scale_uncertainty": 0.02,
        "heading_uncertainty": 0.01, "level_uncertainty": 0.004,
        "attitude_walk": 0.01, "attitude_noise": 0.001,
    }  # fmt: skip
    survey = _survey(plate, _course("line"), navigation=errors)
    exact = simulation.measured_trajectory(_survey(plate, _course("line")), rng=0)
    distances = []
    for seed in range(400):
        track = simulation.measured_trajectory(survey, rng=seed)
        turn = (
            Rotation.from_quat(track.attitude[-1])
            * Rotation.from_quat(exact.attitude[-1]).inv()
        )
        error = np.concatenate(
            [track.position[-1] - exact.position[-1], turn.as_rotvec()]
        )
        distances.append(error @ np.linalg.solve(track.covariance[-1], error))
    assert np.mean(distances) == pytest.approx(6, abs=3 * np.sqrt(12 / 400))


def test_oscillations_have_the_stated_rms(plate):
    survey = _survey(plate, _course("hover"), disturbance={
        "position": 0.02, "heading": 0.01, "pitch": 0.02, "roll": 0.03, "period": 4.0,
    })  # fmt: skip
    time = np.linspace(0, 4000, 40_000)
    position, turn = VehicleMotion.of(survey, 3).vehicle(time)
    np.testing.assert_allclose(position.std(axis=0), 0.02, rtol=0.05)
    forward, right = turn[:, :, 2], turn[:, :, 0]
    heading = np.arctan2(forward[:, 0], forward[:, 1])
    assert np.std(heading) == pytest.approx(0.01, rel=0.05)
    assert np.std(np.arcsin(forward[:, 2])) == pytest.approx(0.02, rel=0.05)
    assert np.std(np.arcsin(right[:, 2])) == pytest.approx(0.03, rel=0.05)


def test_rows_of_a_moving_scan_equal_those_of_the_whole(plate):
    from amulor.simulation.by_rows import SimulatedRows

    survey = _survey(plate, _course("orbit"), disturbance={"roll": 0.02})
    whole = simulation.simulate(survey, rng=5, model=MODEL)
    rows = SimulatedRows(survey, rng=5, model=MODEL).tile(1, 3)
    for name in ("in_phase", "reading_time", "truth_reading_slant_range", "truth_up"):
        part = whole[name].isel(row=slice(1, 3)).values
        np.testing.assert_array_equal(rows[name].values, part)


def test_the_true_range_of_an_image_is_that_of_its_readings(plate):
    """Channel VH is read 40 ms after VV, from another place."""
    survey = _survey(plate, _course("line"))
    cube = simulation.simulate(survey, rng=1, model=MODEL)
    target = rejection.open_water(cube)
    image = imaging.range_image(target, polarization="VH", interval=(0.5, 4.0))
    readings = cube["truth_reading_slant_range"].values[:, 1]
    true = image["truth_slant_range"].values
    assert np.all(true >= readings.min(axis=0) - 1e-12)
    assert np.all(true <= readings.max(axis=0) + 1e-12)
    weight = image["reading_weight"].values
    np.testing.assert_allclose(true, np.tensordot(weight, readings, 1), atol=1e-12)


def test_a_generator_without_a_seed_is_refused(plate):
    survey = _survey(plate, _course("line"))
    with pytest.raises(SurveyError, match="needs a seed"):
        simulation.simulate(survey, rng=np.random.default_rng(1), model=MODEL)


def test_a_scene_hides_its_parts_from_the_receiver_of_a_moving_instrument(plate):
    """A second plate between receiver and the first, as for one that stands there."""
    survey = _survey(plate, _course("hover"))
    moving = trace(Setup(survey, VehicleMotion.of(survey, 1)))
    assert np.all(moving.cosine > 0)
    assert np.all(moving.target == 0)
