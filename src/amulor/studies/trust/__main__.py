"""Command line of the trust study, `python -m amulor.studies.trust`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from amulor.studies.trust.methods import METHODS
from amulor.studies.trust.scenes.catalogue import BY_NAME, GROUPS
from amulor.studies.trust.study import run
from amulor.studies.trust.table import Row, counts, line, text, written


def main(arguments: list[str] | None = None) -> int:
    """Run the study with command-line arguments."""
    parser = argparse.ArgumentParser(prog="amulor.studies.trust", description=__doc__)
    parser.add_argument("--scenes", choices=list(GROUPS), default="default")
    names = list(BY_NAME)
    parser.add_argument("--scene", action="append", choices=names, metavar="NAME")
    parser.add_argument("--method", action="append", choices=list(METHODS))
    parser.add_argument("--frequencies", action="append", type=int, metavar="COUNT")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, help="file for the table")
    parser.add_argument("--list", action="store_true", help="list the scenes")
    parser.add_argument(
        "--count", type=Path, metavar="TABLE", help="count what a written table says"
    )
    chosen = parser.parse_args(arguments)
    if chosen.count is not None:
        print(counts(written(chosen.count.read_text(encoding="utf-8"))), end="")
        return 0
    if chosen.list:
        for scene in GROUPS[chosen.scenes]:
            print(f"{scene.name:<28} {scene.title}")
        return 0

    def show(row: Row) -> None:
        print(line(row), flush=True)

    scenes = chosen.scene or [scene.name for scene in GROUPS[chosen.scenes]]
    rows = run(scenes, chosen.method, chosen.frequencies, seed=chosen.seed, done=show)
    if chosen.output is not None:
        chosen.output.write_text(text(rows), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
