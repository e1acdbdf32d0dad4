"""Self-contained HTML report: text, tables and pictures in one file."""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from amulor.io.files import atomic_output
from amulor.view.style import style


@dataclass(frozen=True)
class Paragraph:
    """Paragraph of a report.

    Examples
    --------
    >>> from amulor import view
    >>> view.Paragraph("Recorded in the tank, milk 1:10,000.").text
    'Recorded in the tank, milk 1:10,000.'
    """

    text: str
    """Plain text."""


@dataclass(frozen=True)
class Heading:
    """Section title of a report.

    Examples
    --------
    >>> from amulor import view
    >>> view.Heading("Plate at 1.5 m").text
    'Plate at 1.5 m'
    """

    text: str
    """Plain text."""
    new_page: bool = False
    """Whether the section begins a page on paper."""


@dataclass(frozen=True)
class Picture:
    """Figure of a report, with its caption.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from amulor import view
    >>> view.Picture(Figure(figsize=(4, 3)), caption="Before and after.").caption
    'Before and after.'
    """

    figure: Figure
    """Figure."""
    caption: str
    """Caption of one or two sentences."""


@dataclass(frozen=True)
class Table:
    """Table of a report: rows of text under a header.

    Examples
    --------
    >>> from amulor import view
    >>> table = view.Table(
    ...     ["method", "error"], [["open-water", "0.3 mm"], ["none", "!48 mm"]], "Error"
    ... )
    >>> len(table.rows)
    2
    """

    header: Sequence[str]
    """Column titles."""
    rows: Sequence[Sequence[str]]
    """Cells; one that starts with "!" is marked as a warning."""
    caption: str
    """Caption."""


@dataclass(frozen=True)
class Listing:
    """Preformatted text of a report, folded until opened.

    Examples
    --------
    >>> from amulor import samples, view
    >>> view.Listing("Survey", samples.cube("ladder").attrs["survey"]).text[:30]
    'name = "Ladder in milky water"'
    """

    title: str
    """Title."""
    text: str
    """Text."""


@dataclass(frozen=True)
class Interactive:
    """Interactive page inside a report, replaced by a picture on paper.

    Examples
    --------
    >>> from amulor import view
    >>> view.Interactive("Range image", page="<!doctype html><p>a page</p>").title
    'Range image'
    """

    title: str
    """Title."""
    page: str
    """HTML, as from `amulor.view.page.saved_page`."""


Part = Heading | Paragraph | Picture | Table | Listing | Interactive


def write_report(
    path: str | Path, title: str, parts: Sequence[Part], *, overwrite: bool = False
) -> None:
    """Write a report as one self-contained HTML file.

    Parameters
    ----------
    path : str or pathlib.Path
        File to write.
    title : str
        Title of the report.
    parts : sequence
        Headings, paragraphs, pictures, tables and listings, in order.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    FormatError
        If the file exists, or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from amulor import view
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "report.html"
    ...     view.write_report(path, "Tank", [view.Paragraph("Flat.")])
    ...     path.read_text().splitlines()[0]
    '<!DOCTYPE html>'
    """
    body = "\n".join(_rendered(part) for part in parts)
    page = _PAGE.format(title=html.escape(title), style=_STYLE, body=body)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8")


def png(figure: Figure, *, dots_per_inch: int = 160) -> bytes:
    """Content of a PNG file with a figure."""
    buffer = io.BytesIO()
    with style():
        figure.savefig(
            buffer, format="png", dpi=dots_per_inch, metadata={"Software": None}
        )
    return buffer.getvalue()


def _rendered(part: Part) -> str:
    if isinstance(part, Heading):
        mark = ' class="page"' if part.new_page else ""
        return f"<h2{mark}>{html.escape(part.text)}</h2>"
    if isinstance(part, Paragraph):
        return f"<p>{html.escape(part.text)}</p>"
    if isinstance(part, Picture):
        caption = html.escape(part.caption)
        data = base64.b64encode(png(part.figure)).decode()
        width = int(part.figure.get_figwidth() * 120)
        return (
            f'<figure><img alt="{caption}" width="{width}" '
            f'src="data:image/png;base64,{data}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Interactive):
        # Isolated from the report: its scripts have no access outside their frame.
        return (
            f'<figure class="interactive"><iframe title="{html.escape(part.title)}" '
            'sandbox="allow-scripts allow-downloads" loading="lazy" '
            f'srcdoc="{html.escape(part.page, quote=True)}"></iframe>'
            f"<figcaption>{html.escape(part.title)}</figcaption></figure>"
        )
    return (
        f"<details><summary>{html.escape(part.title)}</summary>"
        f"<pre>{html.escape(part.text)}</pre></details>"
    )


def _table(table: Table) -> str:
    words = [_is_text(column) for column in zip(*table.rows, strict=True)]
    head = "".join(
        f"<th{_class('', text)}>{html.escape(cell)}</th>"
        for cell, text in zip(
            table.header, words or [False] * len(table.header), strict=True
        )
    )
    lines = []
    for row in table.rows:
        cells = "".join(
            f"<td{_class('warning' if cell[:1] == '!' else '', text)}>"
            f"{html.escape(cell.removeprefix('!'))}</td>"
            for cell, text in zip(row, words, strict=True)
        )
        lines.append(f"<tr>{cells}</tr>")
    return (
        '<div class="table"><table>'
        f"<caption>{html.escape(table.caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _is_text(column: Sequence[str]) -> bool:
    """Whether a table column contains words, which are aligned left."""
    return any(re.match(r"!?[^\W\d]{3}", cell) for cell in column) and not any(
        re.match(r"!?[-+]?\d", cell) for cell in column
    )


def _class(mark: str, text: bool | str) -> str:
    names = " ".join(name for name in (mark, "text" if text is True else "") if name)
    return f' class="{names}"' if names else ""


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
<h1>{title}</h1>
{body}
</main>
</body>
</html>
"""

_STYLE = """
:root { color-scheme: light; --ink: #1b2a33; --soft: #5d6f79; --line: #d8e0e4; }
body { margin: 0; background: #f4f7f8; color: var(--ink);
  font: 16px/1.55 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2rem 1.5rem 4rem; background: #fff;
  box-shadow: 0 0 24px rgba(0, 40, 60, .08); }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1rem;
  border-bottom: 3px solid #0072b2; padding-bottom: .6rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
p { max-width: 46rem; }
figure { margin: 1.2rem 0; }
img { max-width: 100%; height: auto; }
figcaption, caption { color: var(--soft); font-size: .87rem; text-align: left;
  padding: .3rem 0 .5rem; max-width: 52rem; }
.table { overflow-x: auto; }
/* A caption stays in view where its table is wider than the page. */
caption { position: sticky; left: 0; width: min(52rem, calc(100vw - 3rem));
  box-sizing: border-box; }
table { border-collapse: collapse; font-size: .87rem; margin: 1rem 0;
  font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .3rem .7rem; border-bottom: 1px solid var(--line);
  white-space: nowrap; }
th { white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child, .text { text-align: left; }
thead th { border-bottom: 2px solid var(--ink); font-weight: 600; }
.interactive iframe { width: 100%; height: 30rem; border: 1px solid var(--line);
  border-radius: 8px; }
@page { size: A4; margin: 16mm 14mm 18mm; }
@page { @bottom-right { content: counter(page) " / " counter(pages);
  font: 8pt sans-serif; color: #5d6f79; } }
@media print {
  .interactive { display: none; }
  body { background: #fff; font-size: 10pt; }
  main { max-width: none; margin: 0; padding: 0; box-shadow: none; }
  p, figcaption, caption { max-width: none; orphans: 3; widows: 3; }
  h1 { font-size: 16pt; }
  h2 { font-size: 12pt; margin-top: 1.4rem; break-after: avoid; }
  h2.page { break-before: page; }
  figure, .table { break-inside: avoid; }
  /* A picture leaves room for a title and a caption on its page. */
  img { max-height: 195mm; width: auto; }
  thead { display: table-header-group; }
  tr { break-inside: avoid; }
  .table { overflow: visible; }
  table { font-size: 8pt; width: 100%; }
  th, td { white-space: normal; padding: .2rem .35rem; vertical-align: top; }
  details { display: block; border: 0; padding: 0; }
  details:not([open])::details-content { content-visibility: visible; display: block; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: 7pt; }
}
.warning { color: #b03a00; font-weight: 600; }
details { margin: .6rem 0; border: 1px solid var(--line); border-radius: 6px;
  padding: .4rem .8rem; }
summary { cursor: pointer; font-weight: 600; }
pre { overflow-x: auto; font-size: .78rem; line-height: 1.4; }
"""
