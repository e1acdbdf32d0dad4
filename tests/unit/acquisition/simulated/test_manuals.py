"""Numbers of the makers' manuals: both ends of each range, codes, units, status bits.

The light is a constant, so that each answer follows from the manual alone.
"""

from __future__ import annotations

import math
import struct

import pytest
from shared_light import scene_light

from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.simulated.pelco_head import SimulatedPelcoHead
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import SimulatedSr844

#: Highest code of each setting, counted from 0 (SR844, chapter 4).
SR844 = {
    "OUTX": 1, "FMOD": 1, "HARM": 1, "INPZ": 1, "REFZ": 1, "RMOD": 2, "WRSV": 2,
    "CRSV": 2, "OFSL": 4, "SENS": 14, "OFLT": 17,
}  # fmt: skip
#: The same of an SR865A (pages 104 to 120); harmonics are counted from 1.
SR865A = {
    "TBMODE": 1, "TBSTAT": 1, "REFM": 1, "RSRC": 3, "RTRG": 2, "REFZ": 1, "HARM": 99,
    "HARMDUAL": 99, "IVMD": 1, "ISRC": 1, "ICPL": 1, "IGND": 1, "IRNG": 4, "ICUR": 1,
    "SCAL": 27, "OFLT": 21, "OFSL": 3, "SYNC": 1, "ADVFILT": 1, "DBLK": 1, "*PSC": 1,
}  # fmt: skip
#: Settings with a unit: lowest and highest value, value after *RST.
NUMBERS = {
    "PHAS": (-360000.0, 360000.0, 0.0), "SLVL": (1e-9, 2.0, 1e-9),
    "SOFF": (-5.0, 5.0, 0.0), "BLADESLOTS": (0.0, 1.0, 0.0),
}  # fmt: skip
#: Steps of 1 and 3, as the dials have them.
ONE_THREE = [digit * 10.0**power for power in range(-7, 5) for digit in (1, 3)]


@pytest.fixture
def bench(small, settings, clock, monkeypatch):
    """Return a bench whose light gives X = 0.3 V and Y = 0.4 V, and 0.25 V on average.

    A delayed echo has a positive phase, which a lock-in shows as a negative one.
    """
    made = simulated_bench(small, settings, scene=scene_light, clock=clock)
    signal = math.sqrt(2) * complex(0.3, -0.4)
    monkeypatch.setattr(made, "output", lambda: (signal, 0.25))
    return made


def number(device, question):
    (answer,) = device.answer(question)
    return float(answer)


def error(device):
    (answer,) = device.answer("*ESR?")
    return int(answer)


@pytest.mark.parametrize(
    ("model", "word", "last"),
    [(SimulatedSr844, *pair) for pair in SR844.items()]
    + [(SimulatedSr865a, *pair) for pair in SR865A.items()],
)
def test_a_setting_has_the_codes_of_the_manual(bench, model, word, last) -> None:
    device = model(bench)
    first = int(last == 99)
    assert device.answer(f"{word}?") == [str(first)]
    device.answer(f"{word} {last}")
    assert device.answer(f"{word}?") == [str(last)]
    assert error(device) == 0
    for beyond in (first - 1, last + 1):
        device.answer(f"{word} {beyond}")
        assert error(device) == 16
    assert device.answer(f"{word}?") == [str(last)]
    device.answer("*RST")
    assert device.answer(f"{word}?") == [str(first)]


@pytest.mark.parametrize("word", NUMBERS)
def test_a_number_of_an_sr865a_has_the_range_of_the_manual(bench, word) -> None:
    device, (low, high, start) = SimulatedSr865a(bench), NUMBERS[word]
    assert number(device, f"{word}?") == start
    for value in (low, high):
        device.answer(f"{word} {value!r}")
        assert number(device, f"{word}?") == pytest.approx(value, rel=1e-9)
    step = 1e-3 * (high - low)
    for beyond in (low - step, high + step, math.nan):
        device.answer(f"{word} {beyond!r}")
        assert error(device) == 16
    assert number(device, f"{word}?") == pytest.approx(high, rel=1e-9)


def test_the_presets_of_an_sr865a_are_four(bench) -> None:
    device = SimulatedSr865a(bench)
    ranges = {"PSTF": (1e-3, 4e6, 1e5), "PSTA": (1e-9, 2.0, 0.1), "PSTL": (-5, 5, 0.0)}
    for word, (low, high, start) in ranges.items():
        for place in range(4):
            assert number(device, f"{word}? {place}") == start
            device.answer(f"{word} {place},{high}")
        device.answer(f"{word} 2,{low}")
        shown = [number(device, f"{word}? {place}") for place in range(4)]
        assert shown == pytest.approx([high, high, low, high], rel=1e-9)
        assert error(device) == 0
        device.answer(f"{word} 4,{high}")
        assert error(device) == 16


@pytest.mark.parametrize(
    ("model", "shortest", "count"),
    [(SimulatedSr844, 1e-4, 18), (SimulatedSr865a, 1e-6, 22)],
)
def test_time_constants_rise_in_steps_of_one_and_three(
    bench, model, shortest, count
) -> None:
    device = model(bench)
    first = ONE_THREE.index(pytest.approx(shortest))
    for code in range(count):
        device.answer(f"OFLT {code}")
        expected = ONE_THREE[first + code]
        assert bench.time_constant == pytest.approx(expected, rel=1e-12)
        if model is SimulatedSr865a:
            for slope, share in enumerate((1 / 4, 1 / 8, 3 / 32, 5 / 64)):
                device.answer(f"OFSL {slope}")
                assert number(device, "ENBW?") == pytest.approx(share / expected)


def test_the_values_of_an_sr844_are_those_of_its_list(bench) -> None:
    device = SimulatedSr844(bench)
    device.answer("SENS 14;FREQ 39E6")
    # X, Y, R [V], R [dBm] in 50 ohm, theta [deg].
    power = 10 * math.log10(0.25 / 50 / 1e-3)
    listed = [0.3, 0.4, 0.5, power, math.degrees(math.atan2(4, 3))]
    for code, value in enumerate(listed, start=1):
        assert number(device, f"OUTP? {code}") == pytest.approx(value, rel=1e-6)
    shown = [float(x) for x in device.answer("SNAP? 1,2,6,8,9,10")[0].split(",")]
    assert shown == pytest.approx([0.3, 0.4, 0.25, 39e6, 0.3, 0.4], rel=1e-6)
    # Inputs: mean light at 1, the interlock at 2.
    assert number(device, "AUXI? 1") == pytest.approx(0.25)
    device.answer("PHAS 53.13010235")
    assert number(device, "OUTP? 1") == pytest.approx(0.5, rel=1e-6)
    assert number(device, "OUTP? 2") == pytest.approx(0, abs=1e-6)
    for text, status in (("360", 0), ("-360", 0), ("360.1", 16), ("-360.1", 16)):
        device.answer(f"PHAS {text}")
        assert error(device) == status
    for count, status in ((1, 16), (2, 0), (6, 0), (7, 16)):
        device.answer("SNAP? " + ",".join(["1"] * count))
        assert error(device) == status


def test_outputs_of_an_sr844_end_at_full_scale(bench) -> None:
    device = SimulatedSr844(bench)
    for code in range(15):
        device.answer(f"SENS {code}")
        scale = ONE_THREE[code]
        assert number(device, "OUTP? 3") == pytest.approx(min(0.5, scale), rel=1e-6)
        # Bits: filter 64, X 256 and Y 512 beyond full scale.
        beyond = 64 * (scale < 0.5) + 256 * (scale < 0.3) + 512 * (scale < 0.4)
        shown = int(device.answer("LIAS?")[0])
        assert (shown & 0x3C0) & ~128 == beyond, code


def test_the_values_of_an_sr865a_are_those_of_its_list(bench) -> None:
    device = SimulatedSr865a(bench)
    device.answer("FREQ 1E6;AUXV 0,1.5;AUXV 1,-2.5;SLVL 0.7;SOFF 0.2")
    theta = math.degrees(math.atan2(4, 3))
    listed = {
        0: 0.3, 1: 0.4, 2: 0.5, 3: theta, 4: 0.25, 6: 0.0, 7: 0.0, 10: 1.5, 11: -2.5,
        12: 0.0, 13: 0.7, 14: 0.2, 15: 1e6, 16: 0.0,
    }  # fmt: skip
    for code, value in listed.items():
        assert number(device, f"OUTP? {code}") == pytest.approx(value, rel=1e-6)
    words = ["X", "Y", "R", "TH", "IN1", "OUT1", "OUT2", "SAM", "LEV", "FI", "FE"]
    values = [0.3, 0.4, 0.5, theta, 0.25, 1.5, -2.5, 0.7, 0.2, 1e6, 0.0]
    for word, value in zip(words, values, strict=True):
        assert number(device, f"OUTP? {word}") == pytest.approx(value, rel=1e-6)
    # X and Y noise: that of the filter in its bandwidth.
    device.answer("OFLT 10;OFSL 1")
    noise = bench.noise / math.sqrt(2 * (1 / 8) / 0.1)
    assert number(device, "OUTP? 8") == pytest.approx(noise, rel=1e-6)
    # Channels show X, Y, R and theta until they are told otherwise.
    (shown,) = device.answer("SNAPD?")
    assert [float(x) for x in shown.split(",")] == pytest.approx([0.3, 0.4, 0.5, theta])
    device.answer("CDSP 3,FInt")
    assert device.answer("CDSP? 3") == ["15"]
    assert number(device, "OUTR? 3") == pytest.approx(1e6)
    device.answer("CDSP 3,17")
    assert error(device) == 16
    device.answer("PHAS 53.13010235")
    assert number(device, "OUTP? X") == pytest.approx(0.5, rel=1e-6)
    assert number(device, "OUTP? PHA") == pytest.approx(53.13010235)
    for count, status in ((1, 16), (2, 0), (3, 0), (4, 16)):
        device.answer("SNAP? " + ",".join(["X"] * count))
        assert error(device) == status


def test_scales_and_ranges_of_an_sr865a_are_exceeded_beyond_their_value(
    bench, monkeypatch
) -> None:
    device = SimulatedSr865a(bench)
    scales = [d * 10.0**-p for p in range(10) for d in (1, 0.5, 0.2)][:28]
    ranges = [1.0, 0.3, 0.1, 0.03, 0.01]
    for word, codes, factor, bit in (
        ("SCAL", scales, 1.0, 1), ("IRNG", ranges, math.sqrt(2), 16)
    ):  # fmt: skip
        device.answer("*RST")
        for code, full in enumerate(codes):
            device.answer(f"{word} {code}")
            for share in (0.99, 1.01):
                signal = share * full / factor * math.sqrt(2) + 0j
                monkeypatch.setattr(bench, "output", lambda value=signal: (value, 0.0))
                shown = int(device.answer("CUROVLDSTAT?")[0])
                assert bool(shown & bit) == (share > 1), (word, code)
    # Levels of the input: four quarters of its range; 4 is an overload.
    device.answer("*RST;IRNG 1")
    for share, level in ((0.24, 0), (0.26, 1), (0.51, 2), (0.76, 3), (1.01, 4)):
        value = 0.3 * share + 0j
        monkeypatch.setattr(bench, "output", lambda value=value: (value, 0.0))
        assert device.answer("ILVL?") == [str(level)]


@pytest.mark.parametrize(
    ("model", "word", "outputs"),
    [(SimulatedSr844, "AUXO", (1, 2)), (SimulatedSr865a, "AUXV", (0, 1, 2, 3))],
)
def test_auxiliary_outputs_go_to_10_5_volt_either_way(
    bench, model, word, outputs
) -> None:
    device = model(bench)
    for place in outputs:
        for voltage in (10.5, -10.5):
            device.answer(f"{word} {place},{voltage}")
            assert number(device, f"{word}? {place}") == voltage
        for beyond in (10.51, -10.51, math.nan):
            device.answer(f"{word} {place},{beyond}")
            assert error(device) == 16
    for place in (outputs[0] - 1, outputs[-1] + 1):
        device.answer(f"{word} {place},0")
        assert error(device) == 16
    # The laser: on above 2 V at the first output.
    for voltage, on in ((1.99, False), (2.01, True), (-5, False)):
        device.answer(f"{word} {outputs[0]},{voltage}")
        assert bench.laser_on == on


@pytest.mark.parametrize(
    ("model", "unlocked", "enabled"),
    [(SimulatedSr844, 1, 16), (SimulatedSr865a, 8, 16)],
)
def test_registers_have_their_bits(bench, clock, model, unlocked, enabled) -> None:
    device = model(bench)
    device.answer("FREQ 1E6")
    assert int(device.answer("LIAS?")[0]) & unlocked
    clock.sleep(1.0)
    device.answer("LIAS?")
    assert not int(device.answer("LIAS?")[0]) & unlocked
    for word, count in (("*SRE", 8), ("*ESE", 8), ("ERRE", 8), ("LIAE", enabled)):
        device.answer(f"{word} {(1 << count) - 1}")
        assert number(device, f"{word}?") == (1 << count) - 1
        device.answer(f"{word} {1 << count}")
        assert error(device) == 16
        device.answer(f"{word} {count - 1},0")
        assert number(device, f"{word}?") == (1 << count - 1) - 1
        assert device.answer(f"{word}? {count - 2}") == ["1"]
        assert device.answer(f"{word}? {count - 1}") == ["0"]
        device.answer(f"{word} 0")
    # A status of the lock-in is bit 3 of the status byte, an event bit 5.
    device.answer(f"*CLS;LIAE {unlocked};FREQ 2E6")
    assert int(device.answer("*STB?")[0]) & (8 + 32 + 64) == 8
    device.answer("*SRE 8")
    assert int(device.answer("*STB?")[0]) & (8 + 32 + 64) == 8 + 64
    device.answer("*CLS;*SRE 0;*ESE 16;FREQ nan")
    assert int(device.answer("*STB?")[0]) & (32 + 64) == 32
    # Reading one bit clears that bit alone.
    device.answer("NONSENSE")
    assert device.answer("*ESR? 4") == ["1"]
    assert error(device) == 32


def test_the_capture_buffer_has_the_sizes_and_rates_of_the_manual(bench) -> None:
    device = SimulatedSr865a(bench)
    # Lengths in kilobytes, even ones from 2 to 4,096.
    for text, size in (("1", 2), ("2", 2), ("3", 4), ("255", 256), ("4096", 4096)):
        device.answer(f"CAPTURELEN {text}")
        assert number(device, "CAPTURELEN?") == size
    for beyond in ("0", "-1", "4097"):
        device.answer(f"CAPTURELEN {beyond}")
        assert error(device) == 16
    for code, word in enumerate(("X", "XY", "RT", "XYRT")):
        device.answer(f"CAPTURECFG {word}")
        assert device.answer("CAPTURECFG?") == [str(code)]
    device.answer("CAPTURECFG 4")
    assert error(device) == 16
    # 1.25 MHz at a time constant of 1 us; rates are halved up to 20 times.
    device.answer("OFLT 0")
    assert number(device, "CAPTURERATEMAX?") == 1.25e6
    for code in (0, 1, 20):
        device.answer(f"CAPTURERATE {code}")
        assert number(device, "CAPTURERATE?") == pytest.approx(1.25e6 / 2**code)
    device.answer("CAPTURERATE 21")
    assert error(device) == 16
    for code in range(22):
        device.answer(f"OFLT {code}")
        halved = math.log2(1.25e6 / number(device, "CAPTURERATEMAX?"))
        assert halved == pytest.approx(round(halved), abs=1e-6)
        # At least 16 points a time constant, of which a rate half as large has fewer.
        points = number(device, "CAPTURERATEMAX?") * 10 * ONE_THREE[code]
        assert halved == 0 or 16 <= points < 32


@pytest.mark.parametrize(("words", "width"), [("X", 4), ("XY", 8), ("XYRT", 16)])
def test_a_full_capture_has_its_bytes(small, settings, clock, words, width) -> None:
    made = simulated_bench(small, settings, scene=scene_light, clock=clock)
    device = SimulatedSr865a(made)
    device.answer("OFLT 8")
    device.answer(f"CAPTURELEN 2;CAPTURECFG {words}")
    device.answer("CAPTURESTART ONE,IMM")
    assert device.answer("CAPTURESTAT?") == ["3"]
    assert device.answer("CAPTUREGET? 0,2") == []
    assert error(device) == 16
    rate = number(device, "CAPTURERATE?")
    clock.sleep(1.5 * 2048 / width / rate)
    # Triggered and full.
    assert device.answer("CAPTURESTAT?") == ["6"]
    assert number(device, "CAPTUREBYTES?") == 2048
    assert number(device, "CAPTUREPROG?") == 2
    (block,) = device.answer("CAPTUREGET? 0,2")
    assert block[:6] == b"#42048"
    values = struct.unpack("<512f", block[6:])
    (first,) = device.answer("CAPTUREVAL? 0")
    assert [float(x) for x in first.split(",")] == pytest.approx(
        values[: width // 4], rel=1e-6
    )
    for text, status in (
        (f"{2048 // width - 1}", 0), (f"{2048 // width}", 16), ("-1", 16)
    ):  # fmt: skip
        device.answer(f"CAPTUREVAL? {text}")
        assert error(device) == status
    for text, status in (("0,64", 0), ("0,65", 16), ("0,0", 16), ("-1,1", 16)):
        device.answer(f"CAPTUREGET? {text}")
        assert error(device) == status


def test_a_controller_counts_in_the_units_of_its_axes(small, settings, clock) -> None:
    made = simulated_bench(small, settings, scene=scene_light, clock=clock)
    device = SimulatedPiController(made, settings)
    axes = [line.strip() for line in device.answer("SAI?")]
    assert len(axes) == 5
    ends = dict(line.strip().split("=") for line in device.answer("TMX?"))
    # Mounts turn by a whole turn either way; the target moves by a meter.
    mounts = settings.launch.axis, settings.analyser.axis
    assert [float(ends[axis]) for axis in mounts] == [360, 360]
    assert float(ends[settings.target.axis]) == 1000
    for axis in axes:
        device.answer(f"MOV {axis} 1.5")
        assert error_of(device) == 0
        clock.sleep(1000.0)
        device.answer(f"MVR {axis} -0.5")
        clock.sleep(1000.0)
        assert device.answer(f"MOV? {axis}") == [f"{axis}=1.0000000"]
        place = device.answer(f"POS? {axis}")[0].partition("=")[2]
        assert float(place) == pytest.approx(1, abs=1e-3)
        assert device.answer(f"ONT? {axis}") == [f"{axis}=1"]
        fastest = 2 * float(device.answer(f"VEL? {axis}")[0].partition("=")[2])
        for speed, code in ((fastest * 0.999, 0), (fastest * 1.001, 8), (0, 8)):
            device.answer(f"VEL {axis} {speed}")
            assert error_of(device) == code
    degree, millimetre = made.place("launch"), made.place("target")
    assert degree == pytest.approx(math.radians(1.0), rel=1e-3)
    assert millimetre == pytest.approx(1e-3, rel=1e-3)
    # Each bit of the answer to #5 is an axis that moves.
    device.answer(f"MOV {axes[0]} 2 {axes[2]} 2")
    assert device.answer("\x05") == ["5"]
    assert device.answer("\x18") == []
    assert device.answer("\x05") == ["0"]
    assert error_of(device) == 10
    device.answer(f"SVO {axes[1]} 0")
    device.answer(f"MOV {axes[1]} 2")
    assert error_of(device) == 5
    for line, code in (("MOV", 1), ("MOV 1", 1), ("MOV 9 1", 15), ("QQQ", 2)):
        device.answer(line)
        assert error_of(device) == code


def error_of(device):
    (answer,) = device.answer("ERR?")
    return int(answer)


def test_a_pelco_head_turns_by_hundredths_of_a_degree(small, settings, clock) -> None:
    made = simulated_bench(small, settings, scene=scene_light, clock=clock)
    head = SimulatedPelcoHead(made, number=3)

    def frame(command, value):
        body = [3, command >> 8, command & 255, value >> 8, value & 255]
        return bytes([255, *body, sum(body) % 256])

    def asked(command):
        (answer,) = head.answer(frame(command, 0))
        assert answer[0] == 255
        assert answer[1] == 3
        assert sum(answer[1:6]) % 256 == answer[6]
        return answer[3], answer[4] * 256 + answer[5]

    # Pan to 12.34 degrees, tilt to 5.67 degrees below level and 10 above.
    head.answer(frame(0x4B, 1234))
    clock.sleep(60.0)
    assert asked(0x51) == (0x59, 1234)
    assert made.place("azimuth") == pytest.approx(math.radians(12.34), abs=1e-5)
    for sent, shown, elevation in (
        (567, 567, -5.67), (35_000, 35_000, 10.0), (9_500, 9_000, -90.0),
        (26_500, 27_000, 90.0),
    ):  # fmt: skip
        (reply,) = head.answer(frame(0x4D, sent))
        assert reply[:3] == bytes([255, 3, 0])
        assert reply[3] == (3 + frame(0x4D, sent)[6]) % 256
        clock.sleep(60.0)
        assert asked(0x53) == (0x5B, shown)
        assert made.place("elevation") == pytest.approx(
            math.radians(elevation), abs=1e-5
        )
    # It turns by 30 degrees a second, and stops on demand.
    head.answer(frame(0x4B, 9_000))
    clock.sleep(1.0)
    assert asked(0x51)[1] == pytest.approx(1234 + 3000, abs=2)
    head.answer(frame(0, 0))
    clock.sleep(5.0)
    assert asked(0x51)[1] < 9_000
    assert head.answer(frame(0x7777, 0)) == []
    assert head.answer(bytes([255, 4, 0, 0x51, 0, 0, 0x55])) == []
    # Bytes before a frame, and frames with a wrong sum, are passed over.
    cutter, good = head.cutter(), frame(0x51, 0)
    broken = good[:6] + bytes([good[6] ^ 1])
    assert [*cutter.split(b"\x00\xff" + broken + good[:3])] == []
    assert [*cutter.split(good[3:] + good)] == [good, good]
