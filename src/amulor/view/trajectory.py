"""Figure of a trajectory: plan, height, speed and attitude over time, with gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.io.files import atomic_output
from amulor.platform import Trajectory
from amulor.platform.trajectory import Poses
from amulor.view.style import COLOURS, MISSING_COLOUR, new_figure, style

_MOST = 5000


def write_figure(path: Path, track: Trajectory, *, overwrite: bool = False) -> None:
    """Write the figure of a trajectory as PNG."""
    with style(), atomic_output(path, overwrite=overwrite) as temporary:
        draw(track).savefig(temporary, format="png", dpi=160)


def draw(track: Trajectory) -> Figure:
    """Draw the plan of a trajectory, and height, speed and attitude over time."""
    count = min(_MOST, 4 * track.time.size)
    # The poses themselves belong to it, so that each piece is drawn to its ends.
    even = np.linspace(track.time[0], track.time[-1], count)
    every = max(1, track.time.size // _MOST)
    ends = track.gaps.ravel()
    poses = track.at(np.unique(np.concatenate([even, track.time[::every], ends])))
    with style():
        figure = new_figure(7.2, 4.6)
        grid = figure.add_gridspec(4, 2, width_ratios=(1.1, 1))
        _draw_plan(figure.add_subplot(grid[:, 0]), poses)
        seconds = poses.time - track.time[0]
        speed = np.linalg.norm(poses.velocity, axis=1)
        forward = poses.rotation[:, :, 2]
        down = poses.rotation[:, :, 1]
        heading = np.degrees(np.arctan2(forward[:, 0], forward[:, 1])) % 360
        pitch = np.degrees(np.arcsin(np.clip(forward[:, 2], -1, 1)))
        tilt = np.degrees(np.arccos(np.clip(-down[:, 2], -1, 1)))
        panels = (
            ("height [m]", {"": poses.position[:, 2]}),
            ("speed [m/s]", {"": speed}),
            ("heading [deg]", {"": heading}),
            ("angle [deg]", {"pitch": pitch, "tilt": tilt}),
        )
        shared: Axes | None = None
        for number, (label, lines) in enumerate(panels):
            axis = figure.add_subplot(grid[number, 1], sharex=shared)
            shared = shared or axis
            for name, values in lines.items():
                axis.plot(seconds, values, label=name)
            for begin, end in track.gaps - track.time[0]:
                axis.axvspan(begin, end, color=MISSING_COLOUR, lw=0)
            axis.set_ylabel(label)
            axis.grid(True)
            if len(lines) > 1:
                axis.margins(y=0.35)
                axis.legend(ncols=2, loc="upper right")
            if number < len(panels) - 1:
                axis.tick_params(labelbottom=False)
            else:
                axis.set_xlabel("time since the first pose [s] (gaps in gray)")
    return figure


def _draw_plan(axis: Axes, poses: Poses) -> None:
    """Draw the track from above, with headings and the largest standard uncertainty."""
    east, north = poses.position[:, 0], poses.position[:, 1]
    axis.plot(east, north, color=COLOURS[0])
    (known,) = np.nonzero(poses.known)
    axis.plot(east[known[0]], north[known[0]], "o", color=COLOURS[2], label="start")
    axis.plot(east[known[-1]], north[known[-1]], "s", color=COLOURS[1], label="end")
    shown = known[:: max(1, known.size // 12)]
    forward = poses.rotation[shown, :2, 2]
    axis.quiver(
        east[shown], north[shown], forward[:, 0], forward[:, 1],
        angles="xy", width=0.004, color=COLOURS[6],
    )  # fmt: skip
    axis.plot([], [], color=COLOURS[6], marker=r"$\rightarrow$", ls="", label="heading")
    spread = _largest(poses.covariance[known, :2, :2])
    title = "Plan"
    if np.isfinite(spread):
        title += f"; standard uncertainty up to {1e3 * spread:.3g} mm"
    axis.set_title(title)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.grid(True)
    axis.legend(ncols=3)


def _largest(covariance: NDArray[np.float64]) -> float:
    """Largest standard uncertainty in any direction; NaN if unknown."""
    if not np.isfinite(covariance).all():
        return float("nan")
    return float(np.sqrt(np.linalg.eigvalsh(covariance).max()))
