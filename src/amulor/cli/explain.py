"""`amulor explain`: meaning of flags and messages, numbers behind those of a pixel."""

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
    """Say what a flag or a message means, or why a pixel of a file is flagged.

    Parameters
    ----------
    words
        Name of a flag, such as WATER_RESIDUAL, or a message as it was printed; without
        any, all names. With --pixel, a target signal or a range image.
    pixel
        Row and column of a pixel of the file, both from 0, such as 20,50: prints its
        flags, and the numbers behind each with their limits.
    json
        For other programs.
    """
    from dataclasses import asdict

    from amulor.cli._output import print_json
    from amulor.view import explanations

    if pixel is not None:
        _explain_pixel(words, pixel, json=json)
        return
    if not words:
        known = explanations.explanations()
        if json:
            print_json({name: asdict(one) for name, one in known.items()})
            return
        width = max(map(len, known)) + 2
        kind = ""
        for name, one in known.items():
            if one.kind != kind:
                kind = one.kind
                print(f"{kind}s")
            print(f"  {name:<{width}}{one.meaning}")
        return
    found = explanations.find(" ".join(words))
    if json:
        print_json({one.name: asdict(one) for one in found})
        return
    for one in found:
        print(f"{one.name} ({one.kind})")
        for line in explanations.lines_of(one):
            print(textwrap.fill(line, _width(), subsequent_indent=" " * 12))


def _explain_pixel(words: tuple[str, ...], pixel: str, *, json: bool) -> None:
    """Print the flags of a pixel, channel by channel, with the numbers behind each."""
    from dataclasses import asdict

    from amulor.cli._arguments import check_inputs
    from amulor.cli._output import print_json, print_table
    from amulor.view import explanations
    from amulor.view.pixel import reasons

    if len(words) != 1:
        raise FormatError(
            f"--pixel needs one file before it, got {len(words)}; for example: amulor "
            "explain range.nc --pixel 20,50"
        )
    try:
        row, column = (int(part) for part in pixel.split(","))
    except ValueError:
        raise FormatError(
            f"--pixel: {pixel!r} is no row and column; state two whole numbers with a "
            "comma between them, such as 20,50"
        ) from None
    path = Path(words[0])
    check_inputs(path)
    found = reasons(path, row, column)
    known = explanations.explanations()
    flagged = dict.fromkeys(
        one.cause or one.flag for each in found.values() for one in each
    )
    if json:
        remedies = {name: known[name].remedy for name in flagged}
        channels = {name: [asdict(one) for one in each] for name, each in found.items()}
        print_json(
            {"row": row, "column": column, "channels": channels, "to_do": remedies}
        )
        return
    print(f"{path}: row {row}, column {column}")
    for channel, each in found.items():
        if not each:
            print(f"channel {channel}: no flags")
            continue
        print_table(
            f"channel {channel}",
            ("flag", "MHz", "quantity", "value", "flagged if", "unit"),
            [
                (
                    f"{one.flag} ({one.cause})" if one.cause else one.flag,
                    ", ".join(f"{f / 1e6:g}" for f in one.modulation_frequencies)
                    or "all",
                    one.quantity,
                    "" if one.value is None else f"{one.value:.3g}",
                    one.limit,
                    "" if one.value is None else one.unit,
                )
                for one in each
            ],
        )
    for name in flagged:
        text = f"{name}, what to do: {known[name].remedy}"
        print(textwrap.fill(text, _width(), subsequent_indent="  "))


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)
