"""Range images by arrival times: codes, gates, photons, PTU files, messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from photon_counter import histogram
from scipy.signal import max_len_seq

from amulor import cube as cubes
from amulor import imaging, io
from amulor.cli._arguments import UsageError, gate_of
from amulor.cli.arrivals import arrivals
from amulor.cli.transients import transients
from amulor.cube import QualityFlag
from amulor.errors import FormatError

LIGHT = 299792458.0
STEP = 0.5e-9


def coded(folder: Path, **changes: object) -> Path:
    code = max_len_seq(7)[0]
    sent = np.repeat(code, 4)
    rng = np.random.default_rng(1)
    records = 0.9 * np.roll(sent, 60) + rng.standard_normal((4, 5, sent.size))
    fields = {
        "waveform": records,
        "sample_interval_s": STEP,
        "start_s": STEP / 2,
        "noise_v": 1.0,
        "code": code,
        "chip_s": 4 * STEP,
        "periodic": 1,
    }
    path = folder / "coded.npz"
    np.savez(path, **{k: v for k, v in (fields | changes).items() if v is not None})
    return path


def test_a_coded_record_becomes_a_range_image(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrivals(coded(tmp_path), output=tmp_path / "image.nc", group_index=1.34)
    assert "100.0% of the pixels usable" in capsys.readouterr().out
    image = io.read_cube(tmp_path / "image.nc")
    cubes.check(image, "range_image")
    error = image["slant_range"] - 30e-9 * LIGHT / 1.34 / 2
    assert np.mean(np.abs(error) < 1.96 * image["slant_range_uncertainty"]) > 0.8
    assert_allclose(image.attrs["side_lobe"], 1 / 126, rtol=1e-6)
    assert imaging.point_cloud(image).sizes["point"] == 20


def test_a_coded_record_becomes_a_cube_at_frequencies_of_the_code(
    tmp_path: Path,
) -> None:
    # The period of the code is 254 ns, and the echo is 30 ns late.
    frequency = np.array([8, 21]) / 254e-9
    cube = io.read_transients(coded(tmp_path), frequency)
    signal = cube["in_phase"].values + 1j * cube["quadrature"].values
    turn = np.exp(2j * np.pi * frequency * 30e-9)[:, None, None, None]
    error = np.angle(signal / turn)
    stated = cube["in_phase_uncertainty"].values / np.abs(signal)
    assert np.sqrt(np.mean((error / stated) ** 2)) < 1.4
    with pytest.raises(FormatError, match="not significant"):
        io.read_transients(tmp_path / "coded.npz", 500e6)


def test_a_gate_stack_of_rectangular_pulse_and_gate(tmp_path: Path) -> None:
    # The overlap of a pulse of 3 ns and a gate of 5 ns is a trapezoid of the delay.
    step = 0.25e-9
    delay = np.arange(0, 60e-9, step)

    def trapezoid(arrival: float) -> np.ndarray:
        first = np.maximum(delay, arrival)
        last = np.minimum(delay + 5e-9, arrival + 3e-9)
        return np.maximum(last - first, 0) / 3e-9

    rng = np.random.default_rng(2)
    arrival = np.linspace(20e-9, 24e-9, 12).reshape(3, 4)
    stack = np.array([[trapezoid(time) for time in row] for row in arrival])
    np.savez(
        tmp_path / "gates.npz",
        waveform=stack + 0.04 * rng.standard_normal(stack.shape),
        sample_interval_s=step,
        noise_v=0.04,
        reference_waveform=trapezoid(10e-9),
    )
    image = io.read_arrivals(tmp_path / "gates.npz")
    error = image["slant_range"].values - (arrival - 10e-9) * LIGHT / 2
    stated = image["slant_range_uncertainty"].values
    assert (image["quality_flag"] == 0).all()
    assert np.mean(np.abs(error) < 1.96 * stated) > 0.8


def test_a_gate_removes_early_light_and_keeps_the_echo(tmp_path: Path) -> None:
    counts = np.zeros((1, 2, 400), dtype=int)
    counts[..., 20:60] = 500  # backscatter
    counts[..., 200] = 900
    np.savez(tmp_path / "scan.npz", counts=counts, bin_width_s=1e-10)
    path = tmp_path / "scan.npz"
    output = tmp_path / "samples.nc"
    transients(path, frequency="50MHz", output=output, gate="15ns,30ns")
    cube = io.read_cube(output)
    signal = cube["in_phase"].values + 1j * cube["quadrature"].values
    assert_allclose(signal, 900 * np.exp(2j * np.pi * 50e6 * 20.05e-9), rtol=1e-9)
    # Photons of one phase.
    total = cube["in_phase_uncertainty"] ** 2 + cube["quadrature_uncertainty"] ** 2
    assert_allclose(total, 900, rtol=1e-9)
    assert_allclose(cube.attrs["gate"], [15e-9, 30e-9])


def test_a_gate_does_not_remove_the_recorded_pulse(tmp_path: Path) -> None:
    counts, pulse = np.zeros((1, 1, 400), dtype=int), np.zeros(400)
    counts[..., 200], pulse[10] = 900, 5000
    np.savez(
        tmp_path / "scan.npz",
        counts=counts,
        bin_width_s=1e-10,
        reference_counts=pulse,
    )
    cube = io.read_transients(tmp_path / "scan.npz", 50e6, gate=(15e-9, 30e-9))
    phase = np.arctan2(cube["quadrature"], cube["in_phase"]).item()
    assert_allclose(phase, np.angle(np.exp(2j * np.pi * 50e6 * 19e-9)), rtol=1e-9)


def test_dead_time_moves_the_arrival_unless_the_pulses_are_stated(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(3)
    bins, width, pulses = 200, 0.25e-9, 1000
    time = (np.arange(bins) + 0.5) * width
    pulse = np.exp(-0.5 * ((time - 10e-9) / 1.5e-9) ** 2)
    counts = np.array(
        [
            histogram(
                rng,
                pulses=pulses,
                period=bins * width,
                bin_width=width,
                bins=bins,
                echoes=[(1.5, 30e-9, 1.5e-9)],
                ambient=1e6,
                dead_time=np.inf,
            )
            for _ in range(12)
        ]
    ).reshape(3, 4, bins)
    true = 20e-9 * LIGHT / 2
    fields = {"counts": counts, "bin_width_s": width, "reference_counts": pulse}
    path = tmp_path / "scan.npz"
    np.savez(path, **fields, cycles=pulses)
    image = io.read_arrivals(path)
    error = image["slant_range"].values - true
    stated = image["slant_range_uncertainty"].values
    assert np.abs(error).max() < 3.5 * stated.max()
    np.savez(path, **fields)
    moved = io.read_arrivals(path)["slant_range"].values - true
    assert np.mean(moved) < -10 * stated.max()


def test_flags_of_pixels_without_an_echo_and_with_two(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    bins = np.arange(300)
    pulse = np.exp(-0.5 * ((bins - 50) / 4) ** 2)
    counts = rng.poisson(0.1, (2, 2, 300))
    counts[0, 1] += rng.poisson(30 * np.roll(pulse, 60) + 40 * np.roll(pulse, 150))
    counts[1, 0] += rng.poisson(40 * np.roll(pulse, 150))
    counts[1, 1] = 0
    np.savez(
        tmp_path / "scan.npz", counts=counts, bin_width_s=1e-9, reference_counts=pulse
    )
    flag = io.read_arrivals(tmp_path / "scan.npz")["quality_flag"].values
    assert flag[0, 0] & QualityFlag.NO_TARGET
    assert flag[1, 1] & QualityFlag.NO_TARGET
    assert flag[0, 1] == QualityFlag.MIXED
    assert flag[1, 0] == 0


def test_a_ptu_file_has_the_counts_that_another_program_wrote(tmp_path: Path) -> None:
    ptufile = pytest.importorskip("ptufile")
    counts = np.random.default_rng(5).poisson(0.7, (3, 4, 2, 64)).astype(np.uint8)
    path = tmp_path / "scan.ptu"
    ptufile.imwrite(path, counts, 100e-9, 64e-12)
    found = io.read_histograms(path)
    assert_allclose(found.bin_width, 64e-12)
    assert found.counts.shape == (2, 3, 4, found.counts.shape[-1])
    last = found.counts.shape[-1]
    assert np.array_equal(found.counts, np.moveaxis(counts, 2, 0)[..., :last])
    assert not counts[..., last:].any()
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FormatError, match="cannot be read as a PTU image"):
        io.read_histograms(path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"chip_s": None}, "needs 'chip_s'"),
        ({"code": np.ones(5)}, "chips that differ"),
        ({"chip_s": 1e-9}, "needs a record of one period"),
        ({"code": None, "chip_s": None}, "arrival times need the pulse"),
    ],
)
def test_wrong_codes_are_named(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(FormatError, match=words):
        io.read_arrivals(coded(tmp_path, **changes))


def test_wrong_options_are_named(tmp_path: Path) -> None:
    path = coded(tmp_path)
    with pytest.raises(FormatError, match="the gate from"):
        io.read_arrivals(path, gate=(1.0, 2.0))
    with pytest.raises(FormatError, match="neighbors are for photon histograms"):
        io.read_arrivals(path, neighbors=1)
    with pytest.raises(UsageError, match="must not be negative"):
        arrivals(path, output=tmp_path / "image.nc", group_index=1.0, neighbors=-1)
    with pytest.raises(UsageError, match="two increasing times"):
        gate_of("20ns,10ns")
    np.savez(
        path,
        counts=np.ones((1, 1, 20), dtype=int),
        bin_width_s=1e-9,
        code=[0, 1],
        chip_s=10e-9,
        periodic=1,
    )
    with pytest.raises(FormatError, match="a periodic code needs waveforms"):
        io.read_arrivals(path)
