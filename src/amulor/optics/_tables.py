"""Published data tables of the package, read from their files once."""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np
from numpy.typing import NDArray


@cache
def numbers(name: str) -> NDArray[np.float64]:
    """Return a numeric table from a data file, as a read-only array.

    Examples
    --------
    >>> print(numbers("pope_fry_1997.csv")[0])
    [3.800e+02 1.137e-02]
    """
    with _folder().joinpath(name).open(encoding="utf-8") as lines:
        table = np.loadtxt(lines, delimiter=",")
    table.flags.writeable = False
    return table


@cache
def rows(name: str) -> tuple[dict[str, str], ...]:
    """Return the rows of a data table as dictionaries of strings, by column name.

    Examples
    --------
    >>> rows("petzold_1972_coefficients.csv")[0]["station"]
    'AUTEC 7'
    """
    text = _folder().joinpath(name).read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return tuple(csv.DictReader(lines))


def _folder() -> Traversable:
    return resources.files("amulor.optics").joinpath("data")
