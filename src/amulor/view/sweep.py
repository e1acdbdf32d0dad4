"""Curves against modulation frequency."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.view.style import new_figure, style


def figure(
    modulation_frequency: NDArray[np.float64],
    responses: Mapping[str, NDArray[np.complex128]],
    *,
    cut_off: float | None = None,
    errors: Mapping[str, NDArray[np.float64]] | None = None,
    title: str = "",
) -> Figure:
    """Draw relative amplitude and phase of the water signal."""
    with style():
        drawn = new_figure(4.8, 4.4)
        top, bottom = drawn.subplots(2, 1, sharex=True)
        for name, response in responses.items():
            (line,) = top.plot(modulation_frequency / 1e6, np.abs(response), label=name)
            if errors is not None and name in errors:
                top.fill_between(
                    modulation_frequency / 1e6,
                    np.abs(response) - errors[name],
                    np.abs(response) + errors[name],
                    color=line.get_color(),
                    alpha=0.3,
                    lw=0,
                )
            phase = np.degrees(np.unwrap(np.angle(response)))
            bottom.plot(modulation_frequency / 1e6, phase, label=name)
        if cut_off is not None:
            top.axhline(np.sqrt(0.5), color="#999999", lw=0.6, ls="--")
            top.plot(
                cut_off / 1e6,
                np.sqrt(0.5),
                "o",
                color="black",
                ms=4,
                label=f"cut-off {cut_off / 1e6:.1f} MHz",
            )
        top.set_ylim(0, 1.02)
        top.set_ylabel("amplitude over that at 0 MHz")
        top.legend()
        top.set_title(title)
        bottom.set_ylabel("phase delay [degrees]")
        bottom.set_xlabel("modulation frequency [MHz]")
        for axis in (top, bottom):
            axis.grid(True)
    return drawn


def write(
    path: Path,
    modulation_frequency: NDArray[np.float64],
    responses: Mapping[str, NDArray[np.complex128]],
    *,
    overwrite: bool = False,
    **options: Any,
) -> None:
    """Write that figure as PNG or SVG."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg"):
        raise FormatError(f"{path}: pictures are written as .png or .svg; rename it")
    drawn = figure(modulation_frequency, responses, **options)
    with atomic_output(path, overwrite=overwrite) as temporary, style():
        drawn.savefig(temporary, format=kind, dpi=160)
