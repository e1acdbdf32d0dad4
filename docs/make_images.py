"""Draws the pictures of the README and of docs from runs of the product itself."""

from __future__ import annotations

import tempfile
from pathlib import Path

from amulor.studies import ladder
from amulor.view import figures
from amulor.view.report import png

FOLDER = Path(__file__).parent / "images"


def main() -> None:
    """Run the demo with its own seed and keep two of its figures."""
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        cases = ladder.run(Path(folder), rng=1)
    images: dict[str, dict[str, object]] = {}
    for case in cases:
        images.setdefault(case.name, {})[case.stage] = case.image
    after = {name: stages["after"] for name, stages in images.items()}
    for name, figure in (
        ("ladder-profiles", figures.profiles(images)),
        ("ladder-surfaces", figures.surfaces(after)),
    ):
        (FOLDER / f"{name}.png").write_bytes(png(figure, dots_per_inch=130))


if __name__ == "__main__":
    main()
