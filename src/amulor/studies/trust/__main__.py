"""Command line of the trust study, `python -m amulor.studies.trust`."""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path

from amulor.studies.trust import false_alarms, instrument
from amulor.studies.trust.methods import METHODS
from amulor.studies.trust.scenes.catalogue import BY_NAME, SCENES
from amulor.studies.trust.scenes.instrument import KINDS, STATES
from amulor.studies.trust.study import run
from amulor.studies.trust.table import Row, counts, line, text, written


def main(arguments: list[str] | None = None) -> int:
    """Run the study with command-line arguments."""
    parser = argparse.ArgumentParser(prog="amulor.studies.trust", description=__doc__)
    parser.add_argument(
        "--scenes",
        choices=["default", "instrument", "perfect"],
        default="default",
        help="instrument: errors of the instrument; perfect: false alarms",
    )
    names = [*BY_NAME, *KINDS]
    parser.add_argument("--scene", action="append", choices=names, metavar="NAME")
    parser.add_argument("--method", action="append", choices=list(METHODS))
    parser.add_argument("--frequencies", action="append", type=int, metavar="COUNT")
    parser.add_argument(
        "--state", action="append", choices=STATES, help="what the survey states"
    )
    parser.add_argument(
        "--size", action="append", type=float, help="multiple of the typical error"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--output",
        type=Path,
        help="file for the table; those of instrument and perfect are continued",
    )
    parser.add_argument("--list", action="store_true", help="list the scenes")
    parser.add_argument(
        "--count", type=Path, metavar="TABLE", help="count what a written table says"
    )
    chosen = parser.parse_args(arguments)
    of_instrument = chosen.scenes == "instrument"
    if chosen.count is not None:
        table = chosen.count.read_text(encoding="utf-8")
        print(_counted(table), end="")
    elif chosen.list:
        titles = {name: kind.title for name, kind in KINDS.items()}
        if not of_instrument:
            titles = {scene.name: scene.title for scene in SCENES}
        for name, title in titles.items():
            print(f"{name:<28} {title}")
    elif chosen.scenes != "default":
        if chosen.output is None:
            parser.error(
                f"--scenes {chosen.scenes} needs --output, the file that it continues"
            )
        (_run_instrument if of_instrument else _run_perfect)(chosen)
    else:
        _run_scenes(chosen)
    return 0


def _counted(table: str) -> str:
    """Return the counts of a table of scenes, instrument errors or false alarms."""
    if instrument.HEADER in table:
        rows = list(instrument.written(table))
        return f"{instrument.counts(rows)}\n{instrument.before_and_after(rows)}"
    if false_alarms.HEADER in table:
        return false_alarms.counts(false_alarms.written(table))
    return counts(written(table))


def _run_perfect(chosen: argparse.Namespace) -> None:
    def show(row: false_alarms.AlarmRow) -> None:
        print(false_alarms.line(row), flush=True)

    rows = false_alarms.run(chosen.output, range(false_alarms.SCANS), done=show)
    chosen.output.write_text(false_alarms.text(rows), encoding="utf-8")


def _run_scenes(chosen: argparse.Namespace) -> None:
    def show(row: Row) -> None:
        print(line(row), flush=True)

    rows = run(
        chosen.scene, chosen.method, chosen.frequencies, seed=chosen.seed, done=show
    )
    if chosen.output is not None:
        chosen.output.write_text(text(rows), encoding="utf-8")


def _run_instrument(chosen: argparse.Namespace) -> None:
    def show(row: instrument.InstrumentRow) -> None:
        print(instrument.line(row), flush=True)

    keys = [
        instrument.Key(
            kind=kind,
            size=size,
            count=count,
            state=state,
            method=method,
            seed=chosen.seed,
        )
        for size, state, count, kind, method in product(
            chosen.size or instrument.SIZES,
            chosen.state or STATES,
            chosen.frequencies or instrument.COUNTS,
            chosen.scene or KINDS,
            chosen.method
            or ("open-water", "polarization", "combined", "joint", "auto"),
        )
        # Sizes and statements of no error are one scan.
        if kind != "perfect" or (size, state) == (1, STATES[0])
    ]
    rows = instrument.run(chosen.output, keys, done=show)
    chosen.output.write_text(instrument.text(rows), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
