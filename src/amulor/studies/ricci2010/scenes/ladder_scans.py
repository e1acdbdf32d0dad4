"""Simulated ladder scans with range images, for figures 5, 6, 13 and 14."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import imaging, rejection
from amulor.errors import CubeError
from amulor.imaging import metrics
from amulor.optics import low_pass, ranging
from amulor.simulation import DiffusionModel, backscatter, simulate
from amulor.studies.ladder import treads
from amulor.studies.ricci2010.results import Check, Statements
from amulor.studies.ricci2010.scenes.scan_surveys import (
    ScanField,
    around,
    images,
    survey_of,
    table,
    water_of,
)
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey
from amulor.units import write

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Steps:
    """Step heights and range errors of a range image of the ladder."""

    heights: Floats
    """Measured step heights; NaN with too few valid pixels [m]."""
    uncertainties: Floats
    """Standard uncertainties of the heights; noise only before subtraction [m]."""
    noise: float
    """Standard deviation of the slant range between scan lines, on the treads [m]."""
    error: float
    """Root mean square range error on the treads [m]."""
    pixels: int
    """Number of pixels with a range on the treads [1]."""
    wanted: int
    """Number of all pixels on the treads [1]."""


@dataclass(frozen=True, kw_only=True)
class LadderScan:
    """Scan of the ladder, before and after water subtraction."""

    survey: Survey
    """Simulated survey."""
    truth: Floats
    """True slant range, shape (row, column) [m]."""
    treads: NDArray[np.intp]
    """Tread number of each pixel, from 1; 0 near edges."""
    water_ratio: dict[str, float]
    """Mean ratio of water signal to ladder echo, by channel [1]."""
    raw: dict[str, xr.Dataset]
    """Range image before water subtraction, by channel."""
    subtracted: dict[str, xr.Dataset]
    """Range image after water subtraction, by channel."""
    stated: dict[str, xr.Dataset]
    """Range image by the `frequency` method, by channel; without polarizers only.

    The range shift by water is a stated bias, and pixels with too much water have no
    range.
    """

    def farthest(self, image: xr.Dataset) -> float:
        """Return the measured forward coordinate of the farthest tread [m]."""
        cloud = imaging.point_cloud(image)
        tread = self.treads[cloud["row"].values, cloud["column"].values]
        return float(cloud["z"].values[tread == 1].mean())

    def off(self, image: xr.Dataset) -> Floats:
        """Return the errors of the step heights in a range image [m]."""
        true = np.diff(np.concatenate([[0.0], _heights(self.survey)]))
        wrong: Floats = self.steps(image).heights - true
        return wrong

    def steps(self, image: xr.Dataset) -> Steps:
        """Measure step heights and range errors of a range image of the ladder."""
        on = self.treads > 0
        error = np.where(on, image["slant_range"].values - self.truth, np.nan)
        valid = np.isfinite(error)
        lines = valid.sum(axis=0)
        several = lines > 1
        values = error[:, several]
        count = self.treads.max()
        try:
            result = metrics.step_heights(image, self.treads)
        except CubeError:
            heights = uncertainties = np.full(count - 1, np.nan)
        else:
            heights = np.array([step.height for step in result])
            # Before subtraction the image has no error, but its noise is known.
            uncertainties = np.array(
                [
                    step.random if math.isnan(step.uncertainty) else step.uncertainty
                    for step in result
                ]
            )
        return Steps(
            heights=heights,
            uncertainties=uncertainties,
            noise=_root_mean(np.nanvar(values, axis=0, ddof=1)),
            error=_root_mean(error[valid] ** 2),
            pixels=int(valid.sum()),
            wanted=int(on.sum()),
        )


def _heights(survey: Survey) -> Floats:
    """Return the tread heights above the farthest tread [m]."""
    target: Any = survey.targets[0]
    return np.cumsum(np.asarray(target.step_heights, dtype=np.float64))


def _root_mean(squares: Floats) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else math.nan


def _ladder(study: Study) -> str:
    steps = [study["first_step"], *[study["other_steps"]] * 3]
    heights = ", ".join(f'"{write(step, "length")}"' for step in steps)
    return f"""
kind = "staircase"
tread_width = "{write(study["tread_width"], "length")}"
step_heights = [{heights}]
height = "6 cm"
"""


def _scan(study: Study, *, scan: str) -> LadderScan:
    """Simulate and process a scan defined in `scans.toml`."""
    row = table()["ladder"][scan]
    distance = study[row["distance"]]
    # The field is 10 cm x 4 cm on the ladder.
    closer = study["short_distance"] / distance
    coarser = row["quick"] if study.quick else 1
    survey = survey_of(
        study,
        name=row["name"],
        water=water_of(study, row["water"]),
        field=ScanField(
            distance=distance,
            baseline=study[row["baseline"]],
            columns=round(study["scan_columns"] / coarser),
            rows=round(study["scan_rows"] / coarser),
            width=2 * math.atan(math.tan(study["scan_width"] / 2) * closer),
            height=2 * math.atan(math.tan(study["scan_height"] / 2) * closer),
        ),
        target=_ladder(study),
        polarizations=row["polarizations"],
    )
    interval = around(survey.targets[0].position[2])
    # The paper's form of the water, whatever the default is.
    cube = simulate(survey, rng=study.rng(row["label"]), model=DiffusionModel())
    truth = cube.amulor.truth
    on = treads(survey)
    water = np.hypot(truth["water_in_phase"], truth["water_quadrature"]).values[0]
    echo = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values[0]
    channels = survey.instrument.polarizations
    by_frequency: dict[str, xr.Dataset] = {}
    if len(channels) == 1:
        frequency = study["frequency"]
        target = rejection.frequency(
            cube, modulation_frequency=frequency, interval=interval
        )
        by_frequency = images(target, interval=interval)
    return LadderScan(
        survey=survey,
        truth=truth["slant_range"].values,
        treads=on,
        water_ratio={
            channel: float(w[on > 0].mean() / e[on > 0].mean())
            for channel, w, e in zip(channels, water, echo, strict=True)
        },
        raw=images(rejection.keep_water(cube), interval=interval),
        subtracted=images(
            rejection.open_water(cube, interval=interval), interval=interval
        ),
        stated=by_frequency,
    )


# The study remembers results by function, so each scan has its own.
unpolarized_clear, unpolarized_turbid, polarized_clear, polarized_milk = (
    partial(_scan, scan=scan) for scan in table()["ladder"]
)

#: Panels of figures 13 and 14: title, scan, channel.
PANELS = (
    ("VH, clear water", polarized_clear, "VH"),
    ("VV, clear water", polarized_clear, "VV"),
    ("VH, milk", polarized_milk, "VH"),
    ("VV, milk", polarized_milk, "VV"),
)


def cut_off(survey: Survey, *, end: float | None = None) -> float:
    """Return the cut-off frequency of the water signal at the middle beam [Hz]."""
    ended = survey.water.model_copy(update={"column_end": end})
    changed = survey.model_copy(update={"water": ended})
    return low_pass.cut_off(lambda f: backscatter.diffusion_response(changed, f))


def phase_step(study: Study, height: float) -> float:
    """Return the phase change for a step height [rad]."""
    interval = ranging.ambiguity_interval(
        study["frequency"], group_index=study["index"]
    )
    return float(2 * np.pi * height / interval)


def steps_are_faithful(
    study: Study, rows: Statements, name: str, steps: Steps
) -> Check:
    """Check that step heights are correct within the instrument's phase error."""
    interval = ranging.ambiguity_interval(
        study["frequency"], group_index=study["index"]
    )
    limit = float(study["phase_noise"] / (2 * np.pi) * interval) * 1e3
    true = np.array([study["first_step"], *[study["other_steps"]] * 3])
    off = (steps.heights - true) * 1e3
    worst = float(off[np.argmax(np.abs(off))])
    check = rows.holds(
        name,
        abs(worst) <= limit,
        ", ".join(f"{height * 1e3:.1f}" for height in steps.heights) + " mm",
        wanted=", ".join(f"{height * 1e3:.0f}" for height in true)
        + f" mm, each within {limit:.1f} mm, the equivalent of 0.25 degrees",
    )
    return replace(check, value=worst)


def steps_agree(
    study: Study, rows: Statements, name: str, steps: Steps, **words: str
) -> Check:
    """Check that step heights are correct within three standard errors."""
    true = np.array([study["first_step"], *[study["other_steps"]] * 3])
    off = np.abs(steps.heights - true) / steps.uncertainties
    text = ", ".join(
        f"{height * 1e3:.1f} ± {error * 1e3:.1f}"
        for height, error in zip(steps.heights, steps.uncertainties, strict=True)
    )
    if np.isfinite(off).all():
        text = f"{text} mm"
    else:
        text = f"no range on {steps.wanted - steps.pixels} of {steps.wanted} pixels"
    heights = ", ".join(f"{height * 1e3:.0f}" for height in true)
    check = rows.holds(
        name,
        bool((off <= 3.0).all()),
        text,
        wanted=f"{heights} mm, each within 3 standard errors",
        **words,
    )
    return replace(check, value=float(np.max(off)))
