"""Draws the gallery of redrawn figures: runs the whole study, then writes its page.

Run with ``python docs/make_gallery.py``, which takes some minutes; with ``--page`` the
page is written again from the checks of the last run.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from amulor.studies.ricci2010 import reproduce
from amulor.studies.ricci2010.report import FOREWORD

DOCS = Path(__file__).parent
IMAGES = DOCS / "images" / "ricci2010"
CHECKS = IMAGES / "checks.json"
PAGE = DOCS / "gallery" / "ricci2010.md"
CODE = "../../src/amulor/studies/ricci2010"


def main() -> None:
    """Run the study unless asked not to, and write the page."""
    if "--page" not in sys.argv[1:]:
        results = reproduce.run(progress=lambda step, share: print(step, flush=True))
        IMAGES.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            for name in reproduce.write(Path(folder), results):
                if name not in ("report.html", "checks.json"):
                    shutil.copy(Path(folder) / name, IMAGES / name)
        found = results.plain()
        for entry in found["sensitivity"]:
            del entry["changes"]  # the page shows the flips only
        CHECKS.write_text(json.dumps(found, indent=1) + "\n")
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(json.loads(CHECKS.read_text())))


def page(study: dict[str, Any]) -> str:
    """Return the page that shows the figures and checks of a run.

    Parameters
    ----------
    study : dict
        What `checks.json` holds.

    Returns
    -------
    str
        Markdown.
    """
    every = [check for figure in study["figures"] for check in figure["checks"]]
    tests = [check for check in every if check["role"] == "test"]
    chosen = [check for check in every if check["role"] == "set"]
    parts = [
        "# The figures of Ricci et al. 2010, redrawn",
        "Made by `python docs/make_gallery.py`; `amulor reproduce ricci2010` makes the "
        "same figures, tables and a report in a folder of yours (`--figure 7` for one "
        "of them, `--quick` for a first look in less than a minute).",
        FOREWORD,
        f"Of {len(tests)} statements {sum(c['passed'] for c in tests)} hold; of "
        f"{len(chosen)} more, for which a number of the study was chosen, "
        f"{sum(c['passed'] for c in chosen)} hold. What fails is discussed "
        "[below](#what-does-not-hold-and-why).",
    ]
    for figure in study["figures"]:
        stem = reproduce.stem_of(figure["number"])
        parts += [
            f"## Figure {figure['number']}. {figure['title']}",
            f"![{figure['title']}](../images/ricci2010/{stem}.png)",
            f"{figure['caption']} "
            f"([code]({CODE}/figures/{stem}.py), "
            f"[SVG](../images/ricci2010/{stem}.svg))",
            _table(
                ["statement", "found", "needed", "result"],
                [
                    [c["statement"], c["found"], c["wanted"], _verdict(c)]
                    for c in figure["checks"]
                ],
            ),
        ]
    parts += [
        "## What does not hold, and why",
        (DOCS / "gallery" / "ricci2010-discussion.md").read_text().strip(),
        "## What the conclusions depend on",
        "Every number that is not printed in the paper was taken to both ends of its "
        "range, one at a time. These conclusions flip; all others hold, or fail, at "
        "both ends of every range.",
        _table(
            ["figure", "statement", "as it is", "flips when"],
            [
                [
                    str(entry["figure"]),
                    entry["statement"],
                    "holds" if entry["passed"] else "does not hold",
                    "; ".join(
                        f"`{flip['parameter']}` = {flip['shown']}"
                        for flip in entry["flips"]
                    ),
                ]
                for entry in study["sensitivity"]
                if entry["flips"]
            ],
        ),
        "## The numbers",
        f"From [parameters.toml]({CODE}/parameters.toml). *text*: printed in the "
        "paper; *deduced*: follows from what is printed; *assumed*: chosen, as nothing "
        "fixes it.",
        _table(
            ["number", "value", "basis", "range", "why"],
            [
                [
                    f"`{entry['name']}`",
                    entry["shown"],
                    entry["basis"],
                    " to ".join(entry["shown_limits"] or []),
                    entry["reason"],
                ]
                for entry in study["parameters"]
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _verdict(check: dict[str, Any]) -> str:
    text = "pass" if check["passed"] else "**FAIL**"
    return f"{text} (set)" if check["role"] == "set" else text


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |"
        for line in lines
    )


if __name__ == "__main__":
    main()
