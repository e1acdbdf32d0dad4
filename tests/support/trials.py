"""Keeps the figures of long trials in tables, where the environment names a folder."""

from __future__ import annotations

import csv
import os
from pathlib import Path


def keep(table: str, **figures: str | float) -> None:
    """Write a row of a table in the folder AMULOR_TRIALS, such as `docs/trust`.

    Parameters
    ----------
    table : str
        Name of the table, without `.csv`.
    **figures : str or float
        The columns. A row with the same first two columns is replaced.
    """
    if not (folder := os.environ.get("AMULOR_TRIALS")):
        return
    path = Path(folder) / f"{table}.csv"
    new = {
        name: value if isinstance(value, str) else f"{value:.3g}" if value % 1 else
        f"{value:.0f}" for name, value in figures.items()
    }  # fmt: skip
    rows = {}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = {tuple(row.values())[:2]: row for row in csv.DictReader(file)}
    rows[tuple(new.values())[:2]] = new
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(new), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in sorted(rows))
