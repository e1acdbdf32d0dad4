"""Dead time, recorded pulses and waveforms, against counters photon by photon."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from photon_counter import histogram

from amulor import imaging, rejection
from amulor.cli.transients import transients
from amulor.errors import FormatError
from amulor.io import (
    medium_from_minimum,
    read_cube,
    read_histograms,
    read_transients,
)
from amulor.io.dead_time import without_loss
from amulor.io.slab_response import read_slabs

LIGHT = 299792458.0
PERIOD, WIDTH, BINS = 100e-9, 0.25e-9, 400
#: Harmonics of the repetition frequency, at which ambient light cancels [Hz].
FREQUENCY = np.array([10e6, 30e6])
PULSES = 2000
ECHOES = [(0.8, 20e-9, 2e-9), (0.4, 55e-9, 0.5e-9)]


def expected(echoes: list[tuple[float, float, float]]) -> np.ndarray:
    """Return the coefficients of the light, in closed form."""
    angular = 2 * np.pi * FREQUENCY
    size = np.sinc(FREQUENCY * WIDTH)
    return sum(
        PULSES
        * number
        * size
        * np.exp(1j * angular * arrival - (angular * width) ** 2 / 2)
        for number, arrival, width in echoes
    )


def counts_of(
    pixels: int,
    *,
    dead_time: float,
    seed: int,
    echoes: list[tuple[float, float, float]] = ECHOES,
    ambient: float = 2e6,
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [
            histogram(
                rng,
                pulses=PULSES,
                period=PERIOD,
                bin_width=WIDTH,
                bins=BINS,
                echoes=echoes,
                ambient=ambient,
                dead_time=dead_time,
            )
            for _ in range(pixels)
        ]
    )[None]


def saved(folder: Path, **fields: object) -> Path:
    path = folder / "scan.npz"
    np.savez_compressed(path, **({"bin_width_s": WIDTH} | fields))
    return path


@pytest.mark.parametrize("dead_time", [np.inf, 45e-9, 170e-9])
def test_light_of_a_dead_counter_is_found_within_its_error(
    tmp_path: Path, dead_time: float
) -> None:
    counts = counts_of(30, dead_time=dead_time, seed=3)
    fields = {} if np.isinf(dead_time) else {"dead_time_s": dead_time}
    path = saved(tmp_path, counts=counts, cycles=PULSES, **fields)
    cube = read_transients(path, FREQUENCY, repetition_frequency=1 / PERIOD)
    off = cube.amulor.signal.values[:, 0, 0] - expected(ECHOES)[:, None]
    errors = cube[["in_phase_uncertainty", "quadrature_uncertainty"]].isel(
        polarization=0, row=0
    )
    scores = np.concatenate(
        [
            off.real / errors["in_phase_uncertainty"].values,
            off.imag / errors["quadrature_uncertainty"].values,
        ]
    ).ravel()
    # 120 nearly independent normal scores: their mean square is 1 +- 0.13.
    assert 0.6 < np.mean(scores**2) < 1.5
    assert abs(np.mean(scores)) < 0.35
    # Without the correction more than a quarter of the light is lost.
    raw = read_transients(saved(tmp_path, counts=counts), FREQUENCY)
    lost = 1 - np.abs(raw.amulor.signal.values[0].mean() / expected(ECHOES)[0])
    assert lost > 0.25


def test_ranges_of_bright_echoes_are_inside_their_intervals(tmp_path: Path) -> None:
    echoes = [(1.5, 30e-9, 2e-9)]
    counts = counts_of(60, dead_time=np.inf, seed=5, echoes=echoes)
    true = 30e-9 * LIGHT / 2
    shifts = []
    for fields in ({}, {"cycles": PULSES}):
        path = saved(tmp_path, counts=counts, **fields)
        cube = read_transients(path, FREQUENCY)
        image = imaging.range_image(rejection.keep_water(cube), interval=(3.0, 6.0))
        shifts.append(image["slant_range"].values.ravel() - true)
        phase = np.angle(cube.amulor.signal.values[1, 0, 0])
    # The first photons are counted: bright echoes come 14 cm too early.
    assert np.mean(shifts[0]) < -0.1
    # Error of the phase at 30 MHz, from the covariance of the counts.
    signal = cube.amulor.signal.values[1, 0, 0]
    across = np.exp(-1j * np.angle(signal))
    parts = [
        cube[name].values[1, 0, 0]
        for name in (
            "in_phase_uncertainty",
            "quadrature_uncertainty",
            "in_phase_quadrature_covariance",
        )
    ]
    variance = (
        across.imag**2 * parts[0] ** 2
        + across.real**2 * parts[1] ** 2
        + 2 * across.real * across.imag * parts[2]
    )
    error = np.sqrt(variance) / np.abs(signal)
    turn = np.angle(np.exp(1j * (phase - 2 * np.pi * 30e6 * 30e-9)))
    inside = np.mean(np.abs(turn) < 1.96 * error)
    # Of 60 pixels 95 %, within three standard deviations of 2.8 %.
    assert 0.86 < inside <= 1
    assert abs(np.mean(shifts[1])) < 0.006


def test_the_error_of_the_dead_time_is_that_of_another_dead_time(
    tmp_path: Path,
) -> None:
    counts = counts_of(2, dead_time=45e-9, seed=9)
    cubes = []
    for dead, error in ((45e-9, 0.0), (46e-9, 0.0), (45e-9, 1e-9)):
        path = saved(
            tmp_path,
            counts=counts,
            cycles=PULSES,
            dead_time_s=dead,
            dead_time_uncertainty_s=error,
        )
        cubes.append(read_transients(path, FREQUENCY, repetition_frequency=1 / PERIOD))
    plain, longer, stated = (cube["in_phase_uncertainty"].values for cube in cubes)
    moved = cubes[1]["in_phase"].values - cubes[0]["in_phase"].values
    assert_allclose(stated**2, plain**2 + moved**2, rtol=1e-9)
    assert (np.abs(moved) > 0).all()
    assert longer.shape == plain.shape


def test_a_recorded_pulse_takes_its_shape_and_its_time_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    time = (np.arange(BINS) + 0.5) * WIDTH
    shape = np.exp(-0.5 * ((time - 12e-9) / 1.5e-9) ** 2)
    shape /= shape.sum()
    late = np.interp(time - 24e-9, time, shape, left=0.0)
    counts = rng.poisson(5000 * late, size=(1, 200, BINS))
    reference = rng.poisson(20_000 * shape)
    path = saved(tmp_path, counts=counts, reference_counts=reference)
    cube = read_transients(path, FREQUENCY)
    turn = (
        cube.amulor.signal.values[:, 0, 0]
        * np.exp(-2j * np.pi * FREQUENCY * 24e-9)[:, None]
    )
    delay = np.angle(turn[1]) / (2 * np.pi * 30e6)
    # The error of the pulse is common to all pixels, 1.5 ns over the root of counts.
    assert abs(delay.mean()) < 4 * 1.5e-9 / np.sqrt(20_000)
    assert np.abs(turn[0].mean()) == pytest.approx(20_000 * 0.25, rel=0.05)
    faint = saved(
        tmp_path, counts=counts, reference_counts=np.eye(1, BINS, 3, dtype=int)[0]
    )
    with pytest.raises(FormatError, match="the recorded pulse is not significant"):
        read_transients(faint, FREQUENCY)


def test_waveforms_of_a_modulated_pulse_give_phase_and_noise(tmp_path: Path) -> None:
    # Hybrid lidar-radar: a pulse with modulation at 100 MHz, sampled at 2 GHz.
    rng = np.random.default_rng(6)
    interval, start, arrival, noise = 0.5e-9, 3e-9, 40e-9, 0.02
    time = start + interval * np.arange(300)
    envelope = np.exp(-0.5 * ((time - arrival) / 10e-9) ** 2)
    pulse = envelope * (1 + np.cos(2 * np.pi * 100e6 * (time - arrival)))
    waveform = pulse + noise * rng.standard_normal((3, 40, 300))
    path = tmp_path / "waves.npz"
    fields = {"waveform": waveform, "sample_interval_s": interval, "noise_v": noise}
    np.savez(path, start_s=start, **fields)
    cube = read_transients(path, 100e6)
    signal = cube.amulor.signal.values[0, 0]
    turn = np.angle(signal * np.exp(-2j * np.pi * 100e6 * arrival))
    # White noise: sigma root(samples / 2) in each output.
    size = noise * np.sqrt(300 / 2)
    assert_allclose(cube["quadrature_uncertainty"].values, size, rtol=0.01)
    error = size / np.abs(signal)
    assert 0.9 < np.mean(np.abs(turn) < 1.96 * error) <= 1
    assert "volts_per_count" not in cube.attrs
    table = tmp_path / "waves.csv"
    lines = [
        f"{r},{c},{t!r},{v!r},{noise}"
        for r in range(2)
        for c in range(3)
        for t, v in zip(time.tolist(), waveform[r, c].tolist(), strict=True)
    ]
    table.write_text("row,column,time_s,voltage_v,noise_v\n" + "\n".join(lines))
    again = read_transients(table, 100e6)
    assert_allclose(
        again["in_phase"].values, cube["in_phase"].values[:, :, :2, :3], rtol=1e-9
    )


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"dead_time_s": 1e-8}, "field 'dead_time_s' needs 'cycles'"),
        ({"cycles": 0}, "must hold whole numbers of pulses above 0"),
        ({"cycles": np.ones(7, int)}, r"field 'cycles' has shape \(7,\)"),
        ({"cycles": 9, "dead_time_s": -1.0}, "must be above 0 s and above its"),
        ({"cycles": 2}, "has more photons than a counter with this dead time"),
        ({"cycles": 99, "dead_time_s": 1e-8}, "may last until the next pulse"),
        ({"reference_counts": np.ones(3)}, "finite numbers, one for each bin"),
        ({"waveform": np.ones((2, 9))}, r"field 'waveform' has shape \(2, 9\)"),
        ({"waveform": np.full((1, 1, 9), np.nan)}, "holds numbers that are not finite"),
        ({"waveform": np.ones((1, 1, 9))}, "'sample_interval_s' is not one number"),
    ],
)
def test_fields_that_cannot_be_used_are_named(
    tmp_path: Path, fields: dict[str, object], words: str
) -> None:
    path = saved(tmp_path, **({"counts": np.full((1, 2, 8), 3)} | fields))
    with pytest.raises(FormatError, match=words):
        read_transients(path, 50e6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,volt\n1,2\n", r"is no table of waveforms \(its first line is"),
        ("row,column,time_s,voltage_v,noise_v\n0,0,0,1,1\n0,0,1e-9,1,1\n0,0,3e-9,1,1\n",
         "the column time_s has no equal steps"),
    ],
)  # fmt: skip
def test_tables_that_are_no_waveforms_are_refused(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "waves.csv"
    path.write_text(text)
    with pytest.raises(FormatError, match=words):
        read_histograms(path)


def test_a_bin_that_every_pulse_fills_has_no_number(tmp_path: Path) -> None:
    counts = np.zeros((1, 2, 8), dtype=int)
    counts[0, :, 3] = 10, 4
    cube = read_transients(saved(tmp_path, counts=counts, cycles=10), 50e6)
    assert np.isnan(cube["in_phase"].values[0, 0, 0]).tolist() == [True, False]


def test_the_medium_from_two_scenes_needs_plain_counts(tmp_path: Path) -> None:
    path = saved(tmp_path, counts=np.full((2, 1, 2, 8), 3), cycles=99)
    with pytest.raises(
        FormatError, match="the minimum over scenes needs photon counts"
    ):
        medium_from_minimum(path, 50e6)


def test_coates_formula_for_one_bin() -> None:
    # 40 of 100 pulses give a photon in the first bin: the mean is -ln(0.6).
    found = without_loss(
        np.array([40, 30]),
        np.array(100),
        dead_bins=np.inf,
        period_bins=None,
        path=Path(),
    )
    assert_allclose(found.mean, [100 * np.log(100 / 60), 100 * np.log(60 / 30)])
    assert_allclose(found.variance, [1e4 * 40 / (100 * 60), 1e4 * 30 / (60 * 30)])


def test_slabs_with_a_dead_time_are_refused(tmp_path: Path) -> None:
    path = saved(
        tmp_path,
        counts=np.full((2, 8), 3),
        direct_counts=np.full(8, 3),
        thickness_inch=[1.0, 2.0],
        cycles=99,
    )
    with pytest.raises(FormatError, match="dead time of slabs is not corrected"):
        read_slabs(path)


def test_the_command_takes_the_repetition_frequency(tmp_path: Path) -> None:
    counts = counts_of(2, dead_time=45e-9, seed=9)
    path = saved(tmp_path, counts=counts, cycles=PULSES, dead_time_s=45e-9)
    output = tmp_path / "cube.nc"
    transients(path, frequency="10MHz,30MHz", output=output, repetition="10 MHz")
    cube = read_cube(output)
    direct = read_transients(path, FREQUENCY, repetition_frequency=10e6)
    assert_allclose(cube["in_phase"].values, direct["in_phase"].values)
