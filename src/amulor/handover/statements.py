"""What every product says of itself: frame, errors in the words of the GUM, origin."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from amulor.imaging import error_budget
from amulor.imaging.frame import Frame


def statements_of(image: xr.Dataset, frame: Frame) -> list[str]:
    """Return what a product of a range image says of itself.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.
    frame : Frame
        Frame of the product.

    Returns
    -------
    list of str
        One statement each, without line breaks.
    """
    budget = error_budget(image)
    said = [f"Axes: {frame.axes}"]
    if frame.name == "pose":
        numbers = ", ".join(f"{v:.6g}" for v in frame.position)
        said.append(f"Instrument at ({numbers}) m; pose as stated")
    if frame.crs:
        offset = ", ".join(f"{v:.12g}" for v in frame.crs_offset)
        said.append(f"Reference system: {frame.crs}; add ({offset}) m")
    if budget.error_unknown:
        said.append(_sentence(budget.error_unknown))
    if math.isfinite(budget.combined):
        said.append(
            "Uncertainties are standard uncertainties (GUM, k = 1); about 95 of 100 "
            "errors lie within twice as much. Slant range: median "
            f"{budget.combined * 1e3:.3g} mm, of which all pixels share "
            f"{budget.common * 1e3:.3g} mm"
        )
    unknown = [term.name.replace("_", " ") for term in budget.unknown]
    if frame.unknown:
        unknown += [f"{name} of the pose" for name in frame.unknown]
    unknown.append("directions of the beams, which count as known")
    if math.isfinite(budget.combined):
        said.append(f"Not in them: {', '.join(unknown)}")
    geometry = image["geometry"].attrs
    index = float(geometry["group_index"])
    said.append(f"Metres of water range by the group index {index:.4f}")
    if image.attrs.get("simulated"):
        said.append("Simulated data; nothing here was measured")
    history = str(image.attrs.get("history", "")).splitlines()
    if history:
        said.append(f"Last step: {history[-1]}")
    return said


def _sentence(words: str) -> str:
    """Return words with a capital letter."""
    return words[0].upper() + words[1:]


def in_millimetres(values: ArrayLike) -> str:
    """Return the median of uncertainties for a statement.

    Parameters
    ----------
    values : array_like
        Standard uncertainties; not a number where they are not known [m].

    Returns
    -------
    str
        Such as "0.93 mm (median)", or "not known".
    """
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return f"{np.median(known) * 1e3:.2g} mm (median)" if known.size else "not known"
