"""Products of a scan: drawings, models, tables, and the archive folder."""

from amulor.handover.order import ENDINGS, Order, product_of
from amulor.handover.page import PageProducts
from amulor.handover.products import hand_over
from amulor.handover.references import comparison

__all__ = [
    "ENDINGS",
    "Order",
    "PageProducts",
    "comparison",
    "hand_over",
    "product_of",
]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
