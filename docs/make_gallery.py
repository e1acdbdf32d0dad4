"""Draws the gallery of redrawn figures: runs the whole study, then writes its page.

Run with ``python docs/make_gallery.py``, which takes some twenty minutes of a
processor, most for what the conclusions depend on. ``--figure 7`` draws one anew,
``--keep-dependences`` leaves that table as it is, and ``--page`` writes the page again
from the checks of the last run.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from amulor.studies.ricci2010 import reproduce, results
from amulor.studies.ricci2010.figures import FIGURES
from amulor.studies.ricci2010.results import FOREWORD, Check

DOCS = Path(__file__).parent
IMAGES = DOCS / "images" / "ricci2010"
CHECKS = IMAGES / "checks.json"
PAGE = DOCS / "gallery" / "ricci2010.md"
CODE = "../../src/amulor/studies/ricci2010"


def main() -> None:
    """Run what is asked for, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--figure", type=int, nargs="+", default=reproduce.FIGURES)
    parser.add_argument("--keep-dependences", action="store_true")
    parser.add_argument("--page", action="store_true")
    asked = parser.parse_args()
    if not asked.page:
        redrawn = reproduce.run(
            asked.figure,
            depend=not asked.keep_dependences,
            progress=lambda step, share: print(f"{share:4.0%} {step}", flush=True),
        )
        IMAGES.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            for name in reproduce.write(Path(folder), redrawn):
                if name not in ("report.html", "checks.json"):
                    shutil.copy(Path(folder) / name, IMAGES / name)
        CHECKS.write_text(json.dumps(merged(redrawn.plain()), indent=1) + "\n")
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(json.loads(CHECKS.read_text())))


def merged(found: dict[str, Any]) -> dict[str, Any]:
    """Return a run with what it left out taken from the run before.

    Parameters
    ----------
    found : dict
        `Results.plain()` of a run, perhaps of some figures only.

    Returns
    -------
    dict
        What `checks.json` holds. Dependences are kept while their statement is.
    """
    kept = json.loads(CHECKS.read_text()) if CHECKS.exists() else {}
    figures = {f["number"]: f for f in [*kept.get("figures", []), *found["figures"]]}
    anew = {f["number"] for f in found["figures"]}
    if found["sensitivity"] is None:
        anew = set()
    stated = {(n, c["statement"]) for n, f in figures.items() for c in f["checks"]}
    entries = [
        entry
        for entry in kept.get("sensitivity") or []
        if entry["figure"] not in anew
        and (entry["figure"], entry["statement"]) in stated
    ] + (found["sensitivity"] or [])
    for entry in entries:
        entry.pop("changes", None)  # the page shows the flips only
    return {
        "figures": [figures[number] for number in sorted(figures)],
        "sensitivity": sorted(entries, key=lambda entry: entry["figure"]),
        "parameters": found["parameters"],
    }


def _file(number: int) -> str:
    """Return the name of the file that draws a figure."""
    return f"{FIGURES[number].draw.__module__.rpartition('.')[2]}.py"


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
    every = [
        Check(**check) for figure in study["figures"] for check in figure["checks"]
    ]
    looked_into = {entry["figure"] for entry in study["sensitivity"]}
    parts = [
        "# The figures of Ricci et al. 2010, redrawn",
        "This page shows fourteen figures of the paper, computed anew with the models "
        "of amulor. [A shorter page](paper.md) summarizes what agrees. The command "
        "`amulor reproduce ricci2010 -o FOLDER` writes all figures, tables and a "
        "report into a folder. With `--figure 7` it writes only figure 7. With "
        "`--quick` it takes less than a minute. `python docs/make_gallery.py` writes "
        "this page.",
        FOREWORD,
        f"{results.tally(every)} The failed statements are discussed "
        "[below](#what-does-not-hold-and-why).",
    ]
    for figure in study["figures"]:
        stem = reproduce.stem_of(figure["number"])
        parts += [
            f"## Figure {figure['number']}. {figure['title']}",
            f"![{figure['title']}](../images/ricci2010/{stem}.png)",
            f"{figure['caption']} "
            f"([code]({CODE}/figures/{_file(figure['number'])}), "
            f"[SVG](../images/ricci2010/{stem}.svg))",
            _table(
                list(results.CHECK_HEADER),
                [
                    [*row[:-1], row[-1].replace("FAIL", "**FAIL**")]
                    for row in results.check_rows(Check(**c) for c in figure["checks"])
                ],
            ),
        ]
    parts += [
        "## What does not hold, and why",
        (DOCS / "gallery" / "ricci2010-discussion.md").read_text().strip(),
        "## What the conclusions depend on",
        "Many numbers of this study are not in the paper. Each of them has a value "
        "and a range of possible values. For this table each number was set to both "
        "ends of its range, one number at a time. The table lists the statements whose "
        "result changes. All other results of these "
        f"{len(looked_into)} figures stay the same.",
        _table(
            ["figure", "statement", "with the chosen numbers", "changes with"],
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
        "The table lists the numbers of the study, from "
        f"[parameters.toml]({CODE}/parameters.toml). The column *basis* contains "
        "*text* if the number is printed in the paper. It contains *deduced* if the "
        "number follows from printed numbers and statements. It contains *assumed* if "
        "the paper does not determine the number.",
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


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |"
        for line in lines
    )


if __name__ == "__main__":
    main()
