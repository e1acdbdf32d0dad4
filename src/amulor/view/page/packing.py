"""Numbers made small enough to stand in a page: bytes sorted, deflated, as text."""

from __future__ import annotations

import base64
import zlib

import numpy as np

#: Fast; what is left after sorting the bytes is noise, which no level makes smaller.
_LEVEL = 4


def packed(content: bytes, *, width: int) -> str:
    """Return bytes as text.

    Parameters
    ----------
    content : bytes
        Numbers of one width.
    width : int
        Bytes of one number. First bytes of all numbers come first, then the second
        ones: those of neighbours are alike.

    Returns
    -------
    str
        Base64 of a zlib stream.
    """
    sorted_bytes = np.frombuffer(content, np.uint8).reshape(-1, width).T.tobytes()
    return base64.b64encode(zlib.compress(sorted_bytes, _LEVEL)).decode()


def unpacked(text: str, *, width: int) -> bytes:
    """Return the bytes that `packed` was given."""
    content = zlib.decompress(base64.b64decode(text))
    return np.frombuffer(content, np.uint8).reshape(width, -1).T.tobytes()
