"""`amulor explain`: meaning of flags and messages, and why a pixel is flagged."""

from __future__ import annotations

import shutil
import textwrap
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.errors import FormatError


def explain(
    *words: str,
    pixel: str | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Explain a flag, a message, or the flags of one pixel of a file.

    Parameters
    ----------
    words
        Name of a flag, such as WATER_RESIDUAL, or a message as printed. By default all
        names are listed. With --pixel: file with a target signal or a range image.
    pixel
        Row and column of a pixel, both from 0, such as 20,50. Prints its flags, with
        the measured values and their limits.
    json
        Print the explanation as JSON.
    """
    from dataclasses import asdict

    from amulor.cli._output import print_json
    from amulor.view import explanations

    if pixel is not None:
        _explain_pixel(words, pixel, json=json)
        return
    if not words:
        texts = explanations.explanations()
        if json:
            print_json({name: asdict(text) for name, text in texts.items()})
            return
        width = max(map(len, texts)) + 2
        kind = ""
        for name, text in texts.items():
            if text.kind != kind:
                kind = text.kind
                print(f"{kind}s")
            print(f"  {name:<{width}}{text.meaning}")
        return
    matches = explanations.find(" ".join(words))
    if json:
        print_json({text.name: asdict(text) for text in matches})
        return
    for text in matches:
        print(f"{text.name} ({text.kind})")
        for line in explanations.lines_of(text):
            print(textwrap.fill(line, _width(), subsequent_indent=" " * 12))


def _explain_pixel(words: tuple[str, ...], pixel: str, *, json: bool) -> None:
    """Print the flags of a pixel by channel, with the numbers behind each flag."""
    from dataclasses import asdict

    from amulor.cli._arguments import check_inputs, row_and_column
    from amulor.cli._output import print_json, print_table
    from amulor.view import explanations
    from amulor.view.explanations import reasons

    if len(words) != 1:
        raise FormatError(
            f"--pixel needs one file before it, got {len(words)}; for example: amulor "
            "explain range.nc --pixel 20,50"
        )
    row, column = row_and_column(pixel, error=FormatError)
    path = Path(words[0])
    check_inputs(path)
    flags = reasons(path, row, column)
    texts = explanations.explanations()
    flagged = dict.fromkeys(
        reason.cause or reason.flag
        for reasons_here in flags.values()
        for reason in reasons_here
    )
    if json:
        remedies = {name: texts[name].remedy for name in flagged}
        channels = {
            name: [asdict(reason) for reason in reasons_here]
            for name, reasons_here in flags.items()
        }
        print_json(
            {"row": row, "column": column, "channels": channels, "to_do": remedies}
        )
        return
    print(f"{path}: row {row}, column {column}")
    for channel, reasons_here in flags.items():
        if not reasons_here:
            print(f"channel {channel}: no flags")
            continue
        print_table(
            f"channel {channel}",
            ("flag", "MHz", "quantity", "value", "flagged if", "unit"),
            [
                (
                    f"{reason.flag} ({reason.cause})" if reason.cause else reason.flag,
                    ", ".join(f"{f / 1e6:g}" for f in reason.modulation_frequencies)
                    or "all",
                    reason.quantity,
                    "" if reason.value is None else f"{reason.value:.3g}",
                    reason.limit,
                    "" if reason.value is None else reason.unit,
                )
                for reason in reasons_here
            ],
        )
    for name in flagged:
        text = f"{name}, what to do: {texts[name].remedy}"
        print(textwrap.fill(text, _width(), subsequent_indent="  "))


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)
