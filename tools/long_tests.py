"""Write tests/reference/long_tests.txt: tests that `make test` leaves to `make check`.

Run ``python tools/long_tests.py`` on a quiet computer whose cache has compiled code. It
runs all tests without the mark `slow`, and lists each that took longer than LIMIT. In
each file of tests the shortest test is not listed, so that `make test` runs a part of
every file.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
LISTING = ROOT / "tests" / "reference" / "long_tests.txt"
#: Longest test of `make test`, with its fixtures [s].
LIMIT = 0.4


def long_tests(report: str, limit: float = LIMIT) -> list[str]:
    """Return the identifiers of long tests in a report of durations of pytest."""
    seconds: dict[str, float] = defaultdict(float)
    line = r"^ *([0-9.]+)s (?:setup|call|teardown) +(\S.*)$"
    for time, name in re.findall(line, report, flags=re.MULTILINE):
        seconds[name] += float(time)
    by_file: dict[str, list[str]] = defaultdict(list)
    for name in seconds:
        by_file[name.partition("::")[0]].append(name)
    shortest = {
        min(names, key=lambda name: seconds[name]) for names in by_file.values()
    }
    return sorted(
        n for n, time in seconds.items() if time > limit and n not in shortest
    )


def main() -> None:
    """Measure all tests and write the listing."""
    LISTING.write_text("")
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile"]
    run = subprocess.run(
        [*command, "--durations=0", "--durations-min=0"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    names = long_tests(run.stdout)
    LISTING.write_text("".join(f"{name}\n" for name in names))
    print(f"{LISTING}: {len(names)} tests")


if __name__ == "__main__":
    main()
