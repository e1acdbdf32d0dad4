"""Writes pictures as PNG files that know their size on paper."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amulor.io.files import atomic_output


def write_picture(
    pixels: NDArray[np.uint8],
    path: str | os.PathLike[str],
    *,
    dots_per_metre: float,
    texts: Mapping[str, str],
    overwrite: bool = False,
) -> None:
    """Write a picture to a PNG file, with its resolution and texts inside.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (rows, columns, 4)
        Red, green, blue and opacity.
    path : path-like
        File to make.
    dots_per_metre : float
        Pixels to a metre of paper, so that it prints at its scale [1/m].
    texts : mapping of str to str
        What is to be said of it, under keywords of at most 79 letters.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    from PIL import Image, PngImagePlugin

    described = PngImagePlugin.PngInfo()
    for key, text in texts.items():
        described.add_itxt(key, text)
    density = round(dots_per_metre) * 0.0254  # dots per inch, whole ones per metre
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        Image.fromarray(pixels).save(
            temporary, format="PNG", dpi=(density, density), pnginfo=described
        )
