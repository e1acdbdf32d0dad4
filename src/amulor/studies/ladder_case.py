"""One picture of the ladder, and how it compares with the ladder as it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.imaging import metrics
from amulor.survey import Staircase, Survey

WATERS = ("clear", "milk")
CHANNELS = ("VH", "VV")
STAGES = ("before", "after")
#: Pixels nearer than this to the edge of a tread are left out of the numbers: there
#: one tread hides the other from the receiver [m].
_MARGIN = 3e-3


@dataclass(frozen=True, kw_only=True)
class Case:
    """One water and one channel, before or after rejection."""

    water: str
    """Which water."""
    channel: str
    """Which polarization pair."""
    stage: str
    """Before or after rejection."""
    image: xr.Dataset
    """Range image."""
    steps: list[metrics.StepHeight]
    """Measured heights of the steps."""
    true_steps: tuple[float, ...]
    """Heights of the steps as they are [m]."""
    bias: float
    """Mean error of the slant range on the treads [m]."""
    bias_uncertainty: float
    """Standard uncertainty of that mean: noise, and what the pixels share [m]."""
    noise: float
    """Scatter of the slant range among the rows of each column, on the treads [m]."""
    stated: float
    """Root mean square of the uncertainty stated for the treads; not a number where
    the image states none: before rejection [m]."""

    @property
    def name(self) -> str:
        """Channel and water, as the figures call the case."""
        return f"{self.channel} {self.water}"


def treads(survey: Survey) -> NDArray[np.intp]:
    """Return which tread each pixel looks at, counted 1, 2, ... from the left.

    Parameters
    ----------
    survey : Survey
        Its first target is a staircase that faces the emitter.

    Returns
    -------
    ndarray of int, shape (row, column)
        0 near the edges of the treads.
    """
    stairs = survey.targets[0]
    assert isinstance(stairs, Staircase)
    scan = survey.scan
    azimuth = np.linspace(-0.5, 0.5, scan.columns) * scan.azimuth_span
    depth = stairs.position[2] - np.concatenate([[0.0], np.cumsum(stairs.step_heights)])
    edges = (np.arange(len(depth) + 1) - len(depth) / 2) * stairs.tread_width
    number = np.zeros(scan.columns, dtype=np.intp)
    for i, distance in enumerate(depth):
        right = distance * np.tan(azimuth)
        number[(right > edges[i] + _MARGIN) & (right < edges[i + 1] - _MARGIN)] = i + 1
    return np.broadcast_to(number, (scan.rows, scan.columns))


def evaluate(
    survey: Survey, image: xr.Dataset, *, water: str, channel: str, stage: str
) -> Case:
    """Compare a range image of the ladder with the ladder.

    Parameters
    ----------
    survey : Survey
        What was simulated.
    image : xarray.Dataset
        Its range image, with the truth in it.
    water, channel, stage : str
        Which case it is.

    Returns
    -------
    Case
        Steps, bias and noise.
    """
    stairs = survey.targets[0]
    assert isinstance(stairs, Staircase)
    number = treads(survey)
    error = image["slant_range"].values - image["truth_slant_range"].values
    error = np.where(number > 0, error, np.nan)[:, (number > 0).any(axis=0)]
    sigma = image["slant_range_uncertainty"].values[number > 0]
    noise = float(np.sqrt(np.nanmean(np.nanvar(error, axis=0, ddof=1))))
    shared = 0.0
    if stage == "after":
        common = image["slant_range_common_uncertainty"].values[number > 0]
        shared = float(np.sqrt(np.nanmean(common**2)))
    count = np.count_nonzero(np.isfinite(error))
    return Case(
        water=water,
        channel=channel,
        stage=stage,
        image=image,
        steps=metrics.step_heights(image, number),
        true_steps=stairs.step_heights,
        bias=float(np.nanmean(error)),
        bias_uncertainty=math.hypot(noise / math.sqrt(count), shared),
        noise=noise,
        stated=float(np.sqrt(np.mean(sigma[np.isfinite(sigma)] ** 2)))
        if np.isfinite(sigma).any()
        else math.nan,
    )


def summary(cases: list[Case]) -> list[dict[str, object]]:
    """Return the numbers of all cases for other programs.

    Parameters
    ----------
    cases : list of Case
        What `run` returns.

    Returns
    -------
    list of dict
        Lengths in metres; None for an uncertainty that is not known.
    """
    return [
        {
            "water": case.water,
            "channel": case.channel,
            "stage": case.stage,
            "range_bias_m": case.bias,
            "range_bias_uncertainty_m": case.bias_uncertainty,
            "range_noise_m": case.noise,
            "range_uncertainty_m": _known(case.stated),
            "steps": [
                {
                    "true_m": true,
                    "height_m": step.height,
                    "uncertainty_m": _known(step.uncertainty),
                }
                for true, step in zip(case.true_steps, case.steps, strict=True)
            ],
        }
        for case in cases
    ]


def _known(value: float) -> float | None:
    """Return a number, None if it is not known."""
    return value if math.isfinite(value) else None
