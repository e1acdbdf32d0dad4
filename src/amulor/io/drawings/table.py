"""Writes tables as CSV: a header with units, statements in comments before it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from amulor.io.files import atomic_output


def write_table(
    columns: Mapping[str, ArrayLike],
    path: str | os.PathLike[str],
    *,
    statements: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write columns of numbers to a CSV file.

    Parameters
    ----------
    columns : mapping of str to array_like
        Name with its unit to values of one length; whole numbers are written as such,
        others to seven digits, what is not a number as an empty field.
    path : path-like
        File to make.
    statements : sequence of str
        What is to be said of it, a comment line each.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    texts = []
    for values in arrays.values():
        if values.dtype.kind in "iub":
            texts.append([str(int(value)) for value in values])
        else:
            texts.append(["" if np.isnan(v) else f"{v:.7g}" for v in values])
    with (
        atomic_output(Path(path), overwrite=overwrite) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.writelines(f"# {' '.join(text.split())}\n" for text in statements)
        file.write(",".join(arrays) + "\n")
        file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))
