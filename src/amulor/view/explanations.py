"""What flags and warnings mean: what is compared, how often by chance, what to do."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from amulor.cube import DOUBTFUL, ERROR_UNKNOWN, UNUSABLE, QualityFlag
from amulor.cube.schema import TERMS, flag_words
from amulor.errors import FormatError

#: Kinds of names, by the tables of amulor/cube/flags.toml.
_KINDS = {
    "pixel": "pixel flag",
    "cause": "water residual cause",
    "sample": "sample flag",
    "warning": "warning",
}


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """What a flag, a warning or a term of the error budget means."""

    name: str
    """As files, pages and messages name it, in capitals with underscores."""
    kind: str
    """Where it is met."""
    meaning: str
    """What it says."""
    compared: str
    """What is compared with what, and the limit."""
    chance: str
    """How often chance alone does it, where that is known."""
    consequence: str
    """What becomes of the range, or of the sample."""
    remedy: str
    """What to do."""


def explanations() -> dict[str, Explanation]:
    """Return all explanations by their names, pixel flags first."""
    limits, texts = _limits(), ("meaning", "compared", "chance", "remedy")
    found = {
        name: Explanation(
            name=name,
            kind=kind,
            consequence=words.get("consequence") or _consequence(table, name),
            **{text: words.get(text, "").format_map(limits) for text in texts},
        )
        for table, kind in _KINDS.items()
        for name, words in flag_words()[table].items()
    }
    return found | {one.name: one for one in _terms()}


def find(words: str) -> list[Explanation]:
    """Return the explanations that a name or a message asks for, the best first."""
    known = explanations()
    plain = re.sub(r"[^a-z]+", "_", words.lower()).strip("_")
    if plain.upper() in known:
        return [known[plain.upper()]]
    # Messages first: they name other things on their way.
    found = [
        known[name]
        for table in ("warning", "pixel")
        for name, words in flag_words()[table].items()
        if "message" in words and re.search(words["message"], plain)
    ]
    if not found:
        padded = f"_{plain}_"
        found = [one for name, one in known.items() if f"_{name.lower()}_" in padded]
    if not found:
        close = difflib.get_close_matches(plain, [name.lower() for name in known], 1)
        found = [known[name.upper()] for name in close]
    if not found:
        raise FormatError(
            f"nothing is known of {words[:60]!r}; there are {', '.join(known)}"
        )
    return found


def _limits() -> dict[str, Any]:
    """Return the limits and shares by chance that the words name in braces."""
    from amulor.imaging import edges, outliers
    from amulor.optics import ambiguity
    from amulor.rejection import quality, subtraction
    from amulor.rejection.joint import cube as joint
    from amulor.rejection.reference import before_target
    from amulor.view.page import progress

    mixed = default_of(edges.flag_mixed, "significance")
    alone = default_of(outliers.flag_outliers, "significance")
    share = SimpleNamespace(
        no_target=_share(math.exp(-(quality.DETECTION_THRESHOLD**2) / 2)),
        disagreement=_share(ambiguity.DISAGREEMENT),
        misfit=_share(joint.DISAGREEMENT),
        mixed=_share(_tail(mixed)),
        alone=_share(_tail(alone)),
        drift=_share(progress.CHANCE),
    )
    return {
        "quality": quality,
        "subtraction": subtraction,
        "before_target": before_target,
        "ambiguity": ambiguity,
        "joint": joint,
        "outliers": outliers,
        "progress": progress,
        "mixed": mixed,
        "alone": alone,
        "share": share,
    }


def _consequence(table: str, name: str) -> str:
    """Return what becomes of a pixel or sample with a flag."""
    if table == "sample":
        from amulor.acquisition.sampler import SPOILED, SampleFlag

        spoiled = "is not used; amulor acquire --resume --retake-flagged repeats it"
        return f"The sample {spoiled if SampleFlag[name] & SPOILED else 'is used'}."
    flag = QualityFlag.WATER_RESIDUAL if table == "cause" else QualityFlag[name]
    if flag & UNUSABLE:
        return "The pixel has no range."
    if flag & ERROR_UNKNOWN:
        return (
            "All pixels keep their ranges, but their errors are unknown. No file has "
            "an uncertainty, and all pixels count as doubtful."
        )
    assert flag & DOUBTFUL, flag
    return "The pixel keeps its range, but the range is doubtful."


def _terms() -> list[Explanation]:
    types = {
        "A": "Type A: from repeated measurements.",
        "B": "Type B: stated, or computed from stated values.",
        "A, B": "Type A and B: from repeated measurements and from stated values.",
    }
    return [
        Explanation(
            name=f"TERM_{name.upper()}",
            kind="error term",
            meaning=f"{term.meaning[0].upper()}{term.meaning[1:]}.",
            compared=types[term.kind],
            chance="",
            consequence="A part of the standard uncertainty of the range.",
            remedy="amulor info FILE and amulor report print its size.",
        )
        for name, term in TERMS.items()
    ]


def lines_of(one: Explanation) -> list[str]:
    """Return an explanation as lines of text."""
    parts: Iterable[tuple[str, str]] = (
        ("means", one.meaning),
        ("test", one.compared),
        ("by chance", one.chance),
        ("effect", one.consequence),
        ("what to do", one.remedy),
    )
    return [f"{label:>10}: {text}" for label, text in parts if text]


def hint(names: Iterable[str]) -> str:
    """Return how to ask for the meaning of flags, for a message."""
    first = next(iter(names), "")
    name = first.upper().replace(" ", "_")
    return f"amulor explain {name}" if name else ""


def default_of(function: object, name: str) -> float:
    """Return the default of an argument, which is a limit."""
    value = inspect.signature(function).parameters[name].default  # type: ignore[arg-type]
    return float(value)


def _tail(sigma: float) -> float:
    """Return how often a normal error is larger than so many standard deviations."""
    return 0.5 * math.erfc(sigma / math.sqrt(2))


def _share(share: float) -> str:
    """Return a small share in words that go before what it is a share of."""
    if share >= 1e-3:
        return f"{share * 100:.2g} % of the"
    return f"1 of {float(f'{1 / share:.2g}'):,.0f}"
