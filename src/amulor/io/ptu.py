"""Photon histograms of PTU files, read by the package ptufile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor import _extras
from amulor.errors import FormatError


def ptu_fields(path: Path) -> dict[str, NDArray[Any]]:
    """Return counts (channels, rows, columns, bins) and bin width of a PTU image.

    Frames are added. FormatError if the file is damaged or no image with bins.
    """
    _extras.require("ptu", purpose=f"reading {path.name}")
    from ptufile import PtuFile

    try:
        with PtuFile(path) as file:
            if not file.is_image or not file.is_t3:
                raise ValueError("it is no image with time bins (T3)")
            # Dimensions: frames, rows, columns, channels, bins.
            counts = file.decode_image(dtype=np.uint32).sum(axis=0)
            width = float(file.tcspc_resolution)
    except Exception as error:  # many kinds, from the other package
        raise FormatError(
            f"{path} cannot be read as a PTU image: {error}; export histograms as npz"
        ) from error
    return {"counts": np.moveaxis(counts, 2, 0), "bin_width_s": np.array(width)}
