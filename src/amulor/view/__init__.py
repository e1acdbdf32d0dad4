"""Figures and reports."""

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
