"""Runs that stop, go on, are interrupted, and use any number of threads."""

from __future__ import annotations

import _thread
import dataclasses
import math
import signal
import threading

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import (
    DiscReceiver,
    ErrorGoal,
    GaussianReceiver,
    Layer,
    Medium,
    MeshTarget,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    Tally,
    Technique,
    reflection_and_transmission,
    simulate,
)
from amulor.transport._kernels import batch as _batch_kernels
from amulor.transport._kernels import contributions as _contribution_kernels
from amulor.transport._kernels import interfaces as _interface_kernels
from amulor.transport._kernels import joins as _join_kernels
from amulor.transport._kernels import mesh as _mesh_kernels
from amulor.transport._kernels import polarization as _polarization_kernels
from amulor.transport._kernels import reflections as _reflection_kernels
from amulor.transport._kernels import slab as _slab_kernels
from amulor.transport._kernels import trace as _trace_kernels
from amulor.transport._kernels.types import Record as Deposits
from amulor.transport._problem import Problem
from amulor.transport._runs import CHECKS, Batch, Limits, conduct, random_state
from amulor.transport.tally import MOST_BATCHES

FREQUENCY = np.array([0.0, 30e6, 90e6])
DISC = DiscReceiver(radius=0.05, acceptance_angle=0.04, position=(0.07, 0.0, 0.0))
NUMBERS = ("batches", "histories_of", "contribution", "groups", "next_batch")


def assert_same(one, other):
    """Compare all numbers of two tallies bit by bit."""
    for name in NUMBERS:
        a, b = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes(), name


class InterruptAt:
    """Presses the key after that many batches."""

    def __init__(self, number):
        self.number = number

    def __call__(self, progress):
        self.number -= 1
        if self.number == 0:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def milk():
    """Small particles, with Stokes vectors."""
    return Medium.homogeneous(
        absorption=0.3,
        scattering=0.7,
        phase_function=ScatteringMatrix.rayleigh(),
        group_index=1.33,
    )


def test_a_run_is_the_same_with_any_number_of_threads(peaked_water):
    one, two, three = (
        simulate(
            peaked_water, Source(), DISC, FREQUENCY, histories=8000, seed=9,
            threads=threads,
        )
        for threads in (1, 2, 3)
    )  # fmt: skip
    assert_same(one, two)
    assert_same(one, three)
    assert np.all(np.abs(one.signal) > 0)
    other = simulate(peaked_water, Source(), DISC, FREQUENCY, histories=8000, seed=10)
    assert np.all(one.signal != other.signal)


def test_polarized_light_a_target_and_a_record_are_the_same_with_threads(milk):
    runs = [
        simulate(
            milk, Source(polarization="R", radius=0.01, divergence=0.01),
            GaussianReceiver(radius=0.05, acceptance_angle=0.1, position=(0.1, 0, 0)),
            FREQUENCY, histories=2048, seed=3, threads=threads, keep_record=True,
            target=PlaneTarget(position=(0, 0, 1.5), reflectance=0.5),
        )
        for threads in (1, 3)
    ]  # fmt: skip
    assert_same(*runs)
    for name in ("length", "water", "target"):
        one, other = (getattr(run.record, name) for run in runs)
        assert one.tobytes() == other.tobytes()


def test_plane_layers_are_the_same_with_any_number_of_threads():
    layer = Layer(
        absorption=0.1, scattering=0.9, thickness=1.0,
        phase_function=henyey_greenstein_function(asymmetry=0.5),
    )  # fmt: skip
    medium = Medium.layered([layer], group_index=1.3)
    runs = [
        reflection_and_transmission(
            medium, FREQUENCY, histories=4000, seed=3, threads=threads,
            outward=[(3.0, 0.0)],
        )
        for threads in (1, 3)
    ]  # fmt: skip
    assert_same(*runs)
    assert not runs[0].heavy_tailed
    # Another slab has another digest, so the two are not merged.
    tilted = reflection_and_transmission(
        medium, FREQUENCY, histories=4000, seed=4, incidence=0.5, outward=[(3.0, 0.0)]
    )
    with pytest.raises(ValueError, match="same problem"):
        runs[0].merged(tilted)


@pytest.mark.parametrize("after", [2, 31])
def test_a_run_that_was_interrupted_goes_on_to_the_same_numbers(peaked_water, after):
    def run(**others):
        return simulate(
            peaked_water, Source(), DISC, FREQUENCY, histories=6000, seed=4, **others
        )

    whole = run()
    part = run(progress=InterruptAt(after))
    assert part.interrupted
    assert not whole.interrupted
    assert part.histories == after * part.batch_size
    rest = run(resume=part, threads=1)
    assert_same(rest, whole)
    assert not rest.interrupted
    assert rest.seconds > part.seconds


def test_an_interruption_before_two_batches_is_passed_on(peaked_water):
    with pytest.raises(KeyboardInterrupt):
        simulate(
            peaked_water, Source(), DISC, FREQUENCY, histories=2000, seed=4,
            progress=InterruptAt(1),
        )  # fmt: skip


def test_a_run_that_goes_on_for_longer_is_one_run(peaked_water):
    short = simulate(peaked_water, Source(), DISC, FREQUENCY, histories=4000, seed=5)
    long = simulate(
        peaked_water, Source(), DISC, FREQUENCY, histories=24_000, seed=5, resume=short
    )
    assert long.histories == pytest.approx(24_000, abs=short.batch_size)
    assert long.next_batch * short.batch_size == long.histories
    assert long.relative_error[0] < short.relative_error[0]
    again = simulate(
        peaked_water, Source(), DISC, FREQUENCY, histories=24_000, seed=5, resume=long
    )
    assert_same(again, long)


def test_a_run_goes_on_with_its_own_problem_only(peaked_water):
    def run(seed=5, frequency=FREQUENCY, receiver=DISC, **others):
        return simulate(
            peaked_water, Source(), receiver, frequency, histories=512, seed=seed,
            **others,
        )  # fmt: skip

    start = run()
    wider = DiscReceiver(radius=0.06, acceptance_angle=0.04, position=(0.07, 0, 0))
    with pytest.raises(ValueError, match="same problem"):
        run(resume=start, receiver=wider)
    # Slower light in the same water takes the same paths, with other phases.
    slower = Medium(layers=peaked_water.layers, group_index=1.38)
    with pytest.raises(ValueError, match="same problem"):
        simulate(slower, Source(), DISC, FREQUENCY, histories=512, seed=5, resume=start)
    with pytest.raises(ValueError, match="same frequencies"):
        run(resume=start, frequency=FREQUENCY + 1)
    with pytest.raises(ValueError, match=r"seed 6, got 5.*merged"):
        run(resume=start, seed=6)
    with pytest.raises(ValueError, match="merged run cannot go on"):
        run(resume=start.merged(run(seed=6)))
    with pytest.raises(ValueError, match="record of path lengths cannot go on"):
        run(resume=run(keep_record=True))
    with pytest.raises(ValueError, match=r"from the start.* has 512 histories"):
        simulate(
            peaked_water, Source(), DISC, FREQUENCY, histories=1024, seed=5,
            resume=start, keep_record=True,
        )  # fmt: skip


def test_a_run_stops_at_the_error_asked_for(peaked_water):
    seen = []
    tally = simulate(
        peaked_water, Source(), DISC, FREQUENCY, histories=400_000, seed=6,
        relative_error=0.02, progress=seen.append,
    )  # fmt: skip
    assert tally.relative_error[0] <= 0.02
    assert seen[-1].relative_error == pytest.approx(tally.relative_error[0], rel=1e-9)
    assert math.isinf(seen[0].relative_error)
    assert tally.next_batch in CHECKS
    assert 16 * tally.batch_size <= tally.histories < 200_000
    assert [step.histories for step in seen] == [
        tally.batch_size * (k + 1) for k in range(len(seen))
    ]
    assert seen[-1].goal >= 400_000
    assert not tally.interrupted


@pytest.mark.parametrize(
    ("light", "analyser", "frequency"),
    [
        ("target", "none", 0),
        pytest.param("target", "R", 2, marks=pytest.mark.slow),
        ("water, order 1", "L", 1),
    ],
)
def test_a_run_stops_at_the_error_of_the_light_asked_for(
    milk, light, analyser, frequency
):
    goal = ErrorGoal(
        relative_error=0.05, light=light, analyser=analyser, frequency=frequency
    )
    tally = simulate(
        milk, Source(polarization="R"), DISC, FREQUENCY, histories=2_000_000, seed=6,
        relative_error=goal, target=PlaneTarget(position=(0, 0, 2), reflectance=0.1),
    )  # fmt: skip
    assert goal.of(tally) <= 0.05
    assert tally.histories < 2_000_000
    # By hand: what the analyser lets pass of each batch, and its scatter.
    names = ("target", "target, scattered") if light == "target" else (light,)
    rows = [k for k, name in enumerate(tally.parts) if name in names]
    batches = tally.batches[:, rows].sum(axis=1)[..., frequency]
    passed = batches[:, 0]
    if analyser != "none":
        sign = 1 if analyser == "R" else -1
        passed = 0.5 * (batches[:, 0] + sign * batches[:, 3])
    assert np.ptp(tally.histories_of) == 0
    error = np.sqrt(np.var(passed, ddof=1) / passed.size) / abs(passed.mean())
    assert goal.of(tally) == pytest.approx(error, rel=1e-9)


@pytest.mark.slow
def test_stopping_at_an_error_does_not_bias_what_is_stated():
    # Batches that scatter like those of photons: means of 20 skewed contributions, so
    # that a batch that is low by chance has little scatter, too. 16 to 60 batches.
    def run(seed):
        def batch_of(number):
            rng = np.random.default_rng([seed, number])
            weight = rng.lognormal(-0.5, 1.0, size=(20, 2, 1)) * [[1.0], [0.0]]
            return Batch(
                number=number, histories=10, signal=weight.mean(axis=(0, 1)).reshape(
                    1, 1, 1) * 2 + 0j, weight=weight, mass=None, edge=None, spacing=0.0,
            )  # fmt: skip

        goal = ErrorGoal(relative_error=0.05)
        return conduct(
            batch_of, frame(10), Limits(histories=10**5, error=goal, threads=1)
        )

    runs = [run(seed) for seed in range(400)]
    signal = np.array([tally.signal[0].real for tally in runs])
    error = np.array([tally.relative_error[0] for tally in runs]) * signal
    assert np.all(error <= 0.05 * signal)
    # 5.5 % of means of some 30 batches are beyond two of their own standard errors
    # (Student's t), of means of skewed ones 6 to 7 %; 400 runs tell that to 1.3 %.
    assert np.mean(np.abs(signal - 1) > 2 * error) < 0.065 + 2.5 * 0.013
    assert signal.std() < 0.05
    assert signal.mean() == pytest.approx(1.0, abs=4 * signal.std() / np.sqrt(400))


def test_a_run_stops_after_the_longest_time(peaked_water):
    tally = simulate(
        peaked_water, Source(), DISC, FREQUENCY, histories=10**9, seed=6,
        longest_time=1e-9, threads=1,
    )  # fmt: skip
    assert tally.next_batch == 1
    assert tally.histories == 65536


def test_merged_halves_have_the_error_of_the_whole(peaked_water):
    halves = [
        simulate(peaked_water, Source(), DISC, FREQUENCY, histories=16_000, seed=seed)
        for seed in (20, 21)
    ]
    both = halves[0].merged(halves[1])
    assert both.histories == sum(half.histories for half in halves)
    expected = 0.5 * np.hypot(*(half.relative_error for half in halves))
    # Errors of halves are known to 1 / sqrt(250) each, and their means differ by 2 %.
    np.testing.assert_allclose(both.relative_error[:2], expected[:2], rtol=0.1)
    assert both.effective_contributions == pytest.approx(
        sum(half.effective_contributions for half in halves), rel=0.1
    )


@pytest.mark.parametrize(
    "target", [None, PlaneTarget(position=(0, 0, 2), reflectance=0.5)]
)
def test_the_record_gives_other_frequencies(peaked_water, target):
    tally = simulate(
        peaked_water, Source(), DISC, [90e6, 0.0, 45e6], histories=8000, seed=7,
        keep_record=True, target=target,
    )  # fmt: skip
    record = tally.record
    wave = 2j * np.pi * tally.modulation_frequency * 1.33 / speed_of_light
    phasor = np.exp(np.outer(record.length, wave))
    still = abs(tally.signal[1])
    # An eighth of the square of 0.05 rad per bin at the highest frequency, and of
    # less at the others; what is beyond the record is missing.
    bound = (np.abs(wave) * np.diff(record.length)[0]) ** 2 / 8
    assert bound.max() == pytest.approx(0.05**2 / 8, rel=1e-9)
    for kind in ("water", "target"):
        found = phasor.T @ getattr(record, kind)[:, 0]
        error = np.abs(found - getattr(tally, f"{kind}_signal"))
        assert np.all(error <= (bound + record.beyond + 1e-9) * still)
    assert (np.abs(record.target).sum() > 0) == (target is not None)
    # Light of each bin arrives after the shortest way there is.
    assert np.all(np.abs(record.water[record.length < 0.1]) < 1e-3 * still)


def test_the_share_beyond_the_record_is_that_of_unmodulated_light(peaked_water):
    # At 5 GHz 16384 nodes of 0.05 rad reach to 5.9 m, so a part of the light of ways
    # of some metres is beyond; the first frequency is not zero.
    tally = simulate(
        peaked_water, Source(), DISC, [5e9, 0.0], histories=8000, seed=7,
        keep_record=True,
    )  # fmt: skip
    inside = tally.record.water[:, 0].sum()
    missing = 1 - inside / tally.signal[1].real
    assert tally.record.beyond == pytest.approx(missing, abs=1e-9)
    assert 0.005 < tally.record.beyond < 0.5


def frame(size):
    return Tally(
        modulation_frequency=np.array([0.0]), parts=("water",),
        batches=np.empty((0, 1, 1, 1), complex),
        histories_of=np.empty(0, dtype=np.int64), groups=0,
        contribution=(0.0, 0.0, 0.0), seed=0, next_batch=0, batch_size=size,
        problem="drawn", seconds=0.0,
    )  # fmt: skip


def drawn_batch(number):
    """Return a batch of 10 histories with the mean 5 and a variance of 1."""
    rng = np.random.default_rng(number)
    signal = np.array(5 + rng.normal() + 1j * rng.normal()).reshape(1, 1, 1)
    weight = rng.exponential(size=(3, 2, 1))
    return Batch(
        number=number, histories=10, signal=signal, weight=weight, mass=None,
        edge=None, spacing=0.0,
    )  # fmt: skip


def drawn_run(number, resume=None, progress=None):
    limits = Limits(histories=10 * number, threads=2, progress=progress)
    return conduct(drawn_batch, frame(10), limits, resume)


@pytest.mark.parametrize("number", [2, 255, 256, 257, 511, 1500])
def test_few_batches_are_kept_and_none_is_lost(number):
    tally = drawn_run(number)
    assert tally.histories_of.size <= MOST_BATCHES
    assert tally.histories == 10 * number
    direct = np.array([drawn_batch(k).signal[0, 0, 0] for k in range(number)])
    assert tally.signal[0] == pytest.approx(direct.mean(), rel=1e-13)
    # Merged batches scatter as they should: 100 of them tell a variance to 14 %.
    if number > 2:
        assert tally.covariance[0, 0, 0] == pytest.approx(1 / number, rel=0.6)
    weight = np.concatenate([drawn_batch(k).weight for k in range(number)])[..., 0]
    for row, light in enumerate((weight.sum(axis=1), weight[:, 0], weight[:, 1])):
        expected = (light.sum(), (light**2).sum(), light.max())
        np.testing.assert_allclose(tally.contributions[row, 0], expected, rtol=1e-12)
    assert tally.contribution == tuple(tally.contributions[0, 0])
    assert tally.groups == len(weight)


def test_merging_batches_leaves_the_variance_without_bias():
    # 256 batches become 128 of twice the size: the mean of many runs of the variance.
    found = []
    for run in range(20):
        limits = Limits(histories=2570, threads=1)
        tally = conduct(
            lambda k, run=run: drawn_batch(10_000 * run + k), frame(10), limits
        )
        assert tally.histories_of.size == 129
        found.append(np.trace(tally.covariance[0]) / 2)
    error = np.std(found) / np.sqrt(len(found))
    assert np.mean(found) == pytest.approx(1 / 257, abs=4 * error)
    assert error < 0.04 / 257


@pytest.mark.parametrize("cuts", [(255, 256, 257), (130, 300, 511, 512, 690)])
def test_going_on_across_merged_batches_gives_the_same_bits(cuts):
    whole = drawn_run(700)
    part, done = None, 0
    for cut in cuts:
        part = drawn_run(700, resume=part, progress=InterruptAt(cut - done))
        assert part.interrupted
        assert part.next_batch == done + (cut - done)
        done = cut
    assert_same(drawn_run(700, resume=part), whole)


@pytest.fixture
def keys_reach_python():
    """Take SIGINT as Python does, also where a shell has made us ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("keys_reach_python")
def test_a_key_pressed_at_any_moment_leaves_whole_batches():
    timer = threading.Timer(0.3, _thread.interrupt_main)
    timer.start()
    tally = drawn_run(10**5)  # would take far longer than the timer
    assert tally.interrupted
    assert tally.histories == 10 * tally.next_batch
    assert tally.groups == 3 * tally.next_batch
    direct = [drawn_batch(k).signal[0, 0, 0] for k in range(tally.next_batch)]
    assert tally.signal[0] == pytest.approx(np.mean(direct), rel=1e-12)


def test_a_failing_batch_ends_the_run_with_its_own_error():
    def batch_of(number):
        if number == 5:
            raise ZeroDivisionError("batch 5")
        return drawn_batch(number)

    with pytest.raises(ZeroDivisionError, match="batch 5"):
        conduct(batch_of, frame(10), Limits(histories=100, threads=2))


def as_python(monkeypatch, *modules):
    """Put the uncompiled loops of some files in the place of the compiled ones.

    What draws random numbers stays compiled: its words overflow as they should.
    """
    for module in modules:
        for name, loop in list(vars(module).items()):
            if hasattr(loop, "py_func") and not loop.__module__.endswith(".random"):
                monkeypatch.setattr(module, name, loop.py_func)


@pytest.mark.parametrize("shape", ["plane", "mesh"])
def test_the_uncompiled_batch_gives_the_same_record(milk, monkeypatch, shape):
    from amulor.transport.monte_carlo import _Run

    target = PlaneTarget(position=(0, 0, 1.0), reflectance=0.9)
    if shape == "mesh":
        target = MeshTarget(
            vertices=[[-2, -2, 1], [2, -2, 1], [0, 3, 1.2]], faces=[[0, 1, 2]],
            reflectance=0.9,
        )  # fmt: skip
    problem = Problem(
        medium=milk, source=Source(polarization="P", radius=0.01, divergence=0.01),
        receiver=DiscReceiver(radius=0.1, acceptance_angle=0.3, position=(0.1, 0, 0)),
        target=target,
    )  # fmt: skip
    run = _Run(
        problem=problem, technique=Technique(paths=4, partners=3), frequency=FREQUENCY,
        seed=1, size=64, keep_record=False,
    )  # fmt: skip
    compiled = run(0)
    as_python(
        monkeypatch, _batch_kernels, _contribution_kernels, _join_kernels,
        _mesh_kernels, _polarization_kernels, _reflection_kernels, _trace_kernels,
    )  # fmt: skip
    if shape == "plane":  # the compiled run joins all pairs, this one those of a cell
        monkeypatch.setattr(_join_kernels, "_MANY_PAIRS", 0)
        monkeypatch.setattr(_join_kernels, "_MOST_CELLS", 5)
    plain = run(0)
    assert np.all(np.abs(compiled.signal[0, 0]) > 0)
    assert np.any(compiled.signal[-1] != 0)
    np.testing.assert_allclose(plain.signal, compiled.signal, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(plain.weight, compiled.weight, rtol=1e-9)


@pytest.mark.parametrize(("gloss", "slope"), [(0.0, 0.2), (0.3, 0.2), (0.3, 0.4)])
def test_light_of_a_target_that_touches_a_path_is_that_of_its_brdf(milk, gloss, slope):
    target = PlaneTarget(
        position=(0, 0, 1.0), reflectance=0.6, gloss=gloss, rms_slope=slope
    )
    receiver = DiscReceiver(radius=0.1, acceptance_angle=0.3)
    problem = Problem(medium=milk, source=Source(), receiver=receiver, target=target)
    # A cone of 0.3 rad has pi sin(0.3)^2 sr of projected solid angle. The BRDF is that
    # of Lambert and of facets of slope s that face both: F / (4 pi 2 s^2).
    brdf = 0.6 / np.pi + gloss / (8 * np.pi * slope**2)
    expected = np.pi * np.sin(0.3) ** 2 * brdf
    np.testing.assert_allclose(problem.joined_touch, expected, rtol=1e-12)
    clear = Medium.homogeneous(
        absorption=0.1,
        scattering=0.0,
        group_index=1.33,
        phase_function=milk.layers[0].phase_function,
    )
    for changes in ({"target": None}, {"medium": clear}):
        assert dataclasses.replace(problem, **changes).joined_touch == 0


def test_rows_of_paths_that_are_full_become_more(peaked_water):
    # 200 paths a group fill the 64 rows that there is room for at first; the means of
    # the groups are those of groups of 2.
    technique = Technique(paths=200, partners=200)
    one, other = (
        simulate(
            peaked_water, Source(), DISC, FREQUENCY, histories=20_000, seed=seed,
            technique=choice, target=PlaneTarget(position=(0, 0, 0.5), reflectance=1.0),
        )
        for seed, choice in ((1, technique), (2, Technique(paths=2, partners=2)))
    )  # fmt: skip
    error = np.hypot(one.amplitude_uncertainty, other.amplitude_uncertainty)
    assert np.all(np.abs(np.abs(one.signal) - np.abs(other.signal)) < 4 * error)
    assert np.all(error < 0.1 * np.abs(one.signal))


def test_the_uncompiled_slab_gives_the_same_record(monkeypatch):
    from amulor.transport._problem import water_tables

    layers = tuple(
        Layer(
            absorption=0.1, scattering=scattering, thickness=0.8,
            phase_function=ScatteringMatrix.rayleigh(),
        )
        for scattering in (0.9, 2.0)
    )  # fmt: skip
    water = water_tables(layers, np.array([0.0, 0.8, 1.6]))
    light = _slab_kernels.Light(
        incidence=np.array([0.6, 0.0, 0.8]),
        stokes=np.array([1.0, 0.3, -0.4, 0.5]),
        polarized=True,
        outward=np.array([[0.0, 0.6, -0.8, 0.0, -0.8, -0.6, 0.9]]),
        near=_interface_kernels.Interface(ratio=1.3, slope=0.2, outward=-1.0),
        far=_interface_kernels.Interface(ratio=1.1, slope=0.0, outward=1.0),
        radius=np.array([0.7]),
    )

    def record_of():
        record = Deposits(
            mass=np.zeros((4, 4, 128)),
            edge=np.zeros((4, 4, 128)),
            beyond=np.zeros((4, 4, 1), dtype=complex),
            wavenumber=np.array([0.5j]),
            spacing=0.05,
            orders=0,
        )
        _slab_kernels.run_slab(random_state(2, 0), 30, light, water, record)
        return record

    compiled = record_of()
    as_python(monkeypatch, _slab_kernels, _polarization_kernels, _interface_kernels)
    plain = record_of()
    for name in ("mass", "beyond"):
        assert np.any(getattr(compiled, name) != 0)
        np.testing.assert_allclose(
            getattr(plain, name), getattr(compiled, name), rtol=1e-9, atol=1e-13
        )


def test_a_technique_sets_the_histories_of_a_batch(peaked_water):
    tally = simulate(
        peaked_water, Source(), DISC, [0.0], histories=64, seed=1,
        technique=Technique(batch=32),
    )  # fmt: skip
    assert tally.histories_of.tolist() == [32, 32]
