"""What is not known of the instrument is in the error: delay, index, place, noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import simulate
from amulor.optics import rays
from amulor.optics._geometry import Geometry
from amulor.rejection import joint
from amulor.rejection.joint.priors import Instrument, late_echo, range_variance
from amulor.studies.trust.case import Case
from amulor.studies.trust.scenes import knowledge, samples
from amulor.studies.trust.scenes.knowledge import believing
from amulor.studies.trust.surveys import plate, scaled, survey

EXACT = Instrument(
    delay=0.0, group_index=0.0, position=0.0, direction=0.0, late_echo=0.0
)
EXACT_WORDS = {
    "delay_uncertainty": 0.0,
    "group_index_uncertainty": 0.0,
    "receiver_position_uncertainty": 0.0,
    "receiver_direction_uncertainty": 0.0,
    "late_echo_uncertainty": 0.0,
}
INDEX, DISTANCE, BASELINE = 1.38, 2.6, 0.2


@pytest.mark.parametrize(
    ("name", "known"), [("delay", 1e-10), ("group_index", 2e-3), ("position", 5e-3)]
)
def test_each_term_is_the_shift_that_such_an_error_makes(
    name: str, known: float
) -> None:
    # Straight ahead and back to a receiver aside: p = n (r + sqrt(r^2 + b^2)).
    back = np.hypot(DISTANCE, BASELINE)
    per_path = 1 / (INDEX * (1 + DISTANCE / back))
    shifts = {
        "delay": speed_of_light * 1e-10 * per_path,
        "group_index": 2e-3 * (DISTANCE + back) * per_path,
        "position": 5e-3 * INDEX * BASELINE / back * per_path,
    }
    medium = rays.Medium(refractive_index=1.34, group_index=INDEX)
    geometry = Geometry(
        azimuth=np.zeros(1),
        elevation=np.zeros(1),
        emitter=np.zeros(3),
        receiver=np.array([BASELINE, 0.0, 0.0]),
        medium=medium,
    )
    variance = range_variance(
        Instrument(**(vars(EXACT) | {name: known})),
        np.array([INDEX * (DISTANCE + back)]),
        geometry,
    )
    assert_allclose(np.sqrt(variance), shifts[name], rtol=1e-4)


def z_of(case: Case, **words: float) -> np.ndarray:
    """Return errors over their uncertainty of the pixels that are called good."""
    found = joint(case.samples, interval=case.interval, **(EXACT_WORDS | words))
    good = (found["quality_flag"].values == 0).all(axis=(0, 1))
    assert good.mean() > 0.9
    error = found["joint_slant_range"].values - case.surfaces[0]
    return np.asarray((error / found["joint_slant_range_uncertainty"].values)[good])


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_intervals_hold_where_the_noise_is_twice_what_is_stated(count: int) -> None:
    z = np.abs(z_of(samples.understated_noise(count, 5)))
    # 384 pixels: standard errors of 2.4 and 1.1 points, three of each.
    assert np.mean(z < 1) == pytest.approx(0.683, abs=0.072)
    assert np.mean(z < 1.96) == pytest.approx(0.95, abs=0.034)


def test_noise_that_is_stated_rightly_is_left_alone() -> None:
    made = simulate(survey(2, plate(2.6, lean=20)), rng=8)
    assert joint(made, interval=(1.7, 3.5)).attrs["joint_noise_scale"] == 1.0


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_a_receiver_that_looks_elsewhere_is_found_out(count: int) -> None:
    case = knowledge.wrong_axis(count, 3, by=1.0)
    z = np.abs(z_of(case, receiver_direction_uncertainty=np.radians(1.0)))
    assert np.mean(z < 1.96) == pytest.approx(0.95, abs=0.034)


@pytest.mark.parametrize(
    ("maker", "words"),
    [
        (samples.late_instrument, {"delay_uncertainty": 1e-10}),
        (knowledge.wrong_index, {"group_index_uncertainty": 2e-3}),
        # Beside its place the receiver is seen to look past the scan.
        pytest.param(
            knowledge.wrong_baseline,
            {
                "receiver_position_uncertainty": 5e-3,
                "receiver_direction_uncertainty": np.radians(1.0),
            },
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_instrument_one_standard_uncertainty_off_is_covered(
    maker: Callable[[int, int], Case], words: dict[str, float]
) -> None:
    case = maker(2, 1)
    z = z_of(case, **words)
    # All pixels are off together, by one, and each by its own noise.
    assert np.mean(np.abs(z) < 1.96) > 0.93


@pytest.mark.study
def test_over_many_instruments_the_interval_of_a_scan_holds() -> None:
    rng = np.random.default_rng(7)
    scores = []
    for seed in range(24):
        delay, index, aside = rng.standard_normal(3) * (2e-12, 1e-4, 2e-3)
        sizes = {"columns": 8, "rows": 6, "repeats": 2}
        target = plate(2.6, lean=20)
        truth = survey(2, target, **sizes)
        cube = simulate(truth, rng=seed)
        surfaces = cube.amulor.truth["slant_range"].values
        believed = survey(
            2, target, **sizes, group_index=1.38 + index, baseline=20 + 100 * aside
        )
        cube = believing(cube, believed)
        frequency = cube["modulation_frequency"].values
        for prefix, wide in (("", (1, 1, 1)), ("open_water_", (1, 1))):
            turn = np.exp(2j * np.pi * frequency * delay).reshape(-1, *wide)
            names = [f"{prefix}{name}" for name in ("in_phase", "quadrature")]
            signal = (cube[names[0]].values + 1j * cube[names[1]].values) * turn
            cube[names[0]].values[...] = signal.real
            cube[names[1]].values[...] = signal.imag
        found = joint(
            cube,
            interval=(1.7, 3.5),
            delay_uncertainty=2e-12,
            group_index_uncertainty=1e-4,
            receiver_position_uncertainty=2e-3,
            late_echo_uncertainty=0.0,
        )
        error = float(np.mean(found["joint_slant_range"].values - surfaces))
        common = found["joint_slant_range_common_uncertainty"].values
        total = found["joint_slant_range_uncertainty"].values
        mean = np.mean(total**2 - common**2) / total.size + np.mean(common) ** 2
        scores.append(error / np.sqrt(mean))
    # Mean square of 24 normal scores, four standard errors.
    assert abs(np.mean(np.square(scores)) - 1) < 4 * np.sqrt(2 / 24)


@pytest.mark.parametrize("change", [0.05, pytest.param(-0.05, marks=pytest.mark.slow)])
def test_shots_of_stronger_or_weaker_water_are_seen_through(change: float) -> None:
    case = samples.changed_water(2, 4, change=change)
    z = np.abs(z_of(case))
    assert np.mean(z < 1) == pytest.approx(0.683, abs=0.072)
    assert np.mean(z < 1.96) == pytest.approx(0.95, abs=0.034)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [pytest.param(0.5, marks=pytest.mark.study), 1.25])
def test_shots_of_clearer_or_more_turbid_water_widen_the_intervals(
    factor: float,
) -> None:
    target = plate(2.6, lean=20)
    cube = simulate(survey(4, target), rng=6)
    other = simulate(survey(4, target, water=scaled("tank", factor)), rng=7)
    names = [n for n in cube.data_vars if str(n).startswith("open_water_")]
    surfaces = cube.amulor.truth["slant_range"].values
    cube = cube.assign({name: other[name] for name in names})
    found = joint(cube, interval=(1.7, 3.5), **EXACT_WORDS)
    good = (found["quality_flag"].values == 0).all(axis=(0, 1))
    # All were flagged: shots that contradict the scan had a say.
    assert good.mean() > 0.99
    error = found["joint_slant_range"].values - surfaces
    z = np.abs(error / found["joint_slant_range_uncertainty"].values)[good]
    # 384 pixels: standard errors of 2.4 and 1.1 points, three of each. Intervals are
    # wider than they must be: what explains the shots could be the echo's, too.
    assert np.mean(z < 1) > 0.61
    assert np.mean(z < 1.96) > 0.916
    assert np.median(found["joint_slant_range_uncertainty"]) < 2e-3


def test_an_echo_is_late_by_the_detour_of_its_angles() -> None:
    # Angles whose square grows in proportion to the depth, by quadrature.
    depth = np.linspace(0, 3.0, 100_001)
    square = 0.004 * depth
    detour = np.trapezoid(1 / np.cos(np.sqrt(square)) - 1, depth)
    assert_allclose(late_echo(np.array([3.0]), 0.004), [detour], rtol=0.01)


def test_uncertainties_below_zero_are_refused() -> None:
    made = simulate(survey(2, plate(2.6), columns=4, rows=3, repeats=1), rng=1)
    with pytest.raises(ValueError, match="delay_uncertainty must be a finite number"):
        joint(made, delay_uncertainty=-1e-10)
