"""Reader of PDF files that lists what ISO 19005-2 (PDF/A-2b) forbids in a drawing.

Written from ISO 32000-1 and ISO 19005-2 alone: it shares no line with the writer. It
reads cross-reference tables, objects, page contents and fonts. Features that drawings
never have, such as forms, annotations and attachments, are refused without a look.
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fontTools.ttLib import TTFont

_SPACE = b"\0\t\n\f\r "
_DELIMITERS = b"()<>[]{}/%"
#: Operators of ISO 32000-1, Table 51, without inline images and marked content.
_OPERATORS = (
    " w J j M d ri i gs q Q cm m l c v y h re S s f F f* B B* b b* n W W* BT ET Tc Tw "
    "Tz TL Tf Tr Ts Td TD Tm T* Tj TJ ' \" CS cs SC SCN sc scn G g RG rg sh Do "
)
#: Keys of actions, scripts, attachments and printer settings.
_FORBIDDEN = (
    " AA OpenAction JS AcroForm EF Encrypt TR HTP OPI Names Alternates Ref PS "
    "Requirements XFA OCProperties "
)
_BLEND_MODES = (
    " Normal Compatible Multiply Screen Overlay Darken Lighten ColorDodge ColorBurn "
    "HardLight SoftLight Difference Exclusion Hue Saturation Color Luminosity "
)


class Name(str):
    """PDF name, without its slash."""


@dataclass(frozen=True)
class Ref:
    """Reference to an indirect object."""

    number: int


@dataclass(frozen=True)
class Operator:
    """Operator of a content stream."""

    text: str


@dataclass
class Stream:
    """Stream with its dictionary."""

    keys: dict[str, Any]
    raw: bytes

    @property
    def content(self) -> bytes:
        """Content without its filter; image predictors stay."""
        if self.keys.get("Filter") == "FlateDecode":
            return zlib.decompress(self.raw)
        return self.raw


class Tokens:
    """Objects of a PDF file or content stream, one after the other."""

    def __init__(self, data: bytes, place: int = 0) -> None:
        self.data, self.place = data, place

    def skip(self) -> None:
        while self.place < len(self.data):
            if self.data[self.place] in _SPACE:
                self.place += 1
            elif self.data[self.place] == ord("%"):
                while self.data[self.place] not in b"\r\n":
                    self.place += 1
            else:
                return

    def word(self) -> bytes:
        start = self.place
        while (
            self.place < len(self.data)
            and self.data[self.place] not in _SPACE + _DELIMITERS
        ):
            self.place += 1
        return self.data[start : self.place]

    def value(self) -> Any:
        self.skip()
        two, first = self.data[self.place : self.place + 2], self.data[self.place]
        if two == b"<<":
            self.place += 2
            items = self.until(b">>")
            return {
                str(key): item for key, item in zip(*[iter(items)] * 2, strict=True)
            }
        if first == ord("["):
            self.place += 1
            return self.until(b"]")
        if first == ord("<"):
            end = self.data.index(b">", self.place)
            text, self.place = self.data[self.place + 1 : end], end + 1
            return bytes.fromhex(text.decode())
        if first == ord("("):
            return self.string()
        if first == ord("/"):
            self.place += 1
            return Name(self.word().decode("latin1"))
        word = self.word()
        if re.fullmatch(rb"\d+", word):
            match = re.compile(rb"\s+\d+\s+R\b").match(self.data, self.place)
            if match:
                self.place = match.end()
                return Ref(int(word))
        if re.fullmatch(rb"[-+]?(\d+\.?\d*|\.\d+)", word):
            return float(word)
        plain = {b"true": True, b"false": False, b"null": None}
        assert word, f"no object at byte {self.place}"
        return plain[word] if word in plain else Operator(word.decode("latin1"))

    def until(self, end: bytes) -> list[Any]:
        items = []
        while True:
            self.skip()
            if self.data.startswith(end, self.place):
                self.place += len(end)
                return items
            items.append(self.value())

    def string(self) -> bytes:
        depth, text = 0, bytearray()
        escapes = {ord(k): ord(v) for k, v in zip("nrtbf", "\n\r\t\b\f", strict=True)}
        while True:
            letter = self.data[self.place]
            self.place += 1
            if letter == ord("\\"):
                octal = re.compile(rb"[0-7]{1,3}").match(self.data, self.place)
                if octal:
                    text.append(int(octal[0], 8) & 255)
                    self.place = octal.end()
                    continue
                letter = self.data[self.place]
                self.place += 1
                if letter not in b"\r\n":
                    text.append(escapes.get(letter, letter))
                continue
            depth += (letter == ord("(")) - (letter == ord(")"))
            if depth == 0:
                return bytes(text)
            if text or letter != ord("(") or depth > 1:
                text.append(letter)

    def all(self) -> Iterator[Any]:
        self.skip()
        while self.place < len(self.data):
            yield self.value()
            self.skip()


class File:
    """Objects of a PDF file with plain cross-reference tables."""

    def __init__(self, path: Path) -> None:
        self.data = path.read_bytes()
        self.faults: list[str] = []
        self.places: dict[int, int] = {}
        self.trailer: dict[str, Any] = {}
        start = int(re.findall(rb"startxref\s+(\d+)", self.data)[-1])
        while True:
            trailer = self._table(start)
            self.trailer = self.trailer or trailer
            if "Prev" not in trailer:
                break
            start = int(trailer["Prev"])
        self.objects = {number: self._object(number) for number in self.places}

    def _table(self, start: int) -> dict[str, Any]:
        tokens = Tokens(self.data, start)
        if tokens.word() != b"xref":
            self.faults.append(f"6.1.4: no cross-reference table at byte {start}")
            return {}
        pattern = re.compile(rb"\s*(\d+) (\d+)\r?\n")
        while match := pattern.match(self.data, tokens.place):
            first, count = int(match[1]), int(match[2])
            for number in range(count):
                entry = self.data[match.end() + 20 * number :][:20]
                if entry[17:18] == b"n":
                    self.places.setdefault(first + number, int(entry[:10]))
            tokens.place = match.end() + 20 * count
        tokens.skip()
        assert tokens.word() == b"trailer"
        return tokens.value()

    def _object(self, number: int) -> Any:
        head = b"%d 0 obj\n" % number
        place = self.places[number]
        if self.data[place - 1 : place + len(head)] != b"\n" + head:
            self.faults.append(f"6.1.9: object {number} is not at byte {place}")
            return None
        tokens = Tokens(self.data, place + len(head))
        value = tokens.value()
        match = re.compile(rb"\s*stream\r?\n").match(self.data, tokens.place)
        if match:
            length = value["Length"]
            if isinstance(length, Ref):
                inner = self.places[length.number]
                length = Tokens(self.data, self.data.index(b"obj", inner) + 3).value()
            end = match.end() + int(length)
            if not re.match(rb"\r?\nendstream\s", self.data[end : end + 12]):
                self.faults.append(f"6.1.7.1: wrong length of stream {number}")
            tokens.place = self.data.index(b"endstream", end) + 9
            value = Stream(value, self.data[match.end() : end])
        if not re.compile(rb"\r?\nendobj\r?\n").match(self.data, tokens.place):
            self.faults.append(f"6.1.9: no line 'endobj' after object {number}")
        return value

    def get(self, value: Any) -> Any:
        """Return a value, or the object that it refers to."""
        return self.objects.get(value.number) if isinstance(value, Ref) else value

    def values(self, value: Any) -> Iterator[Any]:
        """Return all values inside an object, itself first."""
        yield value
        if isinstance(value, Stream):
            value = value.keys
        parts = value.values() if isinstance(value, dict) else value
        if isinstance(value, (dict, list)):
            for part in parts:
                yield from self.values(part)

    def pages(self) -> list[dict[str, Any]]:
        """Return the dictionaries of all pages."""
        return [
            value
            for value in self.objects.values()
            if isinstance(value, dict) and value.get("Type") == "Page"
        ]


def archive_faults(path: Path) -> list[str]:
    """Return the clauses of ISO 19005-2 that a drawing violates, with reasons."""
    file = File(path)
    faults = file.faults
    if not re.match(rb"%PDF-1\.[0-7]\r?\n%[\x80-\xff]{4}", file.data):
        faults.append("6.1.2: no comment of four bytes above 127 after the header")
    if not file.data.rstrip(b"\r\n").endswith(b"%%EOF"):
        faults.append("6.1.3: data after the end of the file")
    if len(file.get(file.trailer.get("ID")) or []) != 2:
        faults.append("6.1.3: no file identifier")
    catalogue = file.get(file.trailer["Root"])
    faults += _metadata(file, catalogue) + _intent(file, catalogue)
    faults += sorted({fault for o in file.objects.values() for fault in _keys(file, o)})
    used: dict[int, set[int]] = {}
    for page in file.pages():
        faults += _page(file, page, used)
    for value in file.objects.values():
        if isinstance(value, Stream) and value.keys.get("PatternType") == 1:
            resources = file.get(value.keys["Resources"])
            faults += _contents(file, value.content, resources, used)
    for number, codes in used.items():
        faults += _font(file, file.objects[number], codes)
    return faults


def _metadata(file: File, catalogue: dict[str, Any]) -> list[str]:
    stream = file.get(catalogue.get("Metadata"))
    if not isinstance(stream, Stream):
        return ["6.6.2.1: no XMP metadata"]
    root = ET.fromstring(stream.content)
    space = "{http://www.aiim.org/pdfa/ns/id/}"
    stated = root.findtext(f".//{space}part"), root.findtext(f".//{space}conformance")
    return [] if stated == ("2", "B") else [f"6.6.4: XMP states part {stated}"]


def _intent(file: File, catalogue: dict[str, Any]) -> list[str]:
    intents = file.get(catalogue.get("OutputIntents")) or []
    if len(intents) != 1:
        return ["6.2.3: no output intent"]
    intent = file.get(intents[0])
    profile = file.get(intent.get("DestOutputProfile"))
    if intent.get("S") != "GTS_PDFA1" or not isinstance(profile, Stream):
        return ["6.2.3: output intent without a color profile"]
    head = profile.content
    # ICC.1:2010, header: size, version, class, color space and signature.
    good = (
        int.from_bytes(head[:4], "big") == len(head)
        and head[8] <= 4
        and head[12:16] in (b"mntr", b"prtr", b"scnr", b"spac")
        and (head[16:20], profile.keys.get("N")) == (b"RGB ", 3)
        and head[36:40] == b"acsp"
    )
    return [] if good else ["6.2.3: color profile is not one of RGB"]


def _keys(file: File, value: Any) -> Iterator[str]:
    """Return faults of keys and values anywhere in an object."""
    for part in file.values(value):
        if isinstance(part, Ref) and part.number not in file.objects:
            yield f"6.1.9: object {part.number} is missing"
        if isinstance(part, bytes) and len(part) > 32767:
            yield "6.1.13: string above 32767 bytes"
        if isinstance(part, Name) and len(part) > 127:
            yield f"6.1.13: name {part}"
        if part == Name("DeviceCMYK"):
            yield "6.2.4.3: CMYK colors with an RGB output intent"
        keys = part.keys if isinstance(part, Stream) else part
        if not isinstance(keys, dict):
            continue
        for key in set(_FORBIDDEN.split()) & set(keys):
            yield f"6.1 to 6.5: key {key}"
        if keys.get("Filter") not in (None, "FlateDecode", "DCTDecode"):
            yield f"6.1.7.2: filter {keys['Filter']}"
        if keys.get("Interpolate"):
            yield "6.2.8.1: interpolated picture"
        if f" {keys.get('BM', 'Normal')} " not in _BLEND_MODES:
            yield f"6.2.10: blend mode {keys['BM']}"
        if keys.get("Type") == "Action" or keys.get("Type") == "Annot":
            yield f"6.3, 6.5: {keys['Type']}"


def _page(file: File, page: dict[str, Any], used: dict[int, set[int]]) -> list[str]:
    faults = []
    left, low, right, top = page["MediaBox"]
    if not all(3 <= side <= 14400 for side in (right - left, top - low)):
        faults.append("6.1.13: size of a page")
    if file.get(page.get("Annots")):
        faults.append("6.3: annotations")
    if "Resources" not in page:
        return [*faults, "6.2.2: page without resources of its own"]
    content = file.get(page["Contents"]).content
    return faults + _contents(file, content, file.get(page["Resources"]), used)


def _contents(
    file: File, content: bytes, resources: dict[str, Any], used: dict[int, set[int]]
) -> list[str]:
    """Return faults of a content stream; collect the letters of each font."""
    faults, operands, depth, font = [], [], 0, None
    kinds = {"Do": "XObject", "gs": "ExtGState", "Tf": "Font"}
    for token in Tokens(content).all():
        if not isinstance(token, Operator):
            operands.append(token)
            continue
        if f" {token.text} " not in _OPERATORS:
            faults.append(f"6.2.2: operator {token.text}")
        depth += (token.text == "q") - (token.text == "Q")
        if depth > 28:
            faults.append("6.1.13: more than 28 nested graphics states")
        if token.text in kinds:
            known = file.get(resources.get(kinds[token.text], {}))
            if operands[0] not in known:
                faults.append(f"6.2.2: resource {operands[0]} is missing")
            elif token.text == "Tf":
                font = known[operands[0]].number
            elif token.text == "Do":
                form = file.get(known[operands[0]])
                if form.keys.get("Subtype") == "Form":
                    inner = file.get(form.keys.get("Resources", resources))
                    faults += _contents(file, form.content, inner, used)
        if token.text in ("Tj", "TJ"):
            parts = operands[0] if token.text == "TJ" else operands
            text = b"".join(part for part in parts if isinstance(part, bytes))
            used.setdefault(font, set()).update(
                int.from_bytes(text[at : at + 2], "big")
                for at in range(0, len(text), 2)
            )
        operands = []
    return faults


def _font(file: File, font: dict[str, Any], codes: set[int]) -> list[str]:
    """Return faults of an embedded TrueType font, and of the letters it shows."""
    name = font.get("BaseFont")
    if (font.get("Subtype"), font.get("Encoding")) != ("Type0", "Identity-H"):
        return [f"font {name}: {font.get('Subtype')} in place of TrueType"]
    inner = file.get(file.get(font["DescendantFonts"])[0])
    program = file.get(file.get(inner["FontDescriptor"]).get("FontFile2"))
    table = file.get(inner.get("CIDToGIDMap"))
    if not isinstance(program, Stream):
        return [f"6.2.11.4.1: font {name} is not embedded"]
    if not isinstance(table, Stream):
        return [f"6.2.11.3.2: font {name} without a map of its letters"]
    glyphs = table.content
    letters = TTFont(io.BytesIO(program.content))
    metrics, order = letters["hmtx"].metrics, letters.getGlyphOrder()
    unit = letters["head"].unitsPerEm / 1000
    widths = _widths(file.get(inner["W"]))
    faults = []
    for code in sorted(codes):
        glyph = int.from_bytes(glyphs[2 * code : 2 * code + 2], "big")
        if not 0 < glyph < len(order):
            faults.append(f"6.2.11.8: font {name} lacks letter {code}")
            continue
        stated = widths.get(code, inner.get("DW", 1000.0))
        if abs(stated - metrics[order[glyph]][0] / unit) > 1.0:
            faults.append(f"6.2.11.5: font {name}, width of letter {code}")
    return faults


def _widths(items: list[Any]) -> dict[int, float]:
    """Return the width by code, from an array as in ISO 32000-1, 9.7.4.3."""
    widths: dict[int, float] = {}
    at = 0
    while at < len(items):
        first, second = int(items[at]), items[at + 1]
        if isinstance(second, list):
            widths |= {first + number: width for number, width in enumerate(second)}
            at += 2
        else:
            widths |= dict.fromkeys(range(first, int(second) + 1), items[at + 2])
            at += 3
    return widths
