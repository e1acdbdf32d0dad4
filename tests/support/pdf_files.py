"""Letters, pages and fonts of PDF files, read from their objects."""

from __future__ import annotations

import re
import zlib
from pathlib import Path


def streams_of(path: Path) -> list[bytes]:
    """Return the decompressed streams of a PDF file."""
    content = path.read_bytes()
    streams = []
    for match in re.finditer(rb"<<(?P<keys>[^>]*?)>>\s*stream\r?\n", content):
        length = re.search(rb"/Length (\d+)\b(?! 0 R)", match["keys"])
        end = content.index(b"endstream", match.end())
        stop = match.end() + int(length[1]) if length else end
        text = content[match.end() : stop]
        if b"/FlateDecode" in match["keys"]:
            text = zlib.decompressobj().decompress(text)
        streams.append(text)
    return streams


def letter_sizes(path: Path) -> list[float]:
    """Return the size of each piece of text [pt]."""
    found = [
        float(size)
        for stream in streams_of(path)
        for size in re.findall(rb"/F\d+ ([\d.]+) Tf", stream)
    ]
    assert found, f"{path} has no text"
    return found


def pages_of(path: Path) -> int:
    """Return the number of pages."""
    return len(re.findall(rb"/Type /Page\b(?!s)", path.read_bytes()))
