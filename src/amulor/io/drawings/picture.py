"""Writes pictures as PNG files that know their size on paper."""

from __future__ import annotations

import os
import struct
import zlib
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
    rows, columns = pixels.shape[:2]
    lines = np.zeros((rows, columns * 4 + 1), dtype=np.uint8)  # a filter byte each
    lines[:, 1:] = pixels.reshape(rows, -1)
    density = round(dots_per_metre)
    chunks = [
        _chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0)),
        _chunk(b"pHYs", struct.pack(">IIB", density, density, 1)),
    ]
    for key, text in texts.items():
        # International text: keyword, no compression, no language, UTF-8.
        content = key.encode("latin-1") + b"\0\0\0\0\0" + text.encode()
        chunks.append(_chunk(b"iTXt", content))
    chunks.append(_chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)))
    chunks.append(_chunk(b"IEND", b""))
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)
