"""Figures, reports and the browser page, for scans, range images, sites and designs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.view import figures, image_report
    from amulor.view.report import (
        Heading,
        Interactive,
        Listing,
        Paragraph,
        Picture,
        Table,
        write_report,
    )

__all__ = [
    "Heading",
    "Interactive",
    "Listing",
    "Paragraph",
    "Picture",
    "Table",
    "figures",
    "image_report",
    "write_report",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            name: "amulor.view.report"
            for name in __all__
            if name not in ("figures", "image_report")
        },
    )
