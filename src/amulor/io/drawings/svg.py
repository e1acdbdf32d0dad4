"""Writes line drawings as SVG files at a stated scale, to be printed as they are."""

from __future__ import annotations

import os
import textwrap
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.drawings.lines import Drawing, checked, sides
from amulor.io.files import atomic_output

Floats = NDArray[np.float64]

# Colours of Okabe and Ito, a layer each; sizes on paper [mm].
_COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7")
_MARGIN, _LETTERS, _THICK = 15.0, 2.6, 0.25
#: Letters of a line of statements: the width of a page [1].
_LINE = 105
#: Longest sheet that is still printed [mm].
_LONGEST = 5000.0


def write_svg(
    drawing: Drawing,
    path: str | os.PathLike[str],
    *,
    scale: float,
    overwrite: bool = False,
) -> None:
    """Write a line drawing to an SVG file whose millimetres are those of the paper.

    Parameters
    ----------
    drawing : Drawing
        Its lines.
    path : path-like
        File to make, by custom with the suffix `.svg`.
    scale : float
        Metres of the object to one of the paper; 20 for 1:20 [1].
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If there is no line, if the sheet would be too long, if the file exists and
        `overwrite` is not set, or if it cannot be written.
    """
    drawing = checked(drawing, name=str(path))
    left, right, low, high = drawing.limits
    to_paper = 1000.0 / scale
    notes = [
        line
        for statement in (
            f"{drawing.axes[0]} {left:.3f} to {right:.3f} m, "
            f"{drawing.axes[1]} {low:.3f} to {high:.3f} m",
            *drawing.statements,
        )
        for line in textwrap.wrap(statement, _LINE, subsequent_indent="\u2003")
    ]
    widest = max(map(len, (drawing.title, *notes))) * _LETTERS * 0.55
    bar = bar_length(right - left, scale)
    width = max((right - left) * to_paper, bar * to_paper, widest) + 2 * _MARGIN
    written = (4 + len(notes)) * 1.5 * _LETTERS
    height = (high - low) * to_paper + 2 * _MARGIN + written + 12
    if max(width, height) > _LONGEST:
        raise FormatError(
            f"{path}: at 1:{scale:g} the sheet would be {max(width, height) / 1e3:.1f} "
            f"m long; take a smaller scale, such as 1:{scale * 10:g}"
        )

    def placed(points: Floats) -> str:
        x = (points[:, 0] - left) * to_paper + _MARGIN
        y = (high - points[:, 1]) * to_paper + _MARGIN
        return " ".join(f"{a:.3f},{b:.3f}" for a, b in zip(x, y, strict=True))

    body = []
    for line in drawing.lines:
        outline = sides(line)
        if outline is not None:
            body.append(
                f'<polygon class="uncertainty" points="{placed(outline)}" '
                'fill="#56B4E9" fill-opacity="0.35" stroke="none"/>'
            )
    for number, layer in enumerate(drawing.layers):
        colour = _COLOURS[number % len(_COLOURS)]
        body.append(
            f'<g id="{escape(layer)}" fill="none" stroke="{colour}" '
            f'stroke-width="{_THICK}" stroke-linejoin="round">'
        )
        for line in (line for line in drawing.lines if line.layer == layer):
            title = f"<title>{escape(line.label)}</title>" if line.label else ""
            body.append(f'<polyline points="{placed(line.points)}">{title}</polyline>')
        body.append("</g>")
    below = (high - low) * to_paper + _MARGIN + 8
    body += _scale_bar(bar, to_paper, below, scale)
    body.append(_text(drawing.title, below + 12, bold=True))
    body += [
        _text(text, below + 12 + (number + 1) * 1.5 * _LETTERS)
        for number, text in enumerate(notes)
    ]
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" '
            f'height="{height:.3f}mm" viewBox="0 0 {width:.3f} {height:.3f}" '
            'font-family="DejaVu Sans, Arial, sans-serif">\n'
            f"<title>{escape(drawing.title)}</title>\n"
            f'<rect width="100%" height="100%" fill="#ffffff"/>\n'
            + "\n".join(body)
            + "\n</svg>\n",
            encoding="utf-8",
        )


def bar_length(extent: float, scale: float) -> float:
    """Return a round length for a scale bar.

    Parameters
    ----------
    extent : float
        Width of what is drawn [m].
    scale : float
        Metres of the object to one of the paper [1].

    Returns
    -------
    float
        1, 2 or 5 times a power of ten: at most half of the extent, but at least 20 mm
        on paper [m].
    """
    wanted = max(0.5 * extent, 0.02 * scale)
    power = 10.0 ** np.floor(np.log10(wanted))
    fitting = [step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted]
    return float(fitting[-1])


def _scale_bar(length: float, to_paper: float, y: float, scale: float) -> list[str]:
    size = length * to_paper
    parts = [
        f'<rect x="{_MARGIN + n * size / 4:.3f}" y="{y:.3f}" width="{size / 4:.3f}" '
        f'height="1.6" fill="{"#000000" if n % 2 == 0 else "#ffffff"}" '
        f'stroke="#000000" stroke-width="0.15"/>'
        for n in range(4)
    ]
    label = f"{length * 1e3:g} mm" if length < 1 else f"{length:g} m"
    return [
        '<g id="scale-bar">',
        *parts,
        f'<text x="{_MARGIN:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}">0</text>',
        f'<text x="{_MARGIN + size:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}" '
        f'text-anchor="middle">{label}</text>',
        f'<text x="{_MARGIN + size / 2:.3f}" y="{y + 5:.3f}" font-size="{_LETTERS}" '
        f'text-anchor="middle">1:{scale:g}</text>',
        "</g>",
    ]


def _text(text: str, y: float, *, bold: bool = False) -> str:
    weight = ' font-weight="bold"' if bold else ""
    return (
        f'<text x="{_MARGIN}" y="{y:.3f}" font-size="{_LETTERS}"{weight}>'
        f"{escape(text)}</text>"
    )
