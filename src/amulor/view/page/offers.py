"""What a page may ask to be made of a range image; who makes it is told later."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import xarray as xr


@dataclass(frozen=True, kw_only=True)
class Made:
    """A product as it goes to the browser, which keeps it."""

    name: str
    """Name of the file."""
    content: bytes
    """The file."""
    said: str
    """What it is, in a few words and numbers."""


class Products(Protocol):
    """Makes products of range images."""

    def offered(self) -> list[dict[str, Any]]:
        """Return products with their labels, endings and options, for the page."""

    def make(self, image: xr.Dataset, wanted: dict[str, Any], *, stem: str) -> Made:
        """Make a product.

        Parameters
        ----------
        image : xarray.Dataset
            Level `range_image`.
        wanted : dict
            What the page asks for; nothing in it is trusted.
        stem : str
            Name of the file without its ending.

        Returns
        -------
        Made
            The file.

        Raises
        ------
        CubeError
            If the request makes no sense, or the image does not hold it.
        """
