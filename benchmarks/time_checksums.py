"""What the checksum of a row costs a commit: paired, one journal beside the other."""

from __future__ import annotations

import dataclasses
import operator
import statistics
import sys
import tempfile
import time
from pathlib import Path

from amulor.acquisition.journal import file as journal_file
from amulor.acquisition.journal.file import explained
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.journal.rows import CHECKSUM, TABLES
from amulor.acquisition.plan import SCAN, Key

RECORD = Record(
    in_phase=1.1e-3, quadrature=-2.2e-3, mean=0.3, readings=8, full_scale=1.0, flags=0,
    commanded_azimuth=0.1, commanded_elevation=-0.1, azimuth=0.1000001,
    elevation=-0.1000001, modulation_frequency=39e6, elapsed=1.5, segment=1,
    interval=1e-3, launch=0.0, analyser=1.57, target=0.0,
)  # fmt: skip
_NAMES = [*Key._fields, *(field.name for field in dataclasses.fields(Record))]
_INSERT = (
    f"INSERT INTO samples ({', '.join(_NAMES)}) VALUES ({', '.join('?' * len(_NAMES))})"
)
_VALUES = operator.attrgetter(*(field.name for field in dataclasses.fields(Record)))
META = {"survey_digest": "", "instrument_digest": "", "identities": "{}"}


class Plain(Journal):
    """A journal as it was before there were checksums."""

    @classmethod
    def made(cls, folder: Path) -> Plain:
        """Return a new one."""
        tables = [text.replace(f", {CHECKSUM} INTEGER", "") for text in TABLES]
        journal_file.make(folder / "journal.sqlite", tables=tables, meta=META)
        return cls(folder, journal_file.writer(folder / "journal.sqlite"))

    def commit(self, key: Key, record: Record) -> None:
        """Write one sample."""
        with explained(self._path):
            self._connection.execute(_INSERT, (*key, *_VALUES(record)))


def main() -> None:
    """Print medians of both and of the ratio of neighbours; add them to the history."""
    import history

    place = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.gettempdir())
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 4000
    with tempfile.TemporaryDirectory(dir=place) as name:
        folders = [Path(name) / way for way in ("plain", "checked")]
        for folder in folders:
            folder.mkdir()
        ways = [Plain.made(folders[0]), Journal.create(folders[1], meta=META)]
        pairs = []
        for number in range(count):
            key = Key(SCAN, number // 100, number % 100, 39e6, "VH", 0)
            took = [0.0, 0.0]
            for way in (0, 1) if number % 2 else (1, 0):
                start = time.perf_counter()
                ways[way].commit(key, RECORD)
                took[way] = time.perf_counter() - start
            pairs.append(took)
        for journal in ways:
            journal.close()
    without, with_them = (
        statistics.median(column) for column in zip(*pairs, strict=True)
    )
    ratio = statistics.median(checked / plain for plain, checked in pairs)
    print(
        f"{place}: {without * 1e6:.1f} us without, {with_them * 1e6:.1f} us with "
        f"checksums, ratio of neighbours {ratio:.3f}"
    )
    history.append("time_checksums", {f"ratio in {place}": ratio})


if __name__ == "__main__":
    main()
