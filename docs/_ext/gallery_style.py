"""Draws the gallery with the settings of all figures of amulor."""

from __future__ import annotations

from typing import Any

import matplotlib

from amulor.view.style import SETTINGS


def apply(gallery_conf: dict[str, Any], name: str) -> None:
    """Apply the settings before each example, after those of matplotlib."""
    matplotlib.rcParams.update(SETTINGS)
