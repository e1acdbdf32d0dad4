"""The update that turns a plain PDF file into one for archives, byte by byte."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from pdf_archive import archive_faults

from amulor.errors import FormatError
from amulor.view import pdf

PLAIN = (
    b"%PDF-1.4\n1 0 obj\n<< /Type /Catalog /Pages 2 0 R >>\nendobj\n"
    b"trailer\n<< /Size 7 /Root 1 0 R /Info 3 0 R >>\nstartxref\n45\n%%EOF\n"
)
ABOUT = {"Title": "A <b> & c", "Creator": "amulor"}


def test_three_objects_follow_those_of_the_file() -> None:
    found = pdf._archival(PLAIN, ABOUT)
    assert found.startswith(PLAIN)
    numbers = [
        int(n) for n in re.findall(rb"\n(\d+) 0 obj\n<<", found[len(PLAIN) - 1 :])
    ]
    assert numbers == [1, 7, 8, 9]
    assert (
        b"1 0 obj\n<< /Type /Catalog /Pages 2 0 R /Metadata 7 0 R "
        b"/OutputIntents [8 0 R]>>\nendobj\n" in found
    )
    assert b"/DestOutputProfile 9 0 R>>" in found
    assert b"<</N 3 /Length " in found
    trailer = found.rpartition(b"trailer")[2]
    assert b"<</Size 10 /Root 1 0 R /Info 3 0 R /Prev 45 /ID [<" in trailer
    first, second = re.findall(rb"<([0-9a-f]{32})>", trailer)
    assert first == second
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", found)[1])
    table = found[start:]
    assert table.startswith(b"xref\n")
    for number, place in re.findall(rb"(\d+) 1\n(\d{10}) 00000 n \n", table):
        assert found[int(place) :].startswith(number + b" 0 obj\n")
    assert b"<rdf:li xml:lang='x-default'>A &lt;b&gt; &amp; c</rdf:li>" in found
    assert b"<xmp:CreatorTool>amulor</xmp:CreatorTool>" in found
    assert b"dc:creator" not in found


def test_streams_state_their_length() -> None:
    assert pdf._stream(b"/N 3", b"12345") == (
        b"<</N 3 /Length 5>>\nstream\n12345\nendstream"
    )


def test_a_comment_of_bytes_follows_the_first_line() -> None:
    found = pdf._marked_binary(b"%PDF-1.4\n%\xac\xdc \xab\xba\nrest\nof it")
    assert found == b"%PDF-1.4\n%\xac\xdc\xa0\xab\xba\nrest\nof it"


def test_the_profile_of_colors_has_a_fixed_date() -> None:
    found = pdf._colours()
    assert struct.unpack(">6H", found[24:36]) == (2000, 1, 1, 0, 0, 0)
    # Size and signature of an ICC profile.
    assert struct.unpack(">I", found[:4]) == (len(found),)
    assert found[36:40] == b"acsp"
    assert found[16:20] == b"RGB "


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"%PDF\n", "a plain trailer"), (PLAIN.replace(b"/Info", b"/Other"), "a plain tr"),
     (PLAIN.replace(b"startxref", b"start"), "a plain trailer"),
     (PLAIN.replace(b"\n1 0 obj", b"\n4 0 obj"), "a catalog")],
)  # fmt: skip
def test_a_file_of_another_structure_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(
        FormatError, match=f"^matplotlib wrote a PDF file without {words}"
    ):
        pdf._archival(content, ABOUT)


def test_pages_keep_their_size_and_equal_files_are_equal(tmp_path: Path) -> None:
    path, other = tmp_path / "a.pdf", tmp_path / "b.pdf"
    figures = [Figure(figsize=(2, 1)), Figure(figsize=(1, 3))]
    for place in (path, other):
        pdf.write_pdf(figures, place, title="T", author="A", subject="S")
    content = path.read_bytes()
    assert content == other.read_bytes()
    boxes = re.findall(rb"/MediaBox \[ ?0 0 (\d+) (\d+) ?\]", content)
    assert boxes == [(b"144", b"72"), (b"72", b"216")]
    assert b"CreationDate" not in content
    assert archive_faults(path) == []
    for words in (b">T</rdf:li>", b"<rdf:li>A</rdf:li>", b">S</rdf:li>"):
        assert words in content
    with pytest.raises(FormatError, match="overwrite"):
        pdf.write_pdf(figures, path, title="T")
    pdf.write_pdf(figures[:1], path, title="T", overwrite=True)
    assert b"dc:creator" not in path.read_bytes()
