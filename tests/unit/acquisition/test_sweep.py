"""Rows without a stop, by a lock-in and a scanner that do exactly as they are told."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.plan import SCAN, Key, Step
from amulor.acquisition.protocols import Overload, Recorded
from amulor.acquisition.settings import Procedure
from amulor.acquisition.sweep import SweepReader, _Motion, _Row, pitch_of
from amulor.errors import InstrumentError, SurveyError
from amulor.survey import Survey

CONTINUOUS = {"mode": "continuous", "output_filter": "known", "readings": "buffer"}
PITCH, DWELL, RUN_UP, CONSTANT, INTERVAL = 0.02, 0.05, 0.01, 0.01, 1e-3


class Stream:
    """A lock-in that streams 1 + 2j, and its time by its own clock [V]."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock, self.states = clock, []
        self.asked: list[float] = []
        self._sent = 0

    def begin_stream(self, duration: float) -> None:
        self.asked.append(duration)
        self._begun = self._clock.now()

    def fetch(self) -> Recorded:
        self._clock.sleep(1e-4)
        end = int((self._clock.now() - self._begun) / INTERVAL + 1e-6)
        number = np.arange(self._sent, end)
        self._sent = max(end, self._sent)
        times = self._begun + number * INTERVAL
        self.states.append(self._clock.now())
        return Recorded(
            times=times,
            signals=np.stack([0 * times + (1 + 2j), times + 0j], axis=1),
            mean=0.25,
            modulation_frequencies=(20e6, 39e6),
        )


class Scanner:
    """A scanner that moves evenly from where it stands."""

    def __init__(self, clock: VirtualClock, place: float, faster: float = 1.0) -> None:
        self._clock, self._place, self._rate, self._since = clock, place, 0.0, 0.0
        self._faster, self.asked = faster, []

    def begin_sweep(self, azimuth: float, elevation: float, *, duration: float) -> None:
        self.asked.append((azimuth, elevation, duration))
        self._since = self._clock.now()
        self._rate = self._faster * (azimuth - self._place) / duration

    def where(self) -> tuple[float, float]:
        self._clock.sleep(1e-4)
        passed = self._clock.now() - 0.5e-4 - self._since
        return self._place + self._rate * passed, 0.3


@pytest.fixture
def rows(small: Survey) -> Survey:
    """Return five columns 20 mrad apart, a dwell of 50 ms, a filter of 10 ms."""
    return small.with_({"scan.azimuth_span": 4 * PITCH})


def steps(columns: range | list[int] = range(5), *, row: int = 2) -> list[Step]:
    return [
        Step(Key(SCAN, row, k, 20e6, "VV", 0), PITCH * k - 0.04, 0.25) for k in columns
    ]


def reader_of(rows: Survey, clock: VirtualClock, **more: object):
    lock_in = Stream(clock)
    scanner = Scanner(clock, **more) if more else SimpleNamespace(
        begin_sweep=None, where=None
    )  # fmt: skip
    procedure = Procedure.model_validate(CONTINUOUS)
    return SweepReader(rows, procedure, lock_in, scanner, clock), lock_in, scanner


def test_a_motion_begins_and_ends_half_a_column_and_a_run_up_away(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    margin = PITCH * (0.5 + RUN_UP / DWELL)
    assert reader.start_of(steps()) == pytest.approx(-0.04 - margin)
    assert reader._ends(steps())[1] == pytest.approx(0.04 + margin)
    backwards = steps(range(4, -1, -1))
    assert reader.start_of(backwards) == pytest.approx(0.04 + margin)
    assert reader._ends(backwards)[1] == pytest.approx(-0.04 - margin)
    longer = Procedure.model_validate({**CONTINUOUS, "run_up": "25 ms"})
    reader = SweepReader(rows, longer, Stream(clock), Scanner(clock, 0.0), clock)
    assert reader.start_of(steps()) == pytest.approx(-0.04 - PITCH)


@pytest.mark.parametrize("columns", [range(5), range(4, -1, -1), range(1, 4)])
def test_pixels_of_a_row_have_their_own_part_of_the_record(rows, columns) -> None:
    clock = VirtualClock()
    clock.sleep(7.0)
    way = steps(columns)
    ahead = math.copysign(PITCH * 0.7, way[-1].azimuth - way[0].azimuth)
    reader, lock_in, scanner = reader_of(rows, clock, place=way[0].azimuth - ahead)
    watched: list[float] = []
    found = reader.take(way, timeout=2.0, watch=lambda: watched.append(clock.now()))
    duration = len(way) * DWELL + 2 * RUN_UP
    assert lock_in.asked == pytest.approx([duration + 2.0])
    ((azimuth, elevation, lasts),) = scanner.asked
    assert (azimuth, elevation) == (pytest.approx(way[-1].azimuth + ahead), 0.25)
    assert lasts == pytest.approx(duration)
    assert len(watched) == len(lock_in.states) - 1
    begun = 7.0 + 1e-4
    for number, (pixel, step) in enumerate(zip(found, way, strict=True)):
        begin = begun + RUN_UP + number * DWELL
        # To the nearest point of the record.
        assert pixel.begin == pytest.approx(begin, abs=0.51 * INTERVAL)
        assert pixel.azimuth == pytest.approx(step.azimuth, abs=0.02 * PITCH)
        assert pixel.elevation == pytest.approx(0.3)
        assert pixel.off < 1e-6
        dwell = pixel.dwell
        assert dwell.begin == pixel.begin
        assert dwell.duration == pytest.approx(DWELL)
        assert dwell.readings == 50
        assert dwell.interval == pytest.approx(INTERVAL)
        assert dwell.spreads == [None, None]
        assert dwell.modulation_frequencies == [20e6, 39e6]
        assert set(dwell.means) == {0.25}
        assert not dwell.overload
        assert not dwell.unlocked
        # A filter of 10 ms is 10 ms late; the interval of a reading is half of it.
        late = INTERVAL / -math.expm1(-INTERVAL / CONSTANT)
        middle = dwell.begin + (DWELL - INTERVAL) / 2
        assert_allclose(dwell.signals, [1 + 2j, middle + late])
        # Inputs of a rising signal differ by two intervals from one to the after next.
        weight = INTERVAL / (2 * CONSTANT) / math.sqrt(30) / 50
        assert dwell.edges[0] == pytest.approx(0, abs=1e-12)
        assert dwell.edges[1] == pytest.approx(weight * math.sqrt(48) * 2 * INTERVAL)
    # It looks at once, eight times in the motion from the first border on, and at the
    # last border until the points have come.
    first, end, gap = begun + RUN_UP, begun + RUN_UP + len(way) * DWELL, duration / 8
    looks = [begun, *np.arange(first, end, gap), end, end + 0.05 * DWELL]
    assert_allclose(lock_in.states[1:], looks, rtol=0, atol=0.5e-3)


def test_a_scanner_that_stands_still_ends_the_row(rows) -> None:
    clock = VirtualClock()
    reader, _, _ = reader_of(rows, clock, place=-0.2)
    with pytest.raises(InstrumentError) as caught:
        reader.take(steps(), timeout=0.5, watch=lambda: None)
    assert str(caught.value) == (
        "the scanner moves by 0.9407 rad/s along row 2 and was asked for 0.4; take a "
        "longer dwell, or a longer procedure.run_up"
    )
    clock = VirtualClock()
    reader, _, _ = reader_of(rows, clock, place=-0.054, faster=1e-9)
    with pytest.raises(InstrumentError) as caught:
        reader.take(steps(), timeout=0.5, watch=lambda: None)
    text = "the scanner has not come along row 2 within 0.77 s; see what holds it"
    assert str(caught.value) == text
    assert clock.now() == pytest.approx(0.77, abs=0.01)


def row_of(azimuth: list[float], *, located: list[float] | None = None) -> _Row:
    times = [0.01 * k + 3 for k in range(len(azimuth))] if located is None else located
    return _Row(located=times, azimuth=azimuth, elevation=[0.0] * len(azimuth))


def test_the_motion_is_fitted_to_three_readings_near_the_row(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    # 0.4 rad/s is one column in a dwell; the first and the last are out of the row.
    way = [-0.0521 - 0.004, *[-0.05 + 0.004 * k for k in range(4)], 0.06]
    motion = reader._motion(row_of(way), steps())
    assert motion is not None
    assert motion.rate == pytest.approx(0.4)
    assert motion.at(3.01) == pytest.approx(-0.05)
    assert motion.when(-0.046) == pytest.approx(3.02)
    assert_allclose(motion.off, 0, atol=1e-9)
    assert reader._motion(row_of(way[:3]), steps()) is None
    # Readings may be half of a column and of a run-up before the first pixel.
    near = 0.5 * PITCH * 1.2
    for place, count in ((-0.04 - near + 1e-6, 3), (-0.04 - near - 1e-6, 2)):
        some = row_of([place, place + 0.004, place + 0.008])
        assert (reader._motion(some, steps()) is not None) == (count == 3)
    end = 0.04 + near
    for place, count in ((end - 1e-6, 3), (end + 1e-6, 2)):
        some = row_of([place - 0.008, place - 0.004, place])
        assert (reader._motion(some, steps()) is not None) == (count == 3)
    back = reader._motion(row_of([0.02, 0.016, 0.012]), steps(range(4, -1, -1)))
    assert back is not None
    assert back.rate == pytest.approx(-0.4)


@pytest.mark.parametrize(
    ("rate", "good"),
    [(0.321, True), (0.479, True), (0.319, False), (0.481, False), (-0.4, False)],
)
def test_the_rate_may_be_off_by_a_fifth(rows, clock, rate, good) -> None:
    reader, _, _ = reader_of(rows, clock)
    row = row_of([0.01 * rate * k for k in range(4)])
    if good:
        assert reader._motion(row, steps()).rate == pytest.approx(rate)
        return
    with pytest.raises(InstrumentError) as caught:
        reader._motion(row, steps())
    assert str(caught.value) == (
        f"the scanner moves by {rate:.4g} rad/s along row 2 and was asked for 0.4; "
        "take a longer dwell, or a longer procedure.run_up"
    )


def test_departures_from_the_motion_are_those_near_a_pixel(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    line = [-0.03 + 0.004 * k for k in range(11)]
    bent = [*line]
    bent[5] += 1e-3
    motion = reader._motion(row_of(bent), steps())
    assert motion is not None
    # A line through eleven points takes a part of one that is off.
    assert motion.off[5] == pytest.approx(1e-3 * 10 / 11)
    assert motion.off[0] == pytest.approx(1e-3 / 11)
    row = row_of([0.0] * 4, located=[3.01, 3.09, 3.21, 3.3])
    row.fetched, row.states = [3.0, 3.2], [_state(), _state()]
    row.times = [2.9 + INTERVAL * np.arange(500)]
    row.signals = [np.ones((500, 1), dtype=complex)]
    steady = _Motion(-1.2 - 0.04, 0.4, np.array([1.0, 2.0, 4.0, 3.0]))
    # The pixel at -0.04 is passed at 3 s, the others 50 ms apart; readings count for
    # pixels within a dwell.
    pixels = reader._pixels(row, steps(range(5)), steady)
    assert [pixel.off for pixel in pixels] == [1.0, 2.0, 2.0, 0.0, 4.0]
    assert pixels[0].begin == pytest.approx(2.975)


def _state(**more: object) -> Recorded:
    known = {"mean": math.nan, "modulation_frequencies": (39e6,)}
    return Recorded(times=np.zeros(0), signals=np.zeros((0, 1)), **{**known, **more})


def test_a_record_must_reach_over_the_row(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    motion = _Motion(-1.2 - 0.04, 0.4, np.zeros(1))
    row = row_of([0.0], located=[3.0])
    row.fetched, row.states = [3.0], [_state()]
    # Pixels from 2.975 to 3.225 s; a point more is needed at the end.
    for first, count, column in (
        (2.975, 251, None), (2.976, 260, 0), (2.975, 250, 4), (2.9, 200, 2)
    ):  # fmt: skip
        row.times = [first + INTERVAL * np.arange(count)]
        row.signals = [np.ones((count, 1), dtype=complex)]
        if column is None:
            assert len(reader._pixels(row, steps(), motion)) == 5
            continue
        with pytest.raises(InstrumentError) as caught:
            reader._pixels(row, steps(), motion)
        assert str(caught.value) == (
            f"the record does not reach over column {column} of row 2: the scanner was "
            "there before the lock-in; take a longer procedure.run_up"
        )


def test_a_gap_of_a_quarter_of_a_dwell_is_refused(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    even = 4 + INTERVAL * np.arange(101)
    for gap, good in ((0.24 * DWELL, True), (0.26 * DWELL, False)):
        times = even.copy()
        times[80:] += gap
        if good:
            found, interval = reader._even(times)
            assert interval == pytest.approx(INTERVAL)
            # Most of the readings are before the gap.
            assert_allclose(found, even)
            continue
        with pytest.raises(InstrumentError) as caught:
            reader._even(times)
        assert str(caught.value) == (
            "the lock-in has not recorded without a gap while the beam moved; take "
            'procedure.mode = "continuous" out of the devices file'
        )


def test_states_of_a_pixel_are_those_that_cover_its_time(rows, clock) -> None:
    reader, _, _ = reader_of(rows, clock)
    row = _Row(
        fetched=[1.0, 2.0, 3.0, 4.0],
        states=[
            _state(mean=1.0, overload=Overload.INPUT, unlocked=True),
            _state(mean=2.0, overload=Overload.OUTPUT),
            _state(mean=3.0, overload=Overload.RESERVE),
            _state(mean=5.0, unlocked=True, overload=Overload.MEAN),
        ],
    )
    signals = np.ones((3, 1), dtype=complex)

    def dwell(begin: float, end: float):
        times = np.linspace(begin, end, 3)
        return reader._dwell_of(row, times, signals, 0.5)

    # Bits of 2.0 cover the time since 1.0; those of 3.0 the end.
    inside = dwell(1.5, 2.5)
    assert inside.overload == Overload.OUTPUT | Overload.RESERVE
    assert not inside.unlocked
    assert inside.means == [2.0]
    assert dwell(1.0, 2.0).overload == (
        Overload.INPUT | Overload.OUTPUT | Overload.RESERVE
    )
    assert dwell(1.0, 2.0).unlocked
    # Mean outputs within 0.3 of a dwell of both borders.
    near = 0.3 * DWELL
    assert dwell(1 + 0.99 * near, 2 - 0.99 * near).means == [1.0, 2.0]
    # Without any, that in the middle.
    assert dwell(1 + 1.01 * near, 2 - 1.01 * near).means == pytest.approx([1.5])
    assert dwell(3.2, 3.6).means == pytest.approx([3.8])
    row.states[1] = _state()
    assert dwell(1.9, 2.1).means == []
    assert inside.begin == 1.5
    assert inside.duration == 1.0
    assert inside.readings == 2


def test_the_newest_point_is_the_largest_last_time() -> None:
    assert _Row().last_point() == -1e99
    row = _Row(times=[np.array([1.0, 2.0]), np.zeros(0), np.array([2.5, 3.0])])
    assert row.last_point() == 3.0


def test_a_row_needs_two_columns_apart(rows) -> None:
    assert pitch_of(rows) == pytest.approx(PITCH)
    two = rows.with_({"scan.columns": 2})
    assert pitch_of(two) == pytest.approx(4 * PITCH)
    for changes, columns, span in (
        ({"scan.columns": 1}, 1, 0.08), ({"scan.azimuth_span": 0.0}, 5, 0.0)
    ):  # fmt: skip
        with pytest.raises(SurveyError) as caught:
            pitch_of(rows.with_(changes))
        assert str(caught.value) == (
            f"scan.columns = {columns} and scan.azimuth_span = {span:g} rad leave no "
            "way to move along a row; plan more columns, or take procedure.mode = "
            '"continuous" out of the devices file'
        )


def test_what_cannot_stream_or_sweep_is_refused(rows, clock) -> None:
    procedure = Procedure.model_validate(CONTINUOUS)
    bare = SimpleNamespace(identity=lambda: "a device")
    for lock_in, scanner, lacks in (
        (bare, Scanner(clock, 0.0), "begin_stream, fetch"),
        (Stream(clock), bare, "begin_sweep, where"),
    ):
        with pytest.raises(InstrumentError) as caught:
            SweepReader(rows, procedure, lock_in, scanner, clock)
        assert str(caught.value) == (
            f'a device has no {lacks}; take procedure.mode = "continuous" out of the '
            "devices file"
        )
