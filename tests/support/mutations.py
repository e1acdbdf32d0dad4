"""Changes files in the way of their format: text, HDF5, npz, GLB, LAS, E57, bytes."""

from __future__ import annotations

import contextlib
import io
import json
import random
import re
import struct
import zipfile

import h5py
import numpy as np

_NUMBERS = (
    "0", "-1", "1", "1e308", "-1e308", "1e400", "nan", "inf", "-inf", "5e-324", "1e16",
    "99999999999999999999", "-0.0", "0x10", "1_000", "true", "''", "[]", "{}", "1.5",
)  # fmt: skip
_WORDS = (
    "", " ", "x", "0 m", "-1 m", "5 parsec", "nan m", "1e300 m", "m", "\\u0000",
    "1 mHz",    "10 kHz", "1e999 Hz", "é", "a" * 400, "../../etc/passwd",
)  # fmt: skip
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")
_QUOTED = re.compile(r'"[^"\n]*"')


# -- of any file -----------------------------------------------------------------------


def flip(content: bytes, rng: random.Random) -> bytes:
    """Turn one bit over."""
    changed = bytearray(content or b"\0")
    changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def scribble(content: bytes, rng: random.Random) -> bytes:
    """Write over some bytes, at one place."""
    many = rng.choice((1, 2, 4, 8, 64, 512))
    at = rng.randrange(max(len(content), 1))
    new = rng.choice((rng.randbytes(many), b"\xff" * many, bytes(many)))
    return content[:at] + new + content[at + many :]


def number(content: bytes, rng: random.Random) -> bytes:
    """Write a whole number over four or eight bytes, such as a length."""
    value = rng.choice((0, 1, -1, 2**31 - 1, -(2**31), 2**16, 255, 10**9))
    size = rng.choice(("<i", ">i", "<q", "<f", "<d"))
    new = struct.pack(size, value)
    at = rng.randrange(max(len(content) - len(new), 1))
    # Formats keep their lengths near the beginning, or the end.
    at = rng.choice((at, at % 512, max(len(content) - len(new) - at % 128, 0)))
    return content[:at] + new + content[at + len(new) :]


def cut(content: bytes, rng: random.Random) -> bytes:
    """Leave out the end, the beginning or a piece."""
    first, last = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    return rng.choice(
        (content[:first], content[last:], content[:first] + content[last:])
    )


def repeat(content: bytes, rng: random.Random) -> bytes:
    """Write a piece twice, or to another place."""
    first, last = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    piece = content[first : min(last, first + 4096)]
    at = rng.randrange(len(content) + 1)
    return content[:at] + piece + content[at:]


BYTES = (flip, flip, scribble, number, cut, repeat)


# -- of text ---------------------------------------------------------------------------


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _replaced(text: str, pattern: re.Pattern[str], new: str, rng: random.Random) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    one = rng.choice(found)
    return text[: one.start()] + new + text[one.end() :]


def other_number(content: bytes, rng: random.Random) -> bytes:
    """Write another number."""
    return _bytes(_replaced(_text(content), _NUMBER, rng.choice(_NUMBERS), rng))


def other_word(content: bytes, rng: random.Random) -> bytes:
    """Write something else between quotes, or without them."""
    word = rng.choice(_WORDS)
    new = rng.choice((f'"{word}"', f'"{word}"', word, f'["{word}"]', "7"))
    return _bytes(_replaced(_text(content), _QUOTED, new, rng))


def other_lines(content: bytes, rng: random.Random) -> bytes:
    """Drop a line, write it twice, exchange two, or put rubbish in."""
    lines = _text(content).split("\n")
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(5):
        case 0:
            del lines[one]
        case 1:
            lines.insert(other, lines[one])
        case 2:
            lines[one], lines[other] = lines[other], lines[one]
        case 3:
            lines[one] = lines[one] + lines[other]
        case _:
            lines.insert(one, rng.choice(("[x]", "x = 1", "[[x]]", "\udcff", "}", "#")))
    return _bytes("\n".join(lines))


def other_value(content: bytes, rng: random.Random) -> bytes:
    """Write something else behind an equals sign."""
    new = rng.choice((*_NUMBERS, "[[]]", '"1 m"', "{x = 1}", "2026-01-01", "[1, 2, 3]"))
    text = _text(content)
    return _bytes(_replaced(text, re.compile(r"(?<== ).*"), new, rng))


TEXT = (other_number, other_number, other_word, other_lines, other_value, flip, cut)


# -- of HDF5, such as cubes ------------------------------------------------------------

_VALUES = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 1e-300, 7.0, 1e16)


def hdf5(content: bytes, rng: random.Random) -> bytes:
    """Change an array, a name or an attribute, and write the file anew."""
    try:
        # Without the seal behind it, as another program leaves it.
        buffer = io.BytesIO(content.partition(b"\namulor sha256:")[0])
        with h5py.File(buffer, "r+") as file:
            _change(file, rng)
        return buffer.getvalue()
    except Exception:  # bytes that other mutations left
        return flip(content, rng)


def _change(file: h5py.File, rng: random.Random) -> None:
    found: list[h5py.Dataset] = []
    file.visititems(
        lambda _, thing: (
            found.append(thing) if isinstance(thing, h5py.Dataset) else None
        )
    )
    one = rng.choice(found)
    owner = rng.choice((one, file))
    numbers = one.dtype.kind in "fiu" and one.size
    way = rng.randrange(7)
    if way < 3 and numbers:
        values = one[()]
        value = rng.choice(_VALUES)
        if one.dtype.kind != "f":
            value = rng.choice((-1, 0, 7, 120))
        if one.shape == () or way == 0:
            one[...] = np.full_like(values, value)
        elif way == 1:
            values.flat[rng.randrange(values.size)] = value
            one[...] = values
        elif one.dtype.kind == "f":
            one[...] = values * rng.choice((1e300, -1.0, 1e-300, 1e17))
    elif way == 3:
        del file[one.name]
    elif way == 4:
        file.move(one.name, one.name + "x")
    elif way == 5 and owner.attrs:
        key = rng.choice(sorted(owner.attrs))
        if key not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
            del owner.attrs[key]
    else:
        key = rng.choice(sorted(owner.attrs) or ["x"])
        if key not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
            new = rng.choice(("", "samples", "x" * 300, 1e300, -1, np.nan, [1, 2], "é"))
            owner.attrs[key] = new


# -- of npz ----------------------------------------------------------------------------


def npz(content: bytes, rng: random.Random) -> bytes:
    """Change an array, and write the archive anew, its checksums right."""
    try:
        with np.load(io.BytesIO(content)) as archive:
            arrays = {
                name: values
                for name, values in archive.items()
                if isinstance(values, np.ndarray)
            }
    except Exception:  # bytes that other mutations left
        return flip(content, rng)
    if not arrays:
        return content
    name = rng.choice(sorted(arrays))
    values = arrays[name]
    way = rng.randrange(6)
    if way == 0:
        del arrays[name]
    elif way == 1:
        with contextlib.suppress(ValueError):  # text of an earlier change is no number
            arrays[name] = values.astype(
                rng.choice(("f4", "i1", "c16", "U8", "bool", "f8"))
            )
    elif way == 2:
        arrays[name] = values[..., np.newaxis] if rng.random() < 0.5 else values.ravel()
    elif way == 3:
        arrays[name] = values[:0] if values.ndim else np.array([])
    else:
        changed = values.astype(rng.choice((values.dtype, np.dtype(float))))
        flat = changed.reshape(-1)
        with np.errstate(all="ignore"):
            flat[rng.randrange(max(flat.size, 1)) : None : rng.choice((1, 9))] = (
                np.asarray(rng.choice(_VALUES)).astype(changed.dtype)
            )
        arrays[name] = changed
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def npy_header(content: bytes, rng: random.Random) -> bytes:
    """Change the text before the numbers of an array, its checksum right."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # bytes that other mutations left
        return flip(content, rng)
    if not parts:
        return content
    name = rng.choice(sorted(parts))
    head = parts[name][:128]
    head = rng.choice((flip, scribble, other_number))(head, rng)
    parts[name] = head[:128] + parts[name][128:]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for member, part in parts.items():
            archive.writestr(member, part)
    return buffer.getvalue()


# -- of GLB ----------------------------------------------------------------------------


def glb(content: bytes, rng: random.Random) -> bytes:
    """Change a number or a name of the description, its length right."""
    try:
        (length,) = struct.unpack_from("<I", content, 12)
        text = content[20 : 20 + length]
        text = rng.choice((other_number, other_word))(text, rng)
        json.loads(text)
    except Exception:  # what would be refused at once, or what others left
        return flip(content, rng)
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text),
                       0x4E4F534A)  # fmt: skip
    return head + text + rest


# -- of LAS and LAZ --------------------------------------------------------------------

#: Places of numbers in a header: sizes, offsets, counts, formats, scales and bounds.
_LAS = (
    (24, "<B"), (25, "<B"), (94, "<H"), (96, "<I"), (100, "<I"), (104, "<B"),
    (105, "<H"), (107, "<I"), (111, "<I"), (131, "<d"), (139, "<d"), (155, "<d"),
    (163, "<d"), (179, "<d"), (187, "<d"), (227, "<Q"), (235, "<Q"), (243, "<I"),
    (247, "<Q"),
)  # fmt: skip


def las(content: bytes, rng: random.Random) -> bytes:
    """Change a number of the header, or of the beginning of a record behind it."""
    changed = bytearray(content)
    at, form = rng.choice(_LAS)
    if rng.random() < 0.3 and len(content) > 400:
        # The length of a record stands 20 bytes behind its beginning.
        (size,) = struct.unpack_from("<H", content, 94)
        at, form = rng.choice(((size + 20, "<H"), (size + 54, "<H"), (size + 58, "<I")))
    if at + struct.calcsize(form) > len(changed):
        return flip(content, rng)
    (old,) = struct.unpack_from(form, changed, at)
    if form == "<d":
        new = rng.choice((*_VALUES, old * 1e9, -old))
    else:
        most = 256 ** struct.calcsize(form) - 1
        new = rng.choice((0, 1, old - 1, old + 1, 2 * old, most, most // 2, most - old))
        new = min(max(new, 0), most)
    with contextlib.suppress(struct.error, OverflowError):
        struct.pack_into(form, changed, at, new)
    return bytes(changed)


# -- of E57 ----------------------------------------------------------------------------


def _castagnoli() -> list[int]:
    table = []
    for number in range(256):
        for _ in range(8):
            number = number >> 1 ^ (0x82F63B78 if number & 1 else 0)
        table.append(number)
    return table


_CASTAGNOLI = _castagnoli()


def _checked(page: bytes) -> bytes:
    """Return a page with its checksum, which is CRC-32C."""
    value = 0xFFFFFFFF
    for byte in page:
        value = value >> 8 ^ _CASTAGNOLI[(value ^ byte) & 0xFF]
    return page + struct.pack(">I", value ^ 0xFFFFFFFF)


def e57(content: bytes, rng: random.Random) -> bytes:
    """Change the description or the points, the checksums of all pages right."""
    try:
        pages = [content[at : at + 1024] for at in range(0, len(content), 1024)]
        logical = b"".join(page[:1020] for page in pages)
        place, length = struct.unpack_from("<QQ", logical, 24)
        begin = place // 1024 * 1020 + place % 1024
        text = logical[begin : begin + length]
        if rng.random() < 0.6:
            text = rng.choice((other_number, other_number, other_word))(text, rng)
            head = logical[:32] + struct.pack("<Q", len(text)) + logical[40:begin]
            logical = head + text
        else:
            front = rng.choice((flip, scribble, number))(logical[:begin], rng)
            logical = front[:begin] + text
        logical += bytes(-len(logical) % 1020)
        size = struct.pack("<Q", len(logical) // 1020 * 1024)
        logical = logical[:16] + size + logical[24:]
    except struct.error:  # bytes that other mutations left
        return flip(content, rng)
    return b"".join(
        _checked(logical[at : at + 1020]) for at in range(0, len(logical), 1020)
    )
