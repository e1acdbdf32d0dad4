"""Nothing is waited for where the filter of a lock-in is known, and nothing is off."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.connect import connect
from amulor.acquisition.dwell import DwellReader, Settling
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.acquisition.uncertainty import filtered_input, input_variance_ratio
from amulor.simulation import simulate
from amulor.survey import Survey

KNOWN = {"procedure": {"output_filter": "known", "dark_readings": 2}}
BUFFER = {"procedure": {**KNOWN["procedure"], "readings": "buffer"}}
SETTLED = {"procedure": {"dark_readings": 2}}


def test_the_variance_is_that_of_white_noise_behind_a_filter() -> None:
    rng = np.random.default_rng(7)
    # White noise by hand: fine steps of a filter, no formula of the program in it.
    fine, constant, spacing, intervals, runs = 50, 1.0, 0.8, 5, 4000
    step = spacing / fine
    noise = rng.standard_normal((runs, 20 * fine + intervals * fine))
    output = np.zeros(runs)
    kept = []
    for k in range(noise.shape[1]):
        output += (noise[:, k] - output) * step / constant
        if k >= 20 * fine - 1 and (k - 20 * fine + 1) % fine == 0:
            kept.append(output.copy())
    settled = np.var(kept[0])
    # The filter by small steps forgets (1 - step)^fine, not quite exp(-spacing).
    times = -fine * np.log1p(-step / constant) * np.arange(len(kept))
    means = [
        filtered_input(row, times, time_constant=constant) for row in np.transpose(kept)
    ]
    found = np.var(np.real(means)) / settled
    # Two variances of 4000 draws each: 2.2 % apiece, five standard errors.
    expected = float(input_variance_ratio(len(kept) - 1, spacing=spacing))
    assert found == pytest.approx(expected, rel=5 * 0.032)


def test_what_was_before_is_forgotten_at_once() -> None:
    times = np.array([0.3, 0.8, 1.9])
    output = (2 - 1j) + (40 + 9j) * np.exp(-times / 0.7)
    assert filtered_input(output, times, time_constant=0.7) == pytest.approx(2 - 1j)
    with pytest.raises(ValueError, match="two rising moments"):
        filtered_input([1.0], [0.0], time_constant=1.0)
    with pytest.raises(ValueError, match="two rising moments"):
        filtered_input([1.0, 2.0], [1.0, 1.0], time_constant=1.0)
    with pytest.raises(ValueError, match="intervals must be at least 1"):
        input_variance_ratio(0, spacing=1.0)


def dwelling(small: Survey, dwell: str, constant: str) -> Survey:
    """Return a survey of one dwell and time constant, in steady water."""
    return small.with_(
        {
            "scan.columns": 12,
            "scan.rows": 6,
            "scan.dwell": dwell,
            "instrument.lock_in.time_constant": constant,
            "water.signal_fluctuation": "0 %",
        }
    )


def efficiency(survey: Survey, settings: Settings, folder) -> float:
    """Return effective integration over time of a scan, by the clock of the devices."""
    told: list = []
    devices = connect(survey, settings, scene=scene_light)
    outcome = acquisition.acquire(
        survey, folder, settings=settings, devices=devices, scene=scene_light,
        acknowledged=lambda key: told.append((key, devices.clock.now())),
    )  # fmt: skip
    assert outcome.finished
    times = [moment for key, moment in told if key.kind == SCAN]
    # From the end of the first sample to that of the last one of a channel.
    half = len(times) // 2
    wall = (times[half - 1] - times[0]) / (half - 1)
    with Journal.read(folder) as journal:
        (count,) = {record.readings for _, record in journal.samples(SCAN)}
    constant = survey.instrument.lock_in.time_constant
    if settings.procedure.output_filter == "known":
        ratio = float(
            input_variance_ratio(count, spacing=survey.scan.dwell / count / constant)
        )
    else:
        ratio = float(acquisition_ratio(count))
    return 2 * constant / ratio / wall


def acquisition_ratio(count: int) -> float:
    """Return the variance of a mean of correlated readings, a time constant apart."""
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return float(np.exp(-lags.astype(float)).mean())


@pytest.mark.parametrize(
    ("dwell", "constant"), [("10 ms", "2 ms"), ("100 ms", "20 ms")]
)
def test_a_dwell_is_integrated_for_at_least_85_percent_of_its_time(
    small, folder, dwell, constant
) -> None:
    # A millimetre at 1.5 m from pixel to pixel, back and forth.
    survey = dwelling(small, dwell, constant).with_(
        {
            "scan.azimuth_span": "7.3 mrad",
            "scan.elevation_span": "4.7 mrad",
            "scan.order": "serpentine",
        }
    )
    found = {}
    for name, content in (("known", KNOWN), ("settled", SETTLED), ("buffer", BUFFER)):
        place = folder / name
        found[name] = efficiency(survey, Settings.model_validate(content), place)
    print(dwell, {name: round(value, 3) for name, value in found.items()})
    assert found["known"] > 0.85
    # Ten readings a time constant know all but a thousandth of what entered.
    assert found["buffer"] > found["known"] + 0.03
    # What it was with the same filter, waiting for it to settle.
    assert found["settled"] < 0.6


def test_errors_are_what_is_stated_and_edges_stay_where_they_are(
    small, folder, cube_of
) -> None:
    # A narrow plate: half of the neighbours differ by all of the target's light.
    survey = dwelling(small, "50 ms", "10 ms").with_(
        {
            "scan.columns": 30,
            "targets": [
                {"kind": "plate", "position": ["0 m", "0 m", "1.5 m"],
                 "width": "3 cm", "height": "30 cm", "reflectance": 0.5},
            ],
        }
    )  # fmt: skip
    settings = Settings.model_validate(KNOWN)
    acquisition.acquire(survey, folder, settings=settings, scene=scene_light)
    cube = cube_of(folder)
    truth = simulate(survey, rng=1)
    pulls = []
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls.append(((cube[name] - expected) / cube[f"{name}_uncertainty"]).values)
    pulls = np.stack(pulls)
    # 2 x 2 x 30 x 8 pulls: five standard errors are 0.16 for the mean, 0.11 for the
    # deviation.
    assert abs(pulls.mean()) < 0.16
    assert 0.88 < pulls.std() < 1.11
    assert np.abs(pulls).max() < 5


def test_phases_are_settled_after_all_but_a_move(small, folder) -> None:
    survey = dwelling(small, "50 ms", "10 ms")
    settings = Settings.model_validate(KNOWN)
    devices = connect(survey, settings, scene=scene_light)
    slept: list[float] = []
    sleep = devices.clock.sleep
    devices.clock.sleep = lambda time: (slept.append(time), sleep(time))  # type: ignore
    acquisition.acquire(
        survey, folder, settings=settings, devices=devices, scene=scene_light
    )
    # Once for each change of channel, laser or target, never for a direction.
    settled = sum(abs(time - 5 * 10e-3) < 1e-9 for time in slept)
    assert 8 <= settled <= 24


def _reader(**fields) -> SimpleNamespace:
    known = {"_filter_is_known": True, "_records": False, "_constant": 0.5}
    reader = SimpleNamespace(**{**known, "_dwell": 2.0, "_judge": None, **fields})
    reader._signal = partial(DwellReader._signal, reader)
    return reader


def test_readings_stand_for_the_time_before_them() -> None:
    window = DwellReader._window
    # A known filter gives the input between the readings; an unknown one the mean over
    # two time constants before each, as one pole is one late; a digitizer records the
    # whole dwell.
    assert window(_reader(), 10.0, 1.0) == (10.0, 1.0)
    assert window(_reader(_filter_is_known=False), 10.0, 1.0) == (9.0, 2.0)
    assert window(_reader(_records=True), 10.0, 1.0) == (10.0, 2.0)


def test_what_entered_a_known_filter_is_judged_and_not_its_output() -> None:
    times = 3.0 + np.array([0.0, 0.2, 0.5, 0.9])
    output = (2 - 1j) + (40 + 9j) * np.exp(-(times - 3.0) / 0.5)
    judged = []

    def unsettled_parts(entered, mean, spacing):
        judged.append((entered, mean, spacing))
        return len(judged)

    reader = _reader(_judge=SimpleNamespace(unsettled_parts=unsettled_parts))
    signals, skipped, settled = DwellReader._signals(
        reader, [output, 2 * output], times, [0.1, 0.3]
    )
    for (entered, mean, spacing), factor in zip(judged, (1, 2), strict=True):
        assert_allclose(entered, np.full(3, factor * (2 - 1j)), rtol=1e-9)
        assert (mean, spacing) == pytest.approx((0.2, 0.3))
    # The larger number of unsettled intervals counts for all signals.
    assert (skipped, settled) == (2, True)
    assert_allclose(signals, [2 - 1j, 4 - 2j], rtol=1e-9)
    never = SimpleNamespace(unsettled_parts=lambda *_: None)
    assert DwellReader._signals(_reader(_judge=never), [output], times, [])[1:] == (
        0,
        False,
    )


def _judge(**fields) -> Settling:
    judge = object.__new__(Settling)
    # 1 V is 100 photoelectrons a second at full modulation; no dark counts.
    known = {
        "_constant": 0.5, "_volt": 0.01, "_depth": 1.0, "_dark_rate": 0.0,
        "_variances": (1e-6, 1e-8), "_excess": 1.0,
    }  # fmt: skip
    vars(judge).update({**known, **fields})
    return judge


def test_the_counting_noise_is_that_of_the_light_or_at_least_of_the_signal() -> None:
    variance = _judge(_depth=0.5, _dark_rate=30.0)._counting_variance
    # The mean output is 200 counts a second, 30 of them dark; a signal of 0.4 V at half
    # modulation has 80, and one of 1 V has 200.
    assert variance(0.4, 2.0) == pytest.approx(1e-6 + 170 * 1e-8)
    assert variance(1.0j, 2.0) == pytest.approx(1e-6 + 200 * 1e-8)
    assert variance(0.4, math.nan) == pytest.approx(1e-6 + 80 * 1e-8)
    # One photoelectron in a reading of two time constants.
    assert variance(0.0, 0.0) == pytest.approx(1e-6 + 1e-8)


def test_a_block_differs_if_chance_makes_it_in_one_of_a_thousand() -> None:
    # The square of a complex difference over its variance per quadrature exceeds x in a
    # share exp(-x / 2): 13.8 at 1 in 1000.
    block, later = np.zeros(4, complex), [np.zeros(8, complex), np.zeros(4, complex)]
    spread = 2e-6 * (1 / 4 + 1 / 12)
    for excess in (1.0, 3.0):
        judge = _judge(_excess=excess)
        limit = np.sqrt(-2 * np.log(1e-3) * spread * excess)
        assert judge._agree(block + 0.98 * limit, later, 2e-6)
        assert not judge._agree(block - 1.02j * limit, later, 2e-6)


def test_leading_parts_that_differ_are_unsettled_unless_they_are_most() -> None:
    # Blocks of one time constant, 0.5 s, are five inputs 0.1 s apart.
    level = np.full(22, 1.0 + 0j)
    for parts, expected in ((0, 0), (1, 5), (2, 10)):
        entered = level.copy()
        entered[: 5 * parts] += 0.5
        assert _judge().unsettled_parts(entered, math.nan, 0.1) == expected
    entered = level.copy()
    entered[:15] += 0.5
    assert _judge().unsettled_parts(entered, math.nan, 0.1) is None


def test_noise_is_learned_from_settled_readings_and_never_below_counting() -> None:
    judge = _judge()
    # White noise of variance v behind the filter: readings a time constant apart differ
    # by 4 v (1 - 1/e) on average, over both quadratures.
    variance = judge._counting_variance(1.0, math.nan)
    step = np.sqrt(21 * 4 * variance * (1 - np.exp(-1)))
    judge.learn([1.0, 1.0 + step, 1.0], math.nan)
    first = judge._excess
    assert 1 < first < 21
    judge.learn([1.0, 1.0], math.nan)
    assert judge._excess == first
    for _ in range(200):
        judge.learn([1.0 - step / 2, 1.0 + step / 2] * 2, math.nan)
    assert judge._excess == pytest.approx(21, rel=1e-3)
    for _ in range(200):
        judge.learn([1.0, 1.0, 1.0], math.nan)
    assert judge._excess == 1.0
