"""PDF files of drawing sheets for archives, marked as PDF/A-2b (ISO 19005-2)."""

from __future__ import annotations

import hashlib
import io
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.view.style import style

_PRODUCER = "amulor, with Matplotlib"
#: Properties of the XMP packet by key of the document information.
_PROPERTIES = {
    "Title": "<dc:title><rdf:Alt><rdf:li xml:lang='x-default'>{}</rdf:li></rdf:Alt>"
    "</dc:title>",
    "Author": "<dc:creator><rdf:Seq><rdf:li>{}</rdf:li></rdf:Seq></dc:creator>",
    "Subject": "<dc:description><rdf:Alt><rdf:li xml:lang='x-default'>{}</rdf:li>"
    "</rdf:Alt></dc:description>",
    "Creator": "<xmp:CreatorTool>{}</xmp:CreatorTool>",
    "Producer": "<pdf:Producer>{}</pdf:Producer>",
}
_PACKET = (
    "<?xpacket begin='\ufeff' id='W5M0MpCehiHzreSzNTczkc9d'?>\n"
    "<x:xmpmeta xmlns:x='adobe:ns:meta/'>"
    "<rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>"
    "<rdf:Description rdf:about='' xmlns:dc='http://purl.org/dc/elements/1.1/' "
    "xmlns:xmp='http://ns.adobe.com/xap/1.0/' xmlns:pdf='http://ns.adobe.com/pdf/1.3/' "
    "xmlns:pdfaid='http://www.aiim.org/pdfa/ns/id/'>"
    "<pdfaid:part>2</pdfaid:part><pdfaid:conformance>B</pdfaid:conformance>{}"
    "</rdf:Description></rdf:RDF></x:xmpmeta>\n"
    "<?xpacket end='w'?>"
)


def write_pdf(
    figures: Sequence[Figure],
    path: str | Path,
    *,
    title: str,
    author: str = "",
    subject: str = "",
    overwrite: bool = False,
) -> None:
    """Write figures as the pages of one PDF file with embedded TrueType fonts.

    Parameters
    ----------
    figures : sequence of matplotlib.figure.Figure
        Pages, at their size on paper.
    path : str or pathlib.Path
        File to write.
    title, author, subject : str
        Texts of the document information and of the XMP metadata.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    FormatError
        If the file exists, or cannot be written.

    Notes
    -----
    matplotlib writes the pages. An incremental update appends what PDF/A-2b needs in
    addition: XMP metadata, an sRGB output intent, and a file identifier. The file has
    no date, so that equal drawings give equal files. It has no tags: levels A and U of
    PDF/A, and PDF/UA, are not reached.
    """
    texts = {"Title": title, "Author": author, "Subject": subject}
    about = {key: text for key, text in texts.items() if text}
    about |= {"Creator": "amulor", "Producer": _PRODUCER}
    buffer = io.BytesIO()
    with style(), PdfPages(buffer, metadata={**about, "CreationDate": None}) as pages:
        for figure in figures:
            pages.savefig(figure, dpi=300)
    content = _archival(_marked_binary(buffer.getvalue()), about)
    with atomic_output(path, overwrite=overwrite) as temporary:
        temporary.write_bytes(content)


def _marked_binary(content: bytes) -> bytes:
    """Content with a second line of bytes above 127 only, which PDF/A requires.

    The comment of matplotlib contains a space.
    """
    head, comment, rest = content.split(b"\n", 2)
    return b"\n".join([head, comment.replace(b" ", b"\xa0"), rest])


def _archival(content: bytes, about: dict[str, str]) -> bytes:
    """Content of a PDF file with metadata, output intent and identifier appended."""
    trailer = content.rpartition(b"trailer")[2]
    matches = [
        re.search(pattern, trailer)
        for pattern in (rb"/Root (\d+) 0 R", rb"/Info (\d+) 0 R", rb"/Size (\d+)")
    ]
    start = re.search(rb"startxref\s+(\d+)", trailer)
    if start is None or not all(matches):
        raise FormatError("matplotlib wrote a PDF file without a plain trailer")
    root, info, size = (int(match[1]) for match in matches if match)
    pattern = rb"\n%d 0 obj\s*<<(.*?)>>\s*endobj" % root
    catalogue = re.search(pattern, content, re.DOTALL)
    if catalogue is None:
        raise FormatError("matplotlib wrote a PDF file without a catalog")
    packet = _PACKET.format(
        "".join(_PROPERTIES[key].format(escape(text)) for key, text in about.items())
    )
    metadata, intent, profile = size, size + 1, size + 2
    objects = {
        root: b"<<%s /Metadata %d 0 R /OutputIntents [%d 0 R]>>"
        % (catalogue[1].rstrip(), metadata, intent),
        # XMP stays readable as text: it is not compressed.
        metadata: _stream(b"/Type /Metadata /Subtype /XML", packet.encode()),
        intent: b"<</Type /OutputIntent /S /GTS_PDFA1 "
        b"/OutputConditionIdentifier (sRGB) /Info (sRGB) "
        b"/DestOutputProfile %d 0 R>>" % profile,
        profile: _stream(b"/N 3", _colours()),
    }
    parts, places, length = [content], {}, len(content)
    for number, text in sorted(objects.items()):
        places[number] = length
        parts.append(b"%d 0 obj\n%s\nendobj\n" % (number, text))
        length += len(parts[-1])
    parts.append(b"xref\n")
    for number, place in places.items():
        parts.append(b"%d 1\n%010d 00000 n \n" % (number, place))
    name = hashlib.sha256(content).hexdigest()[:32].encode()
    parts.append(
        b"trailer\n<</Size %d /Root %d 0 R /Info %d 0 R /Prev %d /ID [<%s> <%s>]>>\n"
        b"startxref\n%d\n%%%%EOF\n"
        % (size + 3, root, info, int(start[1]), name, name, length)
    )
    return b"".join(parts)


def _stream(keys: bytes, content: bytes) -> bytes:
    """PDF stream object with its dictionary."""
    return b"<<%s /Length %d>>\nstream\n%s\nendstream" % (keys, len(content), content)


def _colours() -> bytes:
    """ICC profile of the sRGB color space."""
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # Six numbers of two bytes from byte 24 on: the time at which it was made.
    return profile[:24] + struct.pack(">6H", 2000, 1, 1, 0, 0, 0) + profile[36:]
