"""Joint estimation of readings in turn from a vehicle, against separate equations."""

import moving_pass
import numpy as np
import pytest

from amulor import imaging, rejection, simulation
from amulor.cube import DOUBTFUL, QualityFlag

FREQUENCIES = np.array([20e6, 45e6, 80e6, 100e6])
LIMITS = (0.5, 3.0)


def _survey(plate, speed, course, readings="in-turn"):
    return plate.with_(
        {
            "instrument.modulation_frequencies": FREQUENCIES.tolist(),
            "instrument.polarizations": ["VV"],
            "instrument.lock_in.time_constant": 1e-3,
            "scan.columns": 9,
            "scan.rows": 9,
            "scan.dwell": 0.017,
            "platform": {
                "course": {"start": [0.0, 0.0, 0.0], **course},
                "readings": readings,
            },
        }
    )


@pytest.fixture(scope="module")
def at_rest(plate):
    """Readings in turn of a vehicle that does not move."""
    survey = _survey(plate, 0.0, {"kind": "hover"})
    return simulation.simulate(survey, rng=3, model=simulation.ClosureModel())


def _moved(cube, plate, speed, rng):
    """Exchange the echoes for those of ranges that change, by separate equations.

    Each range changes at a rate of up to the speed, and the amplitude with it. The
    water is that of the simulation. Returns ranges at the start of the pixels, too.
    """
    survey = _survey(plate, speed, {"kind": "line", "speed": speed})
    made = cube.copy(deep=True).assign_attrs(survey=survey.to_toml())
    geometry = made["geometry"].attrs
    since = made["reading_time"].values[:, 0] - made["time"].values
    rate = rng.uniform(-speed, speed, since.shape[1:])
    # The water of the simulation ends at the plate.
    start = made["truth_slant_range"].values + rng.uniform(-5e-3, 5e-3, rate.shape)
    distance = start + rate * since
    beam = np.moveaxis(
        moving_pass.beam_of(made["azimuth"].values, made["elevation"].values), 0, -1
    )
    echo = moving_pass.echo_in_turn(
        FREQUENCIES, distance, beam,
        np.asarray(geometry["receiver_position"]), geometry["group_index"],
    )  # fmt: skip
    truth = made["truth_target_in_phase"] + 1j * made["truth_target_quadrature"]
    amplitude = np.abs(truth.values[:, 0]).mean()
    amplitude *= (1.5 / distance) ** 2 * np.exp(-2 * 0.4 * (distance - 1.5))
    for part, values in (("in_phase", echo.real), ("quadrature", echo.imag)):
        error = made[f"{part}_uncertainty"].values[:, 0]
        noise = error * rng.standard_normal(error.shape)
        water = made[f"{part}"].values[:, 0] - made[f"truth_target_{part}"].values[:, 0]
        # The noise of the simulation stays in, beside as much that is drawn here.
        made[part].values[:, 0] = water + amplitude * values + noise
        made[f"{part}_uncertainty"].values[:, 0] = np.sqrt(2) * error
    return made, start, rate


def _ranges(cube, start, rate):
    """Return good pixels, pulls of their ranges, and the image."""
    image = imaging.range_image(rejection.joint(cube, interval=LIMITS))
    since = image["reading_time"].values - image["time"].values
    instant = np.tensordot(image["reading_weight"].values, since, 1)
    found = image["slant_range"].values
    good = (image["quality_flag"].values & int(DOUBTFUL)) == 0
    good &= np.isfinite(found)
    pull = (found - start - rate * instant) / image["slant_range_uncertainty"].values
    return good, pull, image


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_ranges_hold_their_intervals_while_they_change(at_rest, plate, speed):
    """Ranges change by up to 1.7 and 5.1 mm from reading to reading."""
    rng = np.random.default_rng(6)
    good, pulls = [], []
    for _ in range(3):
        some, pull, image = _ranges(*_moved(at_rest, plate, speed, rng))
        good.append(some.mean())
        pulls.append(pull[some])
        assert np.median(image["slant_range_uncertainty"].values[some]) < 3.5e-4
    pulls = np.abs(np.concatenate(pulls))
    assert np.mean(good) >= 0.97
    assert (pulls < 1).mean() == pytest.approx(0.683, abs=0.08)
    assert (pulls < 1.96).mean() >= 0.91


@pytest.mark.slow
def test_a_reading_that_jumps_is_flagged(at_rest, plate):
    """The third reading of two pixels belongs to a range that is 10 cm shorter."""
    cube, start, rate = _moved(at_rest, plate, 0.1, np.random.default_rng(6))
    n = float(cube["geometry"].attrs["group_index"])
    turn = np.exp(-4j * np.pi * FREQUENCIES[2] * n * 0.1 / 299792458.0)
    places = [(1, 4), (6, 2)]
    for row, column in places:
        at = (2, 0, row, column)
        water = cube["truth_water_in_phase"] + 1j * cube["truth_water_quadrature"]
        water = water.values[at]
        signal = cube["in_phase"].values[at] + 1j * cube["quadrature"].values[at]
        signal = (signal - water) * turn + water
        cube["in_phase"].values[at] = signal.real
        cube["quadrature"].values[at] = signal.imag
    good, _, image = _ranges(cube, start, rate)
    moved = (image["quality_flag"].values & int(QualityFlag.MOVED)) != 0
    for place in places:
        assert moved[place]
        assert not good[place]
        assert image["moved_probability"].values[place] <= 1e-4
    assert moved.mean() < 0.06
