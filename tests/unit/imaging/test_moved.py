"""Readings from a vehicle in turn: their range rate, and readings that disagree."""

import moving_pass
import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor import imaging, rejection, simulation
from amulor.cube import DOUBTFUL, QualityFlag

MODEL = simulation.ClosureModel()
FREQUENCIES = np.array([20e6, 45e6, 100e6])
SPEED, LIMITS = 0.1, (0.5, 3.0)


def _target(plate, **changes):
    """A vehicle drives towards a plate; three frequencies in turn, 50 ms each."""
    survey = plate.with_(
        {
            "instrument.modulation_frequencies": FREQUENCIES.tolist(),
            "instrument.polarizations": ["VV"],
            "instrument.phase_uncertainty": 0.0,
            "instrument.lock_in.time_constant": 5e-3,
            "water.signal_fluctuation": 0.0,
            "scan.columns": 5,
            "scan.rows": 4,
            "scan.dwell": 0.05,
            "platform": {
                "course": {"kind": "line", "start": [0.0, 0.0, 0.0], "speed": SPEED},
                **changes,
            },
        }
    )
    cube = simulation.simulate(survey, rng=2, model=MODEL)
    return rejection.open_water(cube)


def _flagged(image, flag):
    return (image["quality_flag"].values & int(flag)) != 0


@pytest.fixture(scope="module")
def target(plate):
    return _target(plate)


def test_a_range_rate_is_no_contradiction(target):
    """The range changes by 5 mm from reading to reading, some standard errors each."""
    image = imaging.range_image(target, interval=LIMITS)
    assert not _flagged(image, QualityFlag.MOVED).any()
    assert not _flagged(image, QualityFlag.AMBIGUOUS).any()
    assert "frequency_probability" not in image.attrs
    error = image["slant_range"] - image["truth_slant_range"]
    # Ranges are means over the readings with the weights of the frequencies, which
    # differ a little from pixel to pixel; the readings span 10 mm.
    limit = 4 * float(image["slant_range_uncertainty"].max())
    assert float(np.abs(error).max()) < limit


def test_ranges_are_those_of_the_stated_instant_within_their_errors(target):
    """Range rates up to the speed, and noise that varies from pixel to pixel.

    An independent renderer gives the phases. The stated instant is the mean time of
    the readings with the weights in the image, and the pose of a point is that of it.
    """
    rng = np.random.default_rng(8)
    beam = np.moveaxis(
        moving_pass.beam_of(target["azimuth"].values, target["elevation"].values), 0, -1
    )
    geometry = target["geometry"].attrs
    time = target["reading_time"].values[:, 0]
    pulls, good = [], []
    for _ in range(40):
        made = target.drop_vars(
            [name for name in target if name.startswith(("residual", "phase_unc"))]
        ).copy(deep=True)
        for name in made:
            if name.startswith("common_"):
                made[name].values[...] = 0.0
        rate = rng.uniform(-SPEED, SPEED, time.shape[1:])
        start = rng.uniform(1.0, 2.0, time.shape[1:])
        pixel = target["time"].values
        echo = moving_pass.echo_in_turn(
            FREQUENCIES, start + rate * (time - pixel), beam,
            np.asarray(geometry["receiver_position"]), geometry["group_index"],
        )  # fmt: skip
        sigma = 3e-3 * np.exp(rng.uniform(-1.5, 1.5, echo.shape))
        noise = sigma * (
            rng.standard_normal(echo.shape) + 1j * rng.standard_normal(echo.shape)
        )
        made["in_phase"].values[:, 0] = (echo + noise).real
        made["quadrature"].values[:, 0] = (echo + noise).imag
        for output in ("in_phase", "quadrature"):
            made[f"{output}_uncertainty"].values[:, 0] = sigma
        made["in_phase_quadrature_covariance"].values[...] = 0.0
        image = imaging.range_image(made, interval=LIMITS)
        usable = ~_flagged(image, DOUBTFUL) & np.isfinite(image["slant_range"].values)
        weight = image["reading_weight"].values
        instant = np.tensordot(weight, time - pixel, 1)
        error = image["slant_range"].values - (start + rate * instant)
        pulls.append((error / image["slant_range_uncertainty"].values)[usable])
        good.append(usable.mean())
    pulls = np.concatenate(pulls)
    assert np.mean(good) >= 0.99
    assert (np.abs(pulls) < 1).mean() == pytest.approx(0.683, abs=0.05)
    assert (np.abs(pulls) < 1.96).mean() == pytest.approx(0.95, abs=0.025)


def test_ranges_at_different_times_are_no_change_of_the_water(target):
    """The subtracted water is that of the simulation, within 0.2 % of the echo."""
    true = {
        source: target[f"truth_{source}_in_phase"]
        + 1j * target[f"truth_{source}_quadrature"]
        for source in ("water", "target")
    }
    water = target["water_in_phase"] + 1j * target["water_quadrature"]
    error = np.abs(water - true["water"]) / np.abs(true["target"])
    assert float(error.max()) < 2e-3
    assert float(target.attrs["open_water_change"]) == 0.0


def test_the_same_phases_contradict_each_other_where_nothing_moves(target, plate):
    """Without a vehicle in its survey, the scan has phases that no path explains."""
    standing = plate.with_({"instrument.phase_uncertainty": 0.0})
    still = target.assign_attrs(survey=standing.to_toml())
    image = imaging.range_image(still, interval=LIMITS)
    assert _flagged(image, QualityFlag.AMBIGUOUS).all()
    assert not _flagged(image, QualityFlag.MOVED).any()


def test_readings_that_disagree_beyond_the_motion_are_flagged(target):
    """The middle reading of two pixels is moved by 0.25 m, as by a fish."""
    jumped = target.copy(deep=True)
    n = float(target["geometry"].attrs["group_index"])
    phase = 4 * np.pi * FREQUENCIES[1] * n * 0.25 / speed_of_light
    places = [(0, 1), (2, 3)]
    for row, column in places:
        at = (1, 0, row, column)
        signal = (
            jumped["in_phase"].values[at] + 1j * jumped["quadrature"].values[at]
        ) * np.exp(1j * phase)
        jumped["in_phase"].values[at] = signal.real
        jumped["quadrature"].values[at] = signal.imag
    image = imaging.range_image(jumped, interval=LIMITS)
    moved = _flagged(image, QualityFlag.MOVED)
    assert sorted(map(tuple, np.argwhere(moved))) == places
    assert np.isfinite(image["moved_probability"].values[moved]).all()
    assert image["moved_probability"].values[moved].max() <= 1e-4


def test_readings_at_once_have_no_such_test(plate):
    at_once = _target(
        plate.with_({"instrument.modulation_depth": 0.3}), readings="at-once"
    )
    image = imaging.range_image(at_once, interval=LIMITS)
    assert "moved_probability" not in image


@pytest.mark.slow
@pytest.mark.parametrize("position", [0.02, 0.06])
def test_joint_estimation_takes_the_range_rate(plate, position):
    """Waves move the vehicle by a few millimeters from reading to reading."""
    survey = plate.with_(
        {
            "instrument.modulation_frequencies": [20e6, 45e6, 80e6, 100e6],
            "instrument.polarizations": ["VV"],
            "instrument.lock_in.time_constant": 2e-3,
            "scan.columns": 12,
            "scan.rows": 12,
            "scan.dwell": 0.02,
            "platform": {
                "course": {"kind": "hover", "start": [0.0, 0.0, 0.0]},
                "disturbance": {"position": position, "period": 3.0},
            },
        }
    )
    cube = simulation.simulate(survey, rng=2, model=MODEL)
    image = imaging.range_image(rejection.joint(cube, interval=(0.3, 3.0)))
    good = ~_flagged(image, DOUBTFUL) & np.isfinite(image["slant_range"].values)
    assert good.mean() >= 0.95
    error = (image["slant_range"] - image["truth_slant_range"]).values[good]
    sigma = image["slant_range_uncertainty"].values[good]
    assert np.median(sigma) < 5e-4
    assert (np.abs(error) < 1.96 * sigma).mean() >= 0.9
