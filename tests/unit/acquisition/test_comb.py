"""Several frequencies in one dwell: planned, measured, kept together, worth as much."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition.connect import LockInGate, connect, simulated_bench
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure, Settings
from amulor.acquisition.simulated.devices import (
    SimulatedMount,
    SimulatedScanner,
    SimulatedTargetStage,
)
from amulor.acquisition.simulated.zurich import SimulatedUhfli
from amulor.errors import InstrumentError, SurveyError
from amulor.simulation import simulate
from amulor.survey import Survey

light = functools.cache(scene_light)
FOUR = ["20 MHz", "31 MHz", "39 MHz", "47 MHz"]


@pytest.fixture(scope="session")
def four(small: Survey) -> Survey:
    """Return a survey of four frequencies, each with a quarter of the light."""
    return small.with_(
        {
            "instrument.modulation_frequencies": FOUR,
            "instrument.modulation_depth": 0.25,
            "instrument.lock_in.time_constant": "2 ms",
            "scan.dwell": "20 ms",
            "water.signal_fluctuation": "0 %",
        }
    )


def procedure(**more: object) -> Settings:
    """Return simulated devices with few dark readings."""
    return Settings.model_validate({"procedure": {"dark_readings": 2, **more}})


def zurich(survey: Survey, settings: Settings, *, options: str = "MF") -> Devices:
    """Return devices with a simulated UHFLI, its first output the laser's gate."""
    clock = connect(survey, settings, scene=light).clock
    bench = simulated_bench(survey, settings, scene=light, clock=clock)
    lock_in = ZurichLockIn(
        SimulatedUhfli(bench, options=options),
        mean_output_input=1,
        modulation_amplitude=0.05,
        clock=clock,
    )
    return Devices(
        laser=LockInGate(lock_in, settings.laser),
        lock_in=lock_in,
        scanner=SimulatedScanner(bench),
        launch=SimulatedMount(bench, "launch"),
        analyser=SimulatedMount(bench, "analyser"),
        target=SimulatedTargetStage(bench),
        clock=clock,
    )


def test_after_power_on_nothing_is_measured_or_put_out(four: Survey) -> None:
    clock = connect(four, procedure(), scene=light).clock
    bench = simulated_bench(four, procedure(), scene=light, clock=clock)
    device = SimulatedUhfli(bench)
    assert [device.demods[k].enable() for k in range(8)] == [0] * 8
    assert {device.demods[k].adcselect() for k in range(8)} == {0}
    assert device.sigouts[0].on() == 0
    assert device.auxouts[0].offset() == 0.0


@pytest.mark.parametrize("many", [2, 3, 4, 9])
def test_the_plan_holds_the_same_samples_whatever_is_measured_at_once(
    four, many
) -> None:
    one_by_one, at_once = (
        [*plan.steps(four, Procedure(frequencies_at_once=number))]
        for number in (None, many)
    )
    keys = [key for step in at_once for key in step.keys]
    assert sorted(keys) == sorted(step.key for step in one_by_one)
    assert len(keys) == plan.count(four, Procedure())
    assert max(len(step.keys) for step in at_once) == min(many, 4)
    for step in at_once:
        assert step.frequencies == tuple(key.frequency for key in step.keys)


def test_what_is_left_of_a_dwell_is_taken_under_the_same_light(four) -> None:
    step = next(plan.steps(four, Procedure(frequencies_at_once=4)))
    left = step.without({step.keys[0], step.keys[2]})
    assert left is not None
    assert left.keys == (step.keys[1], step.keys[3])
    assert left.frequencies == step.frequencies
    assert step.without({*step.keys}) is None


@pytest.mark.parametrize("known", [None, "known"])
def test_a_comb_saves_its_time_and_says_the_same(four, folder, cube_of, known) -> None:
    cubes, took = {}, {}
    for name, many in (("one by one", None), ("at once", 4)):
        settings = procedure(frequencies_at_once=many, output_filter=known)
        devices = connect(four, settings, scene=light)
        place = folder / name
        outcome = acquisition.acquire(
            four, place, settings=settings, devices=devices, scene=light
        )
        assert outcome.finished
        assert outcome.done == plan.count(four, settings.procedure)
        cubes[name] = cube_of(place)
        with Journal.read(place) as journal:
            times = [
                record.elapsed
                for key, record in journal.samples(SCAN)
                if key.polarization == "VV"
            ]
        # The first one waits for the target.
        took[name] = max(times) - sorted({*times})[1]
    # Four frequencies are four passes, each of which has to lock.
    ratio = took["one by one"] / took["at once"]
    print(f"{known}: {took['one by one']:.2f} s, at once {took['at once']:.2f} s")
    assert ratio > 4
    truth = simulate(four, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        cube = cubes["at once"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        # 120 pulls: five standard errors of their mean and of their deviation.
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
    for first, second in itertools.pairwise(cubes.values()):
        assert first.sizes == second.sizes
        assert [*first.modulation_frequency.values] == [20e6, 31e6, 39e6, 47e6]


def test_the_samples_of_a_dwell_are_kept_together_or_not_at_all(four, folder) -> None:
    meta = {"survey_digest": "1", "instrument_digest": "2", "identities": "{}"}
    settings = procedure(frequencies_at_once=4)
    acquisition.acquire(four, folder / "a", settings=settings, scene=light)
    with Journal.read(folder / "a") as journal:
        taken = [*journal.samples(SCAN)][:4]
    assert len({record.elapsed for _, record in taken}) == 1
    (folder / "b").mkdir()
    with Journal.create(folder / "b", meta=meta) as journal:
        with pytest.raises(Exception, match="nothing was changed"):
            journal.commit_together([*taken[:3], taken[0]])
        assert journal.count() == 0
        journal.commit_together(taken)
        assert journal.keys() == {key for key, _ in taken}


@pytest.mark.parametrize("known", [None, "known"])
def test_a_uhfli_takes_the_comb_by_what_it_streams(four, folder, cube_of, known):
    settings = Settings.model_validate(
        {
            "laser": {"output": 1},
            "procedure": {
                "dark_readings": 2, "frequencies_at_once": 4, "readings": "buffer",
                "output_filter": known,
            },
        }
    )  # fmt: skip
    devices = zurich(four, settings)
    outcome = acquisition.acquire(four, folder, settings=settings, devices=devices)
    assert outcome.finished
    device = devices.lock_in._device
    assert not device.bench.laser_on
    assert device.sigouts[0].on() == 0
    cube = cube_of(folder)
    truth = simulate(four, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
    with Journal.read(folder) as journal:
        readings = [record.readings for _, record in journal.samples(SCAN)]
        intervals = {record.interval for _, record in journal.samples(SCAN)}
    # About ten a time constant, over ten of them or the five after settling.
    assert min(readings) > (60 if known else 30)
    # 14.0625 MHz divided by a power of two: 6866 a second.
    assert [*intervals] == [pytest.approx(2**11 / 14.0625e6, rel=1e-6)] * len(intervals)


def test_a_uhfli_without_the_option_has_one_frequency(four, folder) -> None:
    settings = procedure(frequencies_at_once=2)
    devices = zurich(four, settings, options="PID")
    with pytest.raises(InstrumentError, match="have the option MF installed"):
        acquisition.acquire(four, folder, settings=settings, devices=devices)
    assert not devices.lock_in._device.bench.laser_on


def test_samples_that_were_lost_on_the_network_are_told(four) -> None:
    settings = procedure(readings="buffer")
    lock_in = zurich(four, settings).lock_in
    lock_in.prepare(time_constant=2e-3)
    lock_in.set_frequency(39e6, timeout=1.0)
    whole = lock_in.record(0.02)
    assert whole.signals.shape == (len(whole.times), 1)
    poll = SimulatedUhfli.poll

    def with_a_gap(device, *args, **named):
        found = poll(device, *args, **named)
        for content in found.values():
            kept = np.arange(len(content["timestamp"])) % 7 != 3
            content.update({name: values[kept] for name, values in content.items()})
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedUhfli, "poll", with_a_gap)
        with pytest.raises(InstrumentError, match="has lost samples on the way"):
            lock_in.record(0.02)


def test_a_node_that_there_is_not_is_an_error_that_says_so(four) -> None:
    lock_in = zurich(four, procedure()).lock_in
    with pytest.raises(InstrumentError, match=r"failed to set output.*not found"):
        lock_in.set_output(9, 1.0)


def test_a_comb_is_refused_where_it_cannot_be(four, small, folder) -> None:
    deep = four.with_({"instrument.modulation_depth": 0.3})
    with pytest.raises(SurveyError, match=r"would modulate 1\.2 of the light.*0\.25"):
        acquisition.acquire(
            deep, folder / "deep", settings=procedure(frequencies_at_once=4),
            scene=light,
        )  # fmt: skip
    assert not (folder / "deep").exists()
    real = {"driver": "pi_gcs", "address": "tcp://a:2"}
    with pytest.raises(ValueError, match="has one oscillator"):
        Settings.model_validate(
            {
                "lock_in": {"driver": "sr844", "address": "tcp://a:1"},
                "laser": {"driver": "lock_in_output"},
                "procedure": {"frequencies_at_once": 2},
                **dict.fromkeys(("scanner", "launch", "analyser", "target"), real),
            }
        )
    settings = procedure(frequencies_at_once=2)
    devices = connect(four, settings, scene=light)
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(type(devices.lock_in), "read_all")
        patch.delattr(type(devices.lock_in), "set_frequencies")
        with pytest.raises(InstrumentError, match="has no set_frequencies, read_all"):
            acquisition.acquire(
                four, folder / "one", settings=settings, devices=devices
            )


def test_overload_of_a_comb_is_of_all_its_samples(four, folder) -> None:
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 1, "frequencies_at_once": 4},
            "simulation": {"faults": ["overload@150x9"]},
        }
    )
    acquisition.acquire(four, folder, settings=settings, scene=light)
    with Journal.read(folder) as journal:
        taken = [*journal.samples(SCAN), *journal.samples("open_water")]
    by_dwell: dict[float, list[int]] = {}
    for _, record in taken:
        by_dwell.setdefault(record.elapsed, []).append(record.flags)
    assert all(len(flags) == 4 and len({*flags}) == 1 for flags in by_dwell.values())
    bad = [flags for flags in by_dwell.values() if flags[0]]
    assert bad
    assert all(f[0] & (SampleFlag.OVERLOAD | SampleFlag.RESCALED) for f in bad)
