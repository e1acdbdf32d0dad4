"""How commands print: tables, JSON, and a progress bar on terminals only."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any


def print_json(value: Any) -> None:
    """Print a value as JSON on standard output.

    Parameters
    ----------
    value : object
        Numbers, texts, paths, lists and tables; not-a-number becomes null.
    """
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


def print_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Print a table on standard output.

    Parameters
    ----------
    title : str
        What it shows.
    header : sequence of str
        Titles of the columns.
    rows : sequence of sequences of str
        Cells.
    """
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, cell in enumerate(header):
        table.add_column(cell, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def progress_bar(*, quiet: bool = False) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on a terminal, and nothing in a pipe.

    Parameters
    ----------
    quiet : bool
        Show nothing anywhere.

    Yields
    ------
    callable
        Takes what is done now and the share of the work done before it.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda step, share: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda step, share: bar.update(task, description=step, completed=share)


def _plain(value: Any) -> Any:
    import math
    from pathlib import PurePath

    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
