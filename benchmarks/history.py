"""What the benchmarks measured, when, of which commit and on which machine.

Each ``benchmarks/time_*.py`` ends with `append`, one line of JSON in history.jsonl.
``python benchmarks/history.py [BENCHMARK]`` prints the lines as a table. Only figures
of one processor can be compared, and ratios better than seconds.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

FILE = Path(__file__).with_name("history.jsonl")


def append(
    benchmark: str, figures: Mapping[str, float], *, file: Path = FILE
) -> dict[str, object]:
    """Add what one run has measured.

    Parameters
    ----------
    benchmark : str
        Name of the script without its ending.
    figures : mapping of str to float
        Numbers by what they are, with their unit at the end of the name.
    file : pathlib.Path
        Where to, one line of JSON a run.

    Returns
    -------
    dict
        The line.
    """
    line = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "benchmark": benchmark,
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "figures": {name: float(f"{value:.4g}") for name, value in figures.items()},
    }
    with file.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(line) + "\n")
    return line


def commit() -> str:
    """Return the commit of the checkout, with a plus if the sources differ from it."""
    here = {"cwd": FILE.parent, "capture_output": True, "text": True, "check": True}
    try:
        head = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], **here)
        status = ["git", "status", "--porcelain", "--", "../src", "."]
        changed = subprocess.run(status, **here).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    # Lines that other benchmarks of the same round have added are no change.
    changed = [entry for entry in changed if not entry.endswith(FILE.name)]
    return head.stdout.strip() + ("+" if changed else "")


def processor() -> str:
    """Return the model of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    return models[0] if models else platform.processor() or platform.machine()


def table(lines: list[dict[str, object]]) -> str:
    """Return runs as text, one figure a line."""
    rows = []
    for line in lines:
        rows.append(
            f"{line['date']}  {line['commit']}  {line['benchmark']}  "
            f"{line['processor']}, {line['cores']} cores"
        )
        for name, value in line["figures"].items():
            rows.append(f"    {name:<56}{value:>12.4g}")
    return "\n".join(rows)


if __name__ == "__main__":
    runs = [json.loads(line) for line in FILE.read_text(encoding="utf-8").splitlines()]
    print(table([run for run in runs if sys.argv[1:] in ([], [run["benchmark"]])]))
