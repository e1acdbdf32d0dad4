"""`amulor explain`: what a flag or a message means, and what to do."""

from __future__ import annotations

import shutil
import textwrap
from typing import Annotated

from cyclopts import Parameter


def explain(*words: str, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """Say what a flag or a message means, and what to do.

    Parameters
    ----------
    words
        Name of a flag, such as WATER_RESIDUAL, or a message as it was printed; without
        any, all names.
    json
        For other programs.
    """
    from dataclasses import asdict

    from amulor.cli._output import print_json
    from amulor.view import explanations

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
    width = min(shutil.get_terminal_size().columns, 100)
    for one in found:
        print(f"{one.name} ({one.kind})")
        for line in explanations.lines_of(one):
            print(textwrap.fill(line, width, subsequent_indent=" " * 12))
