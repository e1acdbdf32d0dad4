"""Measured histograms of foam: published numbers, and the example, come out again."""

import contextlib
import dataclasses
import io
import re
import sys
from importlib import resources
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from scripts import script

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cli import main
from amulor.cube import QualityFlag
from amulor.io import read_cube
from amulor.io.slab_response import mean_delay, read_slabs, slab_response
from amulor.io.transients import medium_from_minimum, read_transients

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = Path(str(resources.files("amulor.samples").joinpath("data", "foam")))
INCH = 0.0254
LABELS = 0.78 - 0.54
FREQUENCY = np.array([50e6, 100e6, 200e6, 400e6])


@pytest.fixture(scope="module")
def slabs():
    return read_slabs(DATA / "slab_transmission.npz")


@pytest.fixture(scope="module")
def table():
    """Columns of the published table, (slabs, frequencies); delays are negative."""
    columns = np.loadtxt(
        DATA / "slab_frequency_response.csv", delimiter=",", skiprows=1, unpack=True
    )
    thickness, megahertz, amplitude, phase = (
        column.reshape(8, -1) for column in columns
    )
    assert_array_equal(thickness[:, 0], np.arange(1, 9))
    return 1e6 * megahertz[0], amplitude, -np.radians(phase)


@pytest.fixture(scope="module")
def example():
    matplotlib.use("Agg")
    return script("examples/foam_transients.py")


@pytest.fixture(scope="module")
def printed(example, tmp_path_factory):
    """What the example prints; its figures lie in the folder that it names."""
    output = tmp_path_factory.mktemp("foam") / "figures"
    text = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(text):
        patch.setattr(sys, "argv", ["foam_transients.py", "--output", str(output)])
        example.main()
    return text.getvalue()


def wrapped(angle):
    return np.angle(np.exp(1j * np.asarray(angle)))


# Slabs


def test_the_published_table_comes_out_to_its_last_digit(slabs, table):
    frequency, amplitude, phase = table
    # The table was made with what falls below the background set to zero.
    slabs = dataclasses.replace(slabs, counts=np.maximum(slabs.counts, 0))
    response = slab_response(slabs, frequency)
    # Printed are 5 digits of the ratio and 3 digits of the degrees, so halves of these
    # and the rounding of this sum itself.
    assert_allclose(response["amplitude"], amplitude, rtol=0, atol=0.501e-5)
    turn = np.degrees(wrapped(response["phase"] - phase))
    assert_allclose(turn, 0, atol=0.501e-3)


def test_without_zeroed_noise_the_table_moves_by_less_than_a_thousandth(slabs, table):
    frequency, amplitude, phase = table
    response = slab_response(slabs, frequency)
    # Noise that is set to zero where negative is light of half its deviation: about
    # 0.4 sqrt(150) in each of 12503 bins, 1.3e-3 of 4.7e7 counts, in both H and 1.
    assert_allclose(response["amplitude"], amplitude, rtol=0, atol=1e-3)
    shift = amplitude * np.abs(wrapped(response["phase"] - phase))
    assert_allclose(shift, 0, atol=1e-3)


def test_thicker_slabs_damp_and_delay_more(slabs):
    response = slab_response(slabs, 100e6)["amplitude"].values[:, 0]
    # Published for 1, 4 and 8 inch: 0.992, 0.649, 0.207.
    assert_allclose(response[[0, 3, 7]], [0.992, 0.649, 0.207], rtol=0, atol=1e-3)
    assert np.all(np.diff(response) < 0)
    delay = mean_delay(slabs)
    # Published: 0.20 to 8.4 ns. The mean weighs the background by its lateness, so
    # that of the thickest slab is known to about 1 %.
    assert_allclose(delay[0], 0.20e-9, atol=0.005e-9)
    assert_allclose(delay[7], 8.4e-9, rtol=0.01)
    assert np.all(np.diff(delay) > 0)


@pytest.mark.slow
def test_the_cut_off_drops_with_thickness(slabs, printed):
    # Printed to 1 MHz, which is 1.5 % of the lowest and as much of the amplitude.
    limits = 1e6 * np.array(
        [float(found) for found in re.findall(r"cm +(\d+) MHz +\S+ ns", printed)]
    )
    assert len(limits) == 8
    assert np.all(np.diff(limits) < 0)
    amplitude = [
        slab_response(slabs, limit)["amplitude"].values[number, 0]
        for number, limit in enumerate(limits)
    ]
    assert_allclose(amplitude, np.sqrt(0.5), rtol=0.015)


def diffusion_response(frequency, thickness):
    """Light through a slab by diffusion, straight across, closed form (no fit).

    Sum over images of the source (Contini et al., Appl. Opt. 36, 4587 (1997)), with the
    parameters that Lindell and Wetzstein give for their foam.
    """
    reduced_scattering, absorption, index, extrapolation = 262.0, 0.53, 1.12, 3.6e-3
    diffusion = 1 / (3 * (absorption + reduced_scattering))
    order = np.arange(-20, 21)
    depth = 1 / reduced_scattering
    positive = thickness * (1 - 2 * order) - 4 * order * extrapolation - depth
    negative = thickness * (1 - 2 * order) - (4 * order - 2) * extrapolation + depth

    def transmitted(f):
        loss = absorption - 2j * np.pi * f * index / speed_of_light
        wavenumber = np.sqrt(loss / diffusion)

        def flux(z):
            path = wavenumber * np.abs(z)
            return np.sum(np.sign(z) * (1 + path) * np.exp(-path) / z**2)

        return flux(positive) - flux(negative)

    return transmitted(frequency) / transmitted(0.0)


def test_measured_damping_is_that_of_diffusion_theory(slabs):
    frequency = np.array([50e6, 80e6, 100e6, 138e6, 146e6, 200e6])
    expected = np.array(
        [
            [diffusion_response(f, thickness) for f in frequency]
            for thickness in INCH * np.arange(1, 9)
        ]
    )
    response = slab_response(slabs, frequency)
    difference = response["amplitude"].values - np.abs(expected)
    # Published: 0.010 over all thicknesses at 50 to 200 MHz.
    assert np.sqrt(np.mean(difference**2)) < 0.0115
    # Theory starts at the front of the slab, the measurement where the light without a
    # slab is when it has gone as far. The authors fit a start per slab; without that
    # 0.43 ns are left of delays up to 8.4 ns.
    way = INCH * np.arange(1, 9)[:, np.newaxis] / speed_of_light
    turn = 2 * np.pi * frequency
    misfit = wrapped(response["phase"].values - np.angle(expected) + turn * way) / turn
    assert np.abs(misfit).max() < 0.45e-9


# The letter U at two distances


@pytest.fixture(scope="module")
def scenes():
    path = DATA / "letter_u_54_78.npz"
    medium = medium_from_minimum(path, FREQUENCY)
    return [
        cubes.attach(read_transients(path, FREQUENCY, scene=n), medium, "open_water")
        for n in (0, 1)
    ]


def range_difference(near, far):
    """Return range steps per metre of label, unwrapped to what is next to it."""
    sums = [
        (cube["in_phase"] + 1j * cube["quadrature"]).sum(
            ("polarization", "row", "column")
        )
        for cube in (near, far)
    ]
    found = np.angle(sums[1] / sums[0]) * speed_of_light / (4 * np.pi * FREQUENCY)
    interval = speed_of_light / (2 * FREQUENCY)
    return (found + interval * np.round((LABELS - found) / interval)) / LABELS


def test_range_steps_are_the_published_ones_with_and_without_the_foam(scenes):
    raw = range_difference(*scenes)
    clean = range_difference(*[rejection.open_water(scene) for scene in scenes])
    # Published to two digits at 50 and 100 MHz. Counting 8.7e6 photons leaves 0.1 mm of
    # the 24 cm, 0.0004 of the ratio, which is nothing beside half a digit.
    assert_allclose(raw[:2], [0.80, 0.84], rtol=0, atol=0.0054)
    assert_allclose(clean[:2], [1.02, 1.02], rtol=0, atol=0.0054)
    # At 200 and 400 MHz the foam has lost most of its modulation: it shifts less.
    shift = np.abs(raw - clean)
    assert shift[2] < shift[1] / 3
    assert shift[3] < shift[2]
    assert_allclose(clean[2:], 1, atol=0.02)
    # With the foam taken out, 50 and 100 MHz say what 400 MHz says; raw they are short.
    assert_allclose(clean[:2] / clean[3], 1, atol=0.03)
    assert np.all(raw[:2] / clean[3] < 0.86)


def test_at_400_megahertz_the_step_is_ambiguous(scenes):
    first, second = (
        scene.amulor.signal.isel(modulation_frequency=3).sum() for scene in scenes
    )
    found = np.angle(second / first) * speed_of_light / (4 * np.pi * 400e6)
    # Published interval: 37.5 cm, so 24 cm appear as 24 - 37.5 = -13.5 cm.
    assert_allclose(found, 0.24 - 0.375, atol=0.006)


def test_the_foam_alone_is_the_same_in_both_scenes():
    # The estimate of the foam rests on that. Bins before the first echo, 11 and 30
    # thousand photons each, agree within their counting noise.
    counts = np.load(DATA / "letter_u_54_78.npz")["counts"].sum(axis=(1, 2))
    for first, end in ((150, 200), (200, 235)):
        near, far = counts[:, first:end].sum(axis=1).astype(float)
        assert abs(near - far) < 3 * np.sqrt(near + far)


def test_the_range_image_is_farther_by_the_step(scenes):
    ranges = []
    for scene in scenes:
        one = rejection.open_water(scene).sel(modulation_frequency=[100e6])
        image = imaging.range_image(one, interval=(0.0, 1.45))
        cubes.check(image, "range_image")
        ranges.append(image["slant_range"].values)
        # The photon limit of the echo alone is a lower bound.
        limit = image["slant_range_photon_limit"] <= image["slant_range_uncertainty"]
        assert np.all(limit | np.isnan(image["slant_range"]))
    step = ranges[1] - ranges[0]
    # In the middle, where the echo is bright; single pixels have a foam of their own
    # (15 % from pixel to pixel), which moves them by centimetres.
    assert_allclose(np.median(step[10:22, 10:22]), LABELS, atol=0.02)


# Echoes that overlap


def moved(cm, folder):
    """Save real foam and letter, the letter moved by so much; return its two echoes.

    The foam is what no scene shows the letter in, bridged by a straight logarithm; the
    far letter is the near one, later and weaker with the square of its distance. Blocks
    of 4 x 4 pixels are taken together.
    """
    file = np.load(DATA / "letter_u_54_78.npz")
    counts = file["counts"].astype(float).reshape(2, 8, 4, 8, 4, -1).sum(axis=(2, 4))
    whole = counts.sum(axis=(1, 2))
    foam = np.where(np.arange(512) < 325, whole[1], whole[0])
    bridge = np.arange(325, 466)
    ends = [whole[1, 300:325].mean(), whole[0, 466:490].mean()]
    foam[bridge] = np.exp(np.interp(bridge, [312, 478], np.log(ends)))
    share = counts[..., :230].sum(axis=(0, -1))
    medium = share[..., None] / share.sum() * foam
    near = np.maximum(counts[0] - medium, 0)
    near[..., :225] = 0
    bins = np.arange(512.0)
    later = 2 * cm / 100 / speed_of_light / file["bin_width_s"]
    weaker = (0.54 / (0.54 + cm / 100)) ** 2
    far = np.apply_along_axis(
        lambda echo: weaker * np.interp(bins - later, bins, echo, left=0), -1, near
    )
    rng = np.random.default_rng(cm)
    seen = rng.poisson(np.stack([medium + near, medium + far]))
    path = folder / f"moved_{cm}.npz"
    np.savez_compressed(path, counts=seen, bin_width_s=file["bin_width_s"])
    return path, (near, far)


@pytest.mark.parametrize("cm", [6, 12, 18, 24])
def test_a_medium_with_an_echo_in_it_is_stated_as_such(cm, tmp_path, capsys):
    # Steps came out 2.6, 1.5, 1.15 and 1.05 times too long, and nothing said so.
    path, echoes = moved(cm, tmp_path)
    medium = medium_from_minimum(path, FREQUENCY)
    turn = 2j * np.pi * FREQUENCY[:, None]
    for scene, echo in enumerate(echoes):
        cube = cubes.attach(
            read_transients(path, FREQUENCY, scene=scene), medium, "open_water"
        )
        left = rejection.open_water(cube)
        signal = left.amulor.signal.values[:, 0].sum(axis=(1, 2))
        seconds = (np.arange(512) + 0.5) * 16e-12
        each = np.tensordot(np.exp(turn * seconds), echo, axes=(1, 2))
        truth = each.sum(axis=(1, 2))
        # Along the error that the shots share: the echo that is missing.
        error = 64 * np.sqrt(
            medium["common_in_phase_uncertainty"].values[:, 0] ** 2
            + medium["common_quadrature_uncertainty"].values[:, 0] ** 2
        )
        assert np.all(np.abs(signal - truth) < 1.6 * error)
        # Where the error is most of the echo, nothing is called a target.
        flag = left["quality_flag"].values[:, 0]
        if cm == 6 and scene == 1:
            assert np.mean((flag & QualityFlag.NO_TARGET) != 0) > 0.95
        interval = speed_of_light / 200e6
        one = left.sel(modulation_frequency=[100e6])
        image = imaging.range_image(one, interval=(0.0, interval))
        expected = np.angle(each[1]) * interval / (2 * np.pi)
        off = image["slant_range"].values - expected % interval
        within = np.abs(off) < 2.5 * image["slant_range_uncertainty"].values
        known = np.isfinite(off)
        assert np.mean(within[known]) > 0.9 if known.any() else cm < 12
    arguments = ["import", "transients", str(path), "--scene", "0", "--medium"]
    output = str(tmp_path / "cube.nc")
    assert main([*arguments, "--frequency", "100MHz", "-o", output]) == 0
    assert "overlap in time" in capsys.readouterr().out


def test_the_real_step_is_one_within_what_the_shots_state(scenes):
    # 1.02 to 1.00 by frequency, with bars that hold 1: the minimum has a bump of some
    # percent of the echo, and what it moves either scene by is stated.
    bars, sums = [], []
    for scene in scenes:
        left = rejection.open_water(scene)
        signal = left.amulor.signal.values[:, 0].sum(axis=(1, 2))
        shared = left["common_in_phase_uncertainty"].values[:, 0, 0, 0]
        across = left["common_quadrature_uncertainty"].values[:, 0, 0, 0]
        number = scene.sizes["row"] * scene.sizes["column"]
        moved_by = number * np.hypot(shared, across) / np.abs(signal)
        bars.append(moved_by * speed_of_light / (4 * np.pi * FREQUENCY) / LABELS)
        sums.append(signal)
    clean = np.angle(sums[1] / sums[0]) * speed_of_light / (4 * np.pi * FREQUENCY)
    interval = speed_of_light / (2 * FREQUENCY)
    slope = (clean + interval * np.round((LABELS - clean) / interval)) / LABELS
    bar = np.hypot(*bars)
    assert np.all(np.abs(slope - 1) < bar + 0.001)
    # And bars that say something: from a quarter at 50 MHz to 2 % at 400 MHz.
    assert np.all(bar < 14e6 / FREQUENCY)
    assert np.all(np.diff(bar) < 0)


# Letters S and T


def test_known_files_bring_their_scan_and_their_licence():
    for name, side in (("letter_s", 0.60), ("letter_t", 0.70)):
        cube = read_transients(DATA / f"{name}.npz", 100e6)
        cubes.check(cube, "samples")
        assert_allclose(np.ptp(cube["origin_x"].values), side)
        # The first axis of these files goes right: the letters stand upright.
        assert_allclose(np.diff(cube["origin_x"].values, axis=1), 0)
        assert cube.attrs["license"].startswith("MIT")
        assert "Lindell" in cube.attrs["references"]
    cube = read_transients(DATA / "slab_transmission.npz", [10e6, 36.7e6])
    assert_array_equal(cube.attrs["frequencies_between_harmonics"], [36.7e6])


def pictures(example, slabs, letter):
    """Return the refocused letter and its amplitude at 100 MHz, both upright."""
    path = DATA / example.LETTERS[letter]
    volume = example.refocus(
        read_transients(path, example.BAND), example.foam_twice(slabs)
    )
    blurred = read_transients(path, 100e6).amulor.amplitude.values[0, 0]
    # Rows of the cube go right here.
    return volume.max(axis=0).T, blurred.T


def likeness(picture, strokes):
    """Return the largest correlation of a picture with strokes of any size."""
    pattern = np.array([[cell == "#" for cell in row] for row in strokes], dtype=float)
    best = -1.0
    for height in range(20, 32, 2):
        for width in range(16, 32, 2):
            rows = np.arange(height) * 5 // height
            columns = np.arange(width) * 5 // width
            stencil = pattern[np.ix_(rows, columns)].ravel()
            for top in range(0, 33 - height, 2):
                for left in range(0, 33 - width, 2):
                    part = picture[top : top + height, left : left + width]
                    best = max(best, np.corrcoef(part.ravel(), stencil)[0, 1])
    return best


def test_the_letter_s_is_read_at_gigahertz_and_not_at_100_megahertz(example, slabs):
    sharp, blurred = pictures(example, slabs, "S")
    strokes = ["#####", "#....", "#####", "....#", "#####"]
    mirrored = [row[::-1] for row in strokes]
    assert likeness(sharp, strokes) > 0.75
    assert likeness(sharp, strokes) > likeness(sharp, mirrored) + 0.25
    assert likeness(blurred, strokes) < 0.2


def test_the_letter_t_is_read_at_gigahertz_and_not_at_100_megahertz(example, slabs):
    sharp, blurred = pictures(example, slabs, "T")

    def widths(picture, rows):
        return [np.sum(row > row.max() / 2) for row in picture[rows]]

    bar, stem = slice(6, 9), slice(12, 21)
    assert min(widths(sharp, bar)) > 1.6 * max(widths(sharp, stem))
    assert max(widths(blurred, bar)) < 1.2 * min(widths(blurred, stem))


def test_refocusing_finds_a_point_where_it_is(example, tmp_path):
    side, bins, width = 0.6, 512, 16e-12
    place = np.linspace(-side / 2, side / 2, 32)
    row, column, depth = 9, 24, example.DEPTHS[6]
    way = np.sqrt(
        (place[:, np.newaxis] - place[row]) ** 2
        + (place - place[column]) ** 2
        + depth**2
    )
    arrival = np.round(2 * way / speed_of_light / width - 0.5).astype(int)
    counts = np.zeros((32, 32, bins), dtype=int)
    np.put_along_axis(counts, arrival[..., np.newaxis], 1000, axis=-1)
    path = tmp_path / "point.npz"
    np.savez_compressed(path, counts=counts, bin_width_s=width)
    cube = read_transients(path, example.BAND, scan_side=side)
    volume = example.refocus(cube, np.ones(len(example.BAND), dtype=complex))
    peak = np.unravel_index(volume.argmax(), volume.shape)
    assert peak[1:] == (row, column)
    # One step of the depths, which are 1 cm apart; a bin is 2.4 mm.
    assert_allclose(example.DEPTHS[peak[0]], depth, atol=0.011)


# The example and the how-to


@pytest.mark.slow
def test_the_how_to_runs_as_it_is_printed(tmp_path, monkeypatch, capsys):
    text = (EXAMPLES.parent / "docs" / "how-to" / "import-transients.md").read_text()
    text = re.sub(r" \\\n +", " ", text)
    for path in DATA.glob("*.npz"):
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    # Bins over a period of 100 ns, for the command with a dead time.
    counts = np.random.default_rng(1).poisson(2.0, (2, 3, 200))
    counter = {"bin_width_s": 5e-10, "cycles": 1000, "dead_time_s": 45e-9}
    np.savez("scan.npz", counts=counts, **counter)
    pulse = np.exp(-0.5 * ((np.arange(200) - 10) / 3) ** 2)
    counts = np.random.default_rng(2).poisson(0.02 + np.roll(pulse, 60), (2, 3, 200))
    np.savez("photons.npz", counts=counts, bin_width_s=5e-10, reference_counts=pulse)
    code = {"code": [0, 1, 1, 0, 1, 0, 0], "chip_s": 4e-9, "noise_v": 0.1}
    waveform = np.repeat(np.roll(code["code"], 2), 8)[None, None]
    np.savez(
        "coded.npz", waveform=waveform, sample_interval_s=5e-10, periodic=1, **code
    )
    commands = re.findall(r"^\$ amulor (.+)$", text, flags=re.MULTILINE)
    assert len(commands) == 9
    for command in commands:
        assert main(command.split()) == 0, command
    cubes.check(read_cube(tmp_path / "far-image.nc"), "range_image")
    # An imported cube survives its file: same signals, still the same schema.
    stored = read_cube(tmp_path / "near.nc")
    cubes.check(stored, "samples")
    direct = read_transients(DATA / "letter_u_54_78.npz", 100e6, scene=0)
    assert_array_equal(stored["in_phase"], direct["in_phase"])
    assert stored.attrs["license"] == direct.attrs["license"]
    capsys.readouterr()
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(block, {})
        for line in capsys.readouterr().out.splitlines():
            assert f"prints `{line}`" in text


def test_the_example_draws_its_figures(printed):
    (folder,) = re.findall(r"Figures are in (.+)", printed)
    for name in ("slab-response.png", "range-difference.png", "letters.png"):
        content = (Path(folder) / name).read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) > 20_000


def test_the_printed_differences_are_the_published_ones(printed):
    rows = re.findall(
        r"(\d+) MHz +([\d.]+) \+- ([\d.]+) cm +([\d.]+) \+- ([\d.]+) cm", printed
    )
    megahertz, raw, raw_error, clean, clean_error = np.array(rows, dtype=float).T
    raw, clean = raw / (100 * LABELS), clean / (100 * LABELS)
    assert_allclose(raw[np.isin(megahertz, [50, 100])], [0.80, 0.84], atol=0.0054)
    assert_allclose(clean[np.isin(megahertz, [50, 100])], 1.02, atol=0.0054)
    # Without the foam the phase tells the same distance at all frequencies; with it,
    # the low ones are short by a fifth.
    assert np.ptp(clean) < 0.05
    assert raw.min() < 0.8
    # The phase of N photons is known to 1 / sqrt(2 N) at best, here of 4.9e6 and
    # 3.8e6; less what the printing to 0.1 mm rounds off.
    least = np.hypot(1 / np.sqrt(2 * 4.9e6), 1 / np.sqrt(2 * 3.8e6))
    least = 100 * least * speed_of_light / (4 * np.pi * 1e6 * megahertz)
    assert np.all(raw_error >= np.minimum(least, 0.01) - 0.005)
    assert np.all(clean_error >= raw_error)
