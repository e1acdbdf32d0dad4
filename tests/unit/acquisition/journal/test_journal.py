"""The journal keeps what it acknowledged, once, for one scan and one writer."""

from __future__ import annotations

import dataclasses
import os
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import DARK, SCAN, Key
from amulor.errors import FormatError, InstrumentError, SurveyError

META = {
    "survey_digest": "sha256:1111111111",
    "instrument_digest": "sha256:2222222222",
    "identities": "{}",
}
RECORD = Record(
    in_phase=1e-3, quadrature=-2e-3, mean=None, readings=8, full_scale=1.0, flags=0,
    commanded_azimuth=0.1, commanded_elevation=-0.1, azimuth=0.1000001,
    elevation=-0.1000001, modulation_frequency=39e6, elapsed=1.5, segment=1,
)  # fmt: skip


def key(number: int, kind: str = SCAN) -> Key:
    return Key(kind, number // 10, number % 10, 39e6, "VH", 0)


def test_what_is_committed_comes_back_bit_by_bit(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        journal.commit(key(1), RECORD)
        journal.commit(
            key(2, DARK), dataclasses.replace(RECORD, mean=0.1, in_phase=0.1 + 0.2)
        )
    with Journal.read(folder) as journal:
        assert journal.keys() == {key(1), key(2, DARK)}
        assert [*journal.samples(SCAN)] == [(key(1), RECORD)]
        (dark,) = journal.samples(DARK)
        assert dark[1].in_phase == 0.1 + 0.2
        assert journal.count() == 2
        assert journal.last_elapsed() == 1.5


def test_every_commit_is_synchronised_before_it_returns(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        read = journal._connection.execute
        assert read("PRAGMA journal_mode").fetchone() == ("wal",)
        assert read("PRAGMA synchronous").fetchone() == (2,)


@pytest.mark.parametrize("field", Key._fields)
def test_each_part_of_the_key_tells_samples_apart(folder: Path, field: str) -> None:
    other = {"kind": DARK, "frequency": 40e6, "polarization": "VV"}.get(field, 7)
    with Journal.create(folder, meta=META) as journal:
        journal.commit(key(1), RECORD)
        journal.commit(key(1)._replace(**{field: other}), RECORD)
        assert journal.count() == 2


def test_no_sample_is_written_twice(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        journal.commit(key(1), RECORD)
        with pytest.raises(FormatError, match="there already"):
            journal.commit(key(1), dataclasses.replace(RECORD, in_phase=9.0))
        assert [*journal.samples(SCAN)] == [(key(1), RECORD)]


def test_an_incomplete_sample_is_not_written(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        with pytest.raises(FormatError, match="in_phase is not a number; look at"):
            journal.commit(key(1), dataclasses.replace(RECORD, in_phase=float("nan")))
        assert journal.count() == 0


def test_a_second_scan_does_not_replace_the_first(folder: Path) -> None:
    Journal.create(folder, meta=META).close()
    with pytest.raises(FormatError, match="holds a scan already"):
        Journal.create(folder, meta=META)


def test_there_is_one_writer_at_a_time(folder: Path) -> None:
    first = Journal.create(folder, meta=META)
    with pytest.raises(FormatError, match="another program"):
        Journal.resume(folder, meta=META)
    first.close()
    Journal.resume(folder, meta=META).close()


def test_of_two_that_begin_at_once_one_is_refused(folder: Path) -> None:
    for number in range(5):
        place = folder / str(number)
        place.mkdir()
        begun: list[int] = []
        refused: list[str] = []
        start, tried = threading.Barrier(2), threading.Event()

        def begin(
            place=place, begun=begun, refused=refused, start=start, tried=tried
        ) -> None:
            start.wait()
            try:
                with Journal.create(place, meta=META) as journal:
                    # Kept until both have tried: who was let run when does not count.
                    tried.wait(60)
                    journal.commit(key(0), RECORD)
                    begun.append(journal.count())
            except FormatError as error:
                refused.append(str(error))
                tried.set()

        threads = [threading.Thread(target=begin) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert (begun, len(refused)) == ([1], 1)
        assert "written to by another program" in refused[0]
        with Journal.read(place) as journal:
            assert journal.keys() == {key(0)}


def test_a_journal_made_in_the_meantime_is_not_replaced(
    folder: Path, monkeypatch
) -> None:
    claimed = journal_file.claimed

    def late(place: Path) -> sqlite3.Connection:
        # Another program begins and ends a scan just before the claim is had.
        monkeypatch.setattr(journal_file, "claimed", claimed)
        with Journal.create(place, meta=META) as first:
            first.commit(key(1), RECORD)
        return claimed(place)

    monkeypatch.setattr(journal_file, "claimed", late)
    with pytest.raises(FormatError, match="holds a scan already"):
        Journal.create(folder, meta=META)
    with Journal.read(folder) as journal:
        assert journal.keys() == {key(1)}


def test_the_newest_samples_of_a_lost_journal_get_into_no_other(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        journal.commit(key(1), RECORD)
        log = (folder / f"{FILE_NAME}-wal").read_bytes()
    assert log
    (folder / FILE_NAME).unlink()
    (folder / f"{FILE_NAME}-wal").write_bytes(log)
    with pytest.raises(FormatError, match="put that back"):
        Journal.create(folder, meta=META)
    assert (folder / f"{FILE_NAME}-wal").read_bytes() == log


def test_names_are_synchronised_with_their_folders(folder: Path, monkeypatch) -> None:
    place = folder / "scan"
    place.mkdir()
    done: list[str] = []
    replace, fsync = os.replace, os.fsync

    def synchronised(handle: int) -> None:
        done.append(os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)

    def renamed(old: Path, new: Path) -> None:
        done.append("renamed")
        replace(old, new)

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("what a file handle stands for cannot be asked here")
    monkeypatch.setattr(os, "fsync", synchronised)
    monkeypatch.setattr(os, "replace", renamed)
    Journal.create(place, meta=META).close()
    real = place.resolve()
    # The new name in the folder, and the folder in the one above.
    assert done == ["renamed", str(real), str(real.parent)]


def test_resuming_needs_a_scan(folder: Path) -> None:
    with pytest.raises(FormatError, match="leave out --resume"):
        Journal.resume(folder, meta=META)
    with pytest.raises(FormatError, match="holds no journal"):
        Journal.read(folder)


@pytest.mark.parametrize(
    ("name", "error"),
    [("survey_digest", SurveyError), ("instrument_digest", InstrumentError)],
)
def test_another_survey_or_instrument_is_refused(folder, name, error) -> None:
    Journal.create(folder, meta=META).close()
    with pytest.raises(error, match="another"):
        Journal.resume(folder, meta={**META, name: "sha256:3333333333"})
    # The refusal holds no lock.
    Journal.resume(folder, meta=META).close()


def test_which_device_is_another_one_is_told(folder: Path) -> None:
    before = {**META, "identities": '{"laser": "A", "lock_in": "SR844 s/n 1"}'}
    now = {**META, "identities": '{"laser": "A", "lock_in": "SR844 s/n 2"}'}
    Journal.create(folder, meta=before).close()
    with pytest.raises(InstrumentError) as caught:
        Journal.resume(folder, meta={**now, "instrument_digest": "sha256:3333333333"})
    assert "lock_in was SR844 s/n 1, is SR844 s/n 2;" in str(caught.value)
    assert "laser" not in str(caught.value)


def test_another_schema_is_refused(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        journal.note("journal_schema", "99")
    for opened in (Journal.read, lambda place: Journal.resume(place, meta=META)):
        with pytest.raises(FormatError, match="schema '99'"):
            opened(folder)


def test_a_damaged_journal_is_told(folder: Path) -> None:
    Journal.create(folder, meta=META).close()
    (folder / FILE_NAME).write_bytes(b"something else entirely" * 1000)
    with pytest.raises(FormatError, match=r"not a database; it is damaged, take a"):
        Journal.read(folder)


def test_segments_know_how_they_ended(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        first = journal.begin_segment()
        journal.end_segment(first, "paused")
        journal.begin_segment()  # and then the power goes
    with Journal.resume(folder, meta=META) as journal:
        third = journal.begin_segment()
        reasons = [part["reason"] for part in journal.segments()]
        assert reasons == ["paused", "broken off without notice", None]
        assert third == 3


def test_a_full_journal_says_so_and_keeps_what_it_has(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        pages = journal._connection.execute("PRAGMA page_count").fetchone()[0]
        journal._connection.execute(f"PRAGMA max_page_count = {pages + 2}")
        acknowledged = 0

        def fill() -> None:
            nonlocal acknowledged
            for number in range(10_000):
                journal.commit(key(number), RECORD)
                acknowledged += 1

        with pytest.raises(FormatError, match=r"full.*free some space"):
            fill()
        assert acknowledged > 0
    with Journal.read(folder) as journal:
        assert journal.keys() == {key(number) for number in range(acknowledged)}


def test_a_wrong_use_of_the_journal_is_no_matter_of_the_disk(folder: Path) -> None:
    journal = Journal.create(folder, meta=META)
    journal.close()
    with pytest.raises(FormatError, match="closed") as found:
        journal.count()
    assert "report it" in str(found.value)
    for word in ("space", "permissions", "disk"):
        assert word not in str(found.value)


def test_whether_a_program_writes_is_known_without_touching_anything(
    folder: Path,
) -> None:
    assert not journal_file.in_use(folder)
    with Journal.create(folder, meta=META):
        assert journal_file.in_use(folder)
        # Another program sees it, too, and to ask has not let go of the lock.
        asked = (
            "import sys; from pathlib import Path; "
            "from amulor.acquisition.journal import file; "
            "sys.exit(file.in_use(Path(sys.argv[1])))"
        )
        words = [sys.executable, "-c", asked, str(folder)]
        assert subprocess.run(words).returncode == 1
        with pytest.raises(FormatError, match="another program"):
            Journal.resume(folder, meta=META)
    before = sorted((one.name, one.stat().st_mtime_ns) for one in folder.iterdir())
    assert not journal_file.in_use(folder)
    assert before == sorted(
        (one.name, one.stat().st_mtime_ns) for one in folder.iterdir()
    )


def test_a_reader_can_write_nothing(folder: Path) -> None:
    Journal.create(folder, meta=META).close()
    with Journal.read(folder) as journal:
        for write in (
            lambda: journal.commit(key(1), RECORD),
            lambda: journal.note("survey_digest", "another"),
            journal.begin_segment,
        ):
            with pytest.raises(FormatError, match="readonly"):
                write()
    with Journal.resume(folder, meta=META) as journal:
        assert journal.count() == 0


def test_a_reader_neither_blocks_nor_disturbs_the_writer(folder: Path) -> None:
    written = 0
    with Journal.create(folder, meta=META) as journal:
        # Whatever would have to wait for a lock fails at once instead.
        journal._connection.execute("PRAGMA busy_timeout = 0")
        journal._connection.execute("PRAGMA wal_autocheckpoint = 20")
        for _ in range(12):
            # Transactions that stay open are the worst that readers do.
            readers = []
            for _ in range(2):
                reader = Journal.read(folder)
                reader._connection.execute("PRAGMA busy_timeout = 0")
                reader._connection.execute("BEGIN")
                readers.append((reader, reader.count()))
                for _ in range(25):
                    journal.commit(key(written), RECORD)
                    written += 1
            for reader, count in readers:
                assert reader.count() == count
                assert reader.keys() == {key(number) for number in range(count)}
                reader._connection.execute("ROLLBACK")
                assert reader.keys() == {key(number) for number in range(written)}
                reader.close()
    connection = sqlite3.connect(folder / FILE_NAME)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


def test_a_lock_that_is_soon_gone_is_waited_for(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        # Somebody looks at the journal with a tool that locks it for a while.
        other = sqlite3.connect(
            folder / FILE_NAME, isolation_level=None, check_same_thread=False
        )
        other.execute("BEGIN IMMEDIATE")
        timer = threading.Timer(0.1, lambda: other.execute("ROLLBACK"))
        timer.start()
        journal.commit(key(1), RECORD)
        timer.join()
        assert journal.keys() == {key(1)}
        other.close()
    with pytest.raises(FormatError, match="closed database"):
        journal.commit(key(2), RECORD)


def test_another_thread_may_commit_for_that_of_the_scan(folder: Path) -> None:
    with Journal.create(folder, meta=META) as journal:
        thread = threading.Thread(target=journal.commit, args=(key(1), RECORD))
        thread.start()
        thread.join()
        journal.commit(key(2), RECORD)
        assert journal.keys() == {key(1), key(2)}
