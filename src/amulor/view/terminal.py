"""Running scan in the terminal: map of characters, progress and advice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from amulor.view.page.layers import MAPS
from amulor.view.style import BRIGHTNESS_MAP, DISTANCE_MAP

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

    from amulor.view.page import Live

__all__ = ["CHOICES", "going", "map_name", "picture", "screen", "signal_to_noise"]

Floats = NDArray[np.float64]

#: Available maps, and their color scales.
CHOICES = {
    "range": DISTANCE_MAP,
    "amplitude": BRIGHTNESS_MAP,
    "uncertainty": "magma",
}
#: Characters from low to high values, for terminals without colors.
_SHADES = " .:-=+*#%@"
#: Character with two halves: one pixel above another.
_HALF = "▀"
_UNITS = {layer.name: layer.unit for layer in MAPS.values()}


def map_name(live: Live, channel: str, layer: str) -> str:
    """Name of the map to show: after water rejection if available, else before."""
    after = np.isfinite(live.now(channel, layer)).any()
    return layer if after else f"{layer}_before"


def shrunk(values: Floats, rows: int, columns: int) -> Floats:
    """Map resampled to the size of a terminal: means of blocks, or repeated pixels."""
    times = min(rows // values.shape[0], columns // values.shape[1])
    if times > 1:
        return values.repeat(times, axis=0).repeat(times, axis=1)
    step = max(
        1, math.ceil(values.shape[0] / rows), math.ceil(values.shape[1] / columns)
    )
    shape = tuple(-(-size // step) for size in values.shape)
    padded = np.full((shape[0] * step, shape[1] * step), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(shape[0], step, shape[1], step)
    valid = np.isfinite(blocks)
    count = valid.sum(axis=(1, 3))
    total = np.where(valid, blocks, 0.0).sum(axis=(1, 3))
    mean: Floats = np.divide(total, count, out=np.full(shape, np.nan), where=count > 0)
    return mean


def limits(values: Floats) -> tuple[float, float]:
    """Limits of the color scale: 2 and 98 % quantiles of the pixels."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = np.quantile(finite, [0.02, 0.98])
    return float(low), float(high if high > low else low + max(abs(low), 1e-12) * 1e-3)


def picture(values: Floats, *, colours: str, plain: bool = False) -> Text:
    """Map as colored half-blocks, two pixel rows a line, or plain shade characters."""
    from rich.text import Text

    low, high = limits(values)
    valid = np.isfinite(values)
    part = np.where(valid, np.clip((values - low) / (high - low), 0.0, 1.0), 0.0)
    if plain:
        shade = (part * (len(_SHADES) - 2)).round().astype(int) + 1
        lines = (
            "".join(
                _SHADES[s] if is_valid else " "
                for s, is_valid in zip(*row, strict=True)
            )
            for row in zip(shade, valid, strict=True)
        )
        return Text("\n".join(lines), no_wrap=True)
    red_green_blue = (matplotlib.colormaps[colours](part)[..., :3] * 255).astype(int)
    text = Text(no_wrap=True)
    for top in range(0, len(values), 2):
        if top:
            text.append("\n")
        for column in range(values.shape[1]):
            above = _colour(red_green_blue, valid, top, column)
            below = _colour(red_green_blue, valid, top + 1, column)
            if above is None and below is None:
                text.append(" ")
            elif above is None:
                text.append("▄", style=f"{below}")
            else:
                text.append(_HALF, style=f"{above} on {below}" if below else above)
    return text


def _colour(
    shades: NDArray[np.int_], valid: NDArray[np.bool_], row: int, column: int
) -> str | None:
    """Color of a pixel in rich's notation; None without a value."""
    if row >= len(valid) or not valid[row, column]:
        return None
    red, green, blue = shades[row, column]
    return f"rgb({red},{green},{blue})"


def signal_to_noise(live: Live, channel: str) -> float | None:
    """Median signal-to-noise ratio of a channel's amplitudes [1]."""
    samples = live.recording.samples
    if samples is None or channel not in samples.amulor.polarizations:
        return None
    channel_samples = samples.sel(polarization=channel)
    size = np.hypot(
        channel_samples["in_phase"].values, channel_samples["quadrature"].values
    )
    error = np.hypot(
        channel_samples["in_phase_uncertainty"].values,
        channel_samples["quadrature_uncertainty"].values,
    )
    ratio = size / np.where(error > 0, error / math.sqrt(2), np.nan)
    finite = ratio[np.isfinite(ratio)]
    return float(np.median(finite)) if finite.size else None


def going(status: Mapping[str, Any], *, ratio: float | None, now: datetime) -> str:
    """Progress of a running scan in one line of text."""
    done, total = int(status.get("done", 0)), int(status.get("total", 0))
    words = [str(status.get("state", "not begun"))]
    if words[0] == "running":
        words[0] = str(status.get("kind", "")) or "running"
    if total:
        words.append(f"{done:,} of {total:,} samples ({done / total:.0%})")
    if status.get("rate"):
        words.append(f"{status['rate']:.0f}/s")
    if status.get("left") is not None:
        ends = now + timedelta(seconds=float(status["left"]))
        remaining = timedelta(seconds=int(status["left"]))
        words.append(f"{remaining} left, ends at {ends:%H:%M}")
    flagged = status.get("flagged") or {}
    words += [f"{count:,} {name}" for name, count in sorted(flagged.items())]
    if ratio is not None:
        words.append(f"signal/noise {ratio:.3g}")
    drift = status.get("drift") or {}
    if drift.get("elapsed"):
        change, error = drift["total"]["size"], drift["total"]["error"]
        words.append(f"open water {change * 100:+.1f} ± {error * 100:.1f} %")
    return ", ".join(words)


def screen(
    live: Live,
    *,
    channel: str,
    layer: str,
    size: tuple[int, int],
    plain: bool,
    now: datetime,
) -> RenderableType:
    """Terminal display of a running scan: map, progress and advice."""
    from rich.console import Group
    from rich.text import Text

    status = live.status
    name = map_name(live, channel, layer)
    values = live.now(channel, name)
    wide, high = size
    notices = [
        Text(str(line), style="bold yellow") for line in status.get("advice", [])
    ]
    if "error" in status:
        notices.append(Text(str(status["error"]), style="bold red"))
    room = max(2, high - 5 - sum(-(-len(line.plain) // wide) for line in notices))
    small = shrunk(values, room if plain else 2 * room, max(2, wide - 1))
    low, top = limits(small)
    unit = _UNITS.get(layer, "")
    scale = f"{layer} {low:.4g} to {top:.4g} {unit}"
    if not np.isfinite(small).any():
        scale = f"{layer}: nothing measured yet"
    elif name != layer:
        scale += ", water left in"
    ratio = signal_to_noise(live, channel)
    return Group(
        Text(f"{live.name}, {channel}", style="bold"),
        picture(small, colours=CHOICES[layer], plain=plain),
        Text(scale, style="dim"),
        Text(going(status, ratio=ratio, now=now)),
        *notices,
    )
