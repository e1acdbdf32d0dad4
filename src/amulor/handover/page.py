"""Products that the browser page offers for download, as `amulor export` makes them."""

from __future__ import annotations

import math
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr

from amulor import imaging
from amulor.errors import CubeError
from amulor.handover.order import ENDINGS, Order, Product, Unit
from amulor.handover.products import hand_over
from amulor.imaging import products
from amulor.imaging.frame import Frame
from amulor.view import image_report
from amulor.view.page.measuring import Made

#: A range image with more pixels takes too much memory beside a page [1].
MOST_PIXELS = 2_000_000
_AXES = ("instrument", "z-up", "pose")
_SHOWN = ("amplitude", "height", "relief", "uncertainty")
_DRAWN = ("side", "scale", "axes", "good_only", "largest_uncertainty")

#: Label and options of available products, in the order of the page.
_OFFERS: dict[str, tuple[str, tuple[str, ...]]] = {
    "report": ("Report with accuracy statement", ()),
    "orthoimage": ("Orthoimage", ("show", "dpi", "cell", "contours", *_DRAWN)),
    "dem": ("Heights (DEM)", ("cell", "contours", *_DRAWN)),
    "contours": ("Contour lines", ("contours", "cell", *_DRAWN)),
    "section": ("Section along the line", _DRAWN),
    "profile": ("Half-profile of a round object", _DRAWN[1:2] + _DRAWN[3:]),
    "deviation": ("Deviation from the reference", ("farthest", "cell", *_DRAWN)),
    "mesh": ("Mesh", ("axes", "good_only", "largest_uncertainty")),
    "cloud": ("Point cloud", ("axes", "good_only", "largest_uncertainty")),
}


class PageProducts:
    """Maker of downloadable products from the image that a page shows.

    Libraries of the formats write files. A product is therefore written to a private
    temporary folder, which is removed before the page gets its response. Products are
    made one at a time.
    """

    def __init__(self, *, against: Path | None = None, unit: Unit = "m") -> None:
        self._against, self._unit = against, unit
        self._busy = threading.Lock()

    def offered(self) -> list[dict[str, Any]]:
        """Return the available products with labels, file endings and options."""
        return [
            {
                "product": product,
                "label": label,
                "endings": list(_endings(product)),
                "options": list(options),
            }
            for product, (label, options) in _OFFERS.items()
            if product != "deviation" or self._against is not None
        ]

    def make(self, image: xr.Dataset, request: dict[str, Any], *, stem: str) -> Made:
        """Make a product of a range image, as requested by the page."""
        offers = {str(offer["product"]): offer for offer in self.offered()}
        product = str(request.get("product", ""))
        if product not in offers:
            raise CubeError(
                f"there is no product {product[:40]!r} here, only {', '.join(offers)}"
            )
        ending = str(request.get("ending", offers[product]["endings"][0]))
        if ending not in offers[product]["endings"]:
            raise CubeError(
                f"{product} is written to {', '.join(offers[product]['endings'])}, not "
                f"{ending[:20]!r}"
            )
        unknown = set(request) - {"product", "ending", "channel", "pixels"}
        unknown -= set(offers[product]["options"])
        if unknown:
            raise CubeError(
                f"{product} takes no option {min(unknown)[:40]!r}; it takes "
                f"{', '.join(offers[product]['options']) or 'none'}"
            )
        if image["slant_range"].size > MOST_PIXELS:
            raise CubeError(
                f"the image has more than {MOST_PIXELS:,} pixels, which need more "
                "memory than a page should take; use amulor export"
            )
        if not self._busy.acquire(blocking=False):
            raise CubeError("another product is being made; ask again in a moment")
        try:
            return self._written(image, product, ending, request, stem)
        finally:
            self._busy.release()

    def _written(
        self,
        image: xr.Dataset,
        product: str,
        ending: str,
        request: Mapping[str, Any],
        stem: str,
    ) -> Made:
        name = f"{_plain(stem)}-{product}{ending}"
        with tempfile.TemporaryDirectory(prefix="amulor-page-") as folder:
            path = Path(folder) / name
            if product == "report":
                image_report.write(path, {_plain(stem): image})
                statements = "report; a browser prints it as an A4 document"
            else:
                image, frame = _chosen(image, request)
                order = self._order(product, request, image, frame)
                statements = hand_over(image, path, order, frame=frame)
            return Made(name=name, content=path.read_bytes(), said=statements)

    def _order(
        self, product: str, request: Mapping[str, Any], image: xr.Dataset, frame: Frame
    ) -> Order:
        side = _one_of(request, "side", ("front", "top"))
        fields: dict[str, Any] = {
            name: _number(request, name, low, high)
            for name, low, high in (
                ("cell", 1e-5, 1.0),
                ("contours", 1e-5, 10.0),
                ("farthest", 1e-6, 100.0),
            )
        }
        if product == "contours" and fields["contours"] is None:
            raise CubeError(
                "contour lines need an interval, from 0.00001 to 10 m; none is stated"
            )
        if product == "section":
            fields["line"] = _line(image, frame, side, request.get("pixels"))
        if product == "deviation":
            fields |= {"against": self._against, "unit": self._unit}
        return Order(
            product=product,  # type: ignore[arg-type]
            side=side,  # type: ignore[arg-type]
            show=_one_of(request, "show", _SHOWN),  # type: ignore[arg-type]
            scale=_number(request, "scale", 0.1, 10_000.0),
            dots_per_inch=_number(request, "dpi", 10.0, 1200.0) or 300.0,
            **fields,
        )


def _endings(product: str) -> tuple[str, ...]:
    if product == "report":
        return (".html",)
    endings: Mapping[str, tuple[str, ...]] = {
        name: ENDINGS[name] for name in get_args(Product)
    }
    return endings[product]


def _plain(stem: str) -> str:
    """Replace all characters of a file name but letters, digits, - and _."""
    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in stem)
    return name.strip("_")[:80] or "scan"


def _chosen(image: xr.Dataset, request: Mapping[str, Any]) -> tuple[xr.Dataset, Frame]:
    """Return the range image without the excluded pixels, and its frame."""
    axes: Literal["instrument", "z-up", "pose"]
    axes = _one_of(request, "axes", _AXES)  # type: ignore[assignment]
    good = request.get("good_only", False)
    if not isinstance(good, bool):
        raise CubeError("good_only is true or false")
    largest = _number(request, "largest_uncertainty", 1e-9, 100.0)
    frame = imaging.frame_of(image, axes=axes)
    if good or largest is not None:
        image = imaging.leave_out(image, good_only=good, largest_uncertainty=largest)
    return image, frame


def _line(
    image: xr.Dataset, frame: Frame, side: str, pixels: Any
) -> tuple[float, float, float, float]:
    """Return the end points of a section line, from two pixels of the scan [m]."""
    rows, columns = image["slant_range"].shape
    if (
        not isinstance(pixels, list)
        or len(pixels) != 2
        or not all(isinstance(pixel, list) and len(pixel) == 2 for pixel in pixels)
        or not all(type(part) is int for pixel in pixels for part in pixel)
        or not all(0 <= r < rows and 0 <= c < columns for r, c in pixels)
    ):
        raise CubeError("a section needs two pixels: draw a line on the map first (L)")
    if pixels[0] == pixels[1]:
        raise CubeError("both ends of the section are the same pixel")
    cloud = imaging.point_cloud(image, frame=frame)
    places = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
    plane = products.plane_of(frame, side)  # type: ignore[arg-type]
    line: list[float] = []
    for row, column in pixels:
        # A pixel without a range is replaced by the nearest pixel with a range.
        away = np.hypot(cloud["row"].values - row, cloud["column"].values - column)
        place = places[int(np.argmin(away))]
        line += [float(plane.axes[0] @ place), float(plane.axes[1] @ place)]
    a, b, c, d = line
    if math.hypot(c - a, d - b) < 1e-6:
        raise CubeError(
            f"seen from the {side}, both ends of the section are at the same place"
        )
    return a, b, c, d


def _one_of(request: Mapping[str, Any], name: str, choices: Sequence[str]) -> str:
    """Return the requested choice, or the first choice if none is requested."""
    value = request.get(name, choices[0])
    if value not in choices:
        raise CubeError(f"{name} must be one of {', '.join(choices)}")
    return str(value)


def _number(
    request: Mapping[str, Any], name: str, low: float, high: float
) -> float | None:
    """Return a requested number; None if it is missing; raise outside the limits."""
    value = request.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CubeError(f"{name} must be a number")
    if not low <= value <= high:
        raise CubeError(f"{name} must be from {low:g} to {high:g}, got {value:g}")
    return float(value)
