"""Writes the change between two visits as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from amulor.io.files import atomic_output
from amulor.site.change.distances import Change


def write_change(change: Change, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a comparison as CSV, a row for each place where both epochs were seen.

    Parameters
    ----------
    change : Change
        The comparison.
    path : str or pathlib.Path
        File to make.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    kept = np.isfinite(change.value)
    columns = [
        *(change.position[kept].T),
        *(change.normal[kept].T),
        change.value[kept],
        change.uncertainty[kept],
        change.own[kept],
        change.chance[kept],
        change.significant[kept],
        change.area[kept],
    ]
    head = (
        "x_m,y_m,z_m,normal_x,normal_y,normal_z,change_m,standard_uncertainty_m,"
        "own_part_m,chance,significant,area_m2"
    )
    rows = [
        ",".join([*(f"{v:.6g}" for v in row[:-2]), f"{row[-2]:.0f}", f"{row[-1]:.6g}"])
        for row in np.stack([np.asarray(c, dtype=float) for c in columns], axis=1)
    ]
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text("\n".join([head, *rows]) + "\n")
