"""Batches of photon histories: sizes, settings of the loops, and their records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor.optics.phase_functions.models import isotropic
from amulor.transport import (
    DiscReceiver,
    Medium,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    Technique,
    monte_carlo,
    simulate,
)
from amulor.transport import _runs as runs
from amulor.transport._derivatives import Derivatives
from amulor.transport._kernels import batch as batch_kernels
from amulor.transport._problem import Problem
from amulor.transport._runs import (
    Record,
)

DISC = DiscReceiver(radius=0.05, acceptance_angle=0.3)
PLATE = PlaneTarget(position=(0, 0, 2), reflectance=0.6)


def water(albedo=0.7, function=None):
    """Return water with an attenuation of 1 1/m."""
    return Medium.homogeneous(
        absorption=1 - albedo,
        scattering=albedo,
        phase_function=function or isotropic(),
        group_index=1.33,
    )


def run_of(*, albedo=0.7, target=PLATE, size=80, medium=None, receiver=DISC, **options):
    """Return a run with a technique, not started."""
    return monte_carlo._Run(
        problem=Problem(
            medium=medium or water(albedo),
            source=Source(),
            receiver=receiver,
            target=target,
        ),
        technique=Technique(**options),
        frequency=np.array([0.0, 5e7]),
        seed=3,
        size=size,
        keep_record=False,
    )


def test_a_technique_has_the_numbers_of_its_pages():
    assert Technique() == Technique(
        paths=8, partners=8, reflections=16, roulette=None, stratified=True,
        balanced=True, batch=None, direct=None, scattering_orders=10,
    )  # fmt: skip


@pytest.mark.parametrize(
    "name",
    ["paths", "partners", "reflections", "roulette", "batch", "scattering_orders"],
)
def test_each_number_of_a_technique_is_whole_and_at_least_1(name):
    others = {"paths": 1} if name == "batch" else {}
    assert getattr(Technique(**{name: 1, **others}), name) == 1
    for wrong in (0, 1.5):
        message = f"^{name} must be a whole number from 1, got {wrong}$"
        with pytest.raises(ValueError, match=message):
            Technique(**{name: wrong, **others})


@pytest.mark.parametrize(
    ("histories", "options", "size"),
    [
        (1, {}, 8),
        (128 * 8 * 3, {}, 24),
        (128 * 8 * 3 + 1, {}, 32),
        (128 * 5 * 3, {"paths": 5}, 15),
        (10**9, {}, 65536),
        (10**9, {"paths": 100}, 65500),
        (10**9, {"paths": 70_000}, 70_000),
        (10**9, {"batch": 40}, 40),
    ],
)
def test_a_run_is_divided_into_128_batches_of_whole_groups(histories, options, size):
    assert monte_carlo._batch_size(histories, Technique(**options)) == size


def test_long_paths_end_at_random_in_bright_water_only():
    assert run_of(albedo=0.96).roulette == 16
    assert run_of(albedo=0.94).roulette == 2**40
    assert run_of(albedo=0.96, roulette=5).roulette == 5
    assert run_of(albedo=0.94, roulette=5).roulette == 5


@pytest.mark.parametrize(
    ("options", "groups"),
    [
        # A path has 1 / (1 - albedo) segments: 7 of them 23.3, of 200,000 together.
        ({"paths": 7, "partners": 3, "size": 70_000}, 8571),
        ({"paths": 3, "partners": 7, "size": 70_000}, 8571),
        ({"paths": 7, "partners": 3, "size": 35}, 5),
        ({"paths": 7, "partners": 3, "size": 70_000, "target": None}, 1),
        ({"paths": 200_001, "size": 400_002, "albedo": 0.0}, 1),
        # Beyond 2 scatterings 2 / n of the n-th power: 1.75 + 2 (ln 2 - 0.625).
        ({"paths": 10, "roulette": 2, "size": 10**6, "albedo": 0.5}, 10_602),
    ],
)
def test_reflections_are_joined_over_as_many_groups_as_memory_has(options, groups):
    assert run_of(**options).block == groups


def test_parts_of_the_light_are_named_by_their_scatterings():
    run = run_of(scattering_orders=3)
    frame = run.frame()
    assert frame.parts == (
        "water, order 1", "water, order 2", "water, order 3 and above",
        "target", "target, scattered",
    )  # fmt: skip
    assert frame.batches.shape == (0, 5, 1, 2)
    assert frame.histories_of.size == 0
    assert (frame.groups, frame.contribution) == (0, (0, 0, 0))
    assert (frame.seed, frame.next_batch, frame.batch_size) == (3, 0, 80)
    assert (frame.seconds, frame.interrupted, frame.unseen) == (0, False, 0)
    assert frame.problem == run.problem.digest
    assert frame.phase_function_integral == pytest.approx((1.0,))
    assert run_of(scattering_orders=1).frame().parts[0] == "water, order 1 and above"
    assert len(run_of().frame().parts) == 12
    rayleigh = water(function=ScatteringMatrix.rayleigh(cells=64))
    assert run_of(medium=rayleigh).frame().batches.shape == (0, 12, 4, 2)


def test_a_run_states_all_that_its_batches_depend_on():
    run = run_of(paths=4)
    stated = run.stated
    assert stated["problem"] == run.problem.digest
    assert stated["technique"]["paths"] == 4
    assert stated["modulation_frequency"] == [0, 5e7]
    assert (stated["seed"], stated["histories"], stated["record"]) == (3, 80, False)


@pytest.fixture
def loop(monkeypatch):
    """Return the calls of the compiled loop; it reaches 3 reflections."""
    calls = []

    def run_batch(*arguments):
        calls.append(arguments)
        return 3.0

    monkeypatch.setattr(batch_kernels, "run_batch", run_batch)
    return calls


def test_the_loop_gets_the_numbers_of_the_technique(loop):
    run = run_of(
        paths=4, partners=3, reflections=5, roulette=6, stratified=False, size=40
    )
    batch = run(7)
    state, scene, plan, record, weight = loop[0]
    assert plan._asdict() == {
        "paths": 4, "partners": 3, "block": 10, "reflections": 5, "roulette": 6,
        "stratified": False, "balanced": True, "direct": True, "polarized": False,
    }  # fmt: skip
    assert_array_equal(state, runs.random_state(3, 7))
    assert not scene.face.moved
    assert record.orders == 10
    assert weight.shape == (10, 2, 1)
    assert (batch.number, batch.histories, batch.mass) == (7, 40, None)
    # Twice the light of 3 of 4 x 3 x 10 pairs.
    joined = run.problem.joined_touch
    assert batch.unseen == pytest.approx(2 * 3 * joined / 120)


@pytest.mark.parametrize(
    ("acceptance", "direct", "expected"),
    [(0.349, None, True), (0.351, None, False), (0.349, False, False),
     (0.351, True, True)],
)  # fmt: skip
def test_the_last_way_is_estimated_for_narrow_receivers(
    loop, acceptance, direct, expected
):
    receiver = DiscReceiver(radius=0.05, acceptance_angle=acceptance)
    run_of(receiver=receiver, direct=direct)(0)
    assert loop[0][2].direct is expected


def test_a_run_starts_at_the_batches_of_the_one_before(loop):
    def run(**options):
        return simulate(water(), Source(), DISC, [0.0], seed=1, threads=1, **options)

    first = run(histories=16, technique=Technique(batch=16))
    assert (first.histories, first.next_batch, len(loop)) == (16, 1, 1)
    second = run(histories=48, technique=Technique(), resume=first)
    assert (second.histories, second.next_batch, len(loop)) == (48, 3, 3)
    assert (loop[0][2].paths, loop[0][2].roulette) == (8, 2**40)
    # A histories number within a batch is one more batch.
    assert run(histories=17, technique=Technique(batch=16)).histories == 32


def test_the_step_of_a_record_is_a_twentieth_of_a_length_or_of_a_radian():
    def record(attenuation, frequency, **options):
        frame = replace(run_of().frame(), parts=("water", "target", "scattered"))
        return Record.empty(
            np.array(attenuation), 1.5, np.array(frequency), frame, **options
        )

    # 30 lengths of the clearest water that absorbs or scatters.
    still = record([1.0, 0.0, 0.7], [0.0, 1e3])
    assert still.spacing == pytest.approx(0.05)
    assert still.mass.shape == still.edge.shape == (3, 1, 857)
    assert still.beyond.shape == (3, 1, 2)
    assert still.parts == 3
    assert_allclose(
        still.wavenumber, [0, 2j * np.pi * 1e3 * 1.5 / speed_of_light], rtol=1e-15
    )
    fast = record([0.9, 0.7], [1e9, 0.0], scores=2, lengths=True)
    wave = 2 * np.pi * 1e9 * 1.5 / speed_of_light
    assert fast.spacing == pytest.approx(0.05 / wave)
    assert fast.mass.shape == (7, 1, 16384)
    assert fast.beyond.shape == (9, 1, 2)
    short = record([20.0, 19.0], [0.0], scores=1)
    assert short.mass.shape == (5, 1, 631)
    assert short.beyond.shape == (5, 1, 1)


def filled():
    """Return a record of three parts with light of 6, 4 and 2 at the length 0.3 m."""
    frame = replace(run_of().frame(), parts=("water", "target", "scattered"))
    record = Record.empty(np.array([2.0]), 1.5, np.array([0.0, 5e7]), frame, scores=1,
                          lengths=True)  # fmt: skip
    record.mass[:3, 0, 12] = (6, 4, 2)
    record.mass[3:, 0, 12] = (8, 12)
    return record


def test_a_batch_is_the_mean_of_its_units():
    phase = np.exp(2j * np.pi * 5e7 * 1.5 / speed_of_light * 0.3)
    weight = np.ones((2, 2, 1))
    batch = filled().batch(4, 20, 10, weight, keep=True)
    assert (batch.number, batch.histories, batch.unseen) == (4, 20, 0)
    assert batch.spacing == pytest.approx(0.025)
    assert batch.weight is weight
    expected = np.outer([0.6, 0.4, 0.2], [1, phase])
    assert_allclose(batch.signal[:, 0], expected)
    assert batch.mass.shape[0] == batch.edge.shape[0] == 3
    assert_allclose(batch.mass[:, 0, 12], [0.6, 0.4, 0.2])
    bare = filled().batch(4, 20, 10, weight, keep=False, unseen=0.25)
    assert bare.mass is bare.edge is None
    assert bare.unseen == 0.25


@pytest.mark.parametrize("name", ["absorption", "reflectance"])
def test_a_batch_has_derivatives_behind_its_light(name):
    wave = 2j * np.pi * np.array([0.0, 5e7]) * 1.5 / speed_of_light
    phase = np.exp(wave * 0.3)
    batch = filled().batch(
        0,
        20,
        10,
        np.ones((2, 2, 1)),
        keep=False,
        derivatives=Derivatives(names=(name,)),
    )
    assert batch.signal.shape == (5, 1, 2)
    light = np.outer([0.6, 0.6], phase)  # water, and both parts of the target
    score = np.outer([0.8, 1.2], phase)
    expected = -0.3 * light if name == "absorption" else score
    assert_allclose(batch.signal[3:, 0], expected, rtol=1e-12)


def test_only_the_last_two_parts_are_light_of_the_target():
    frame = run_of().frame()
    record = Record.empty(np.array([1.0]), 1.5, np.array([0.0]), frame, lengths=True)
    record.mass[9, 0, 4], record.mass[10, 0, 6], record.mass[11, 0, 8] = 1, 10, 100
    water_length, target_length = record._lengths()[:, 0, 0]
    assert water_length == pytest.approx(0.2)
    assert target_length == pytest.approx(10 * 0.3 + 100 * 0.4)
