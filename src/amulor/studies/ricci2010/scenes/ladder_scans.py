"""Scans of the ladder through the whole chain, for figures 5, 6, 13 and 14."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
from amulor.studies.ricci2010.results import Check, holds
from amulor.studies.ricci2010.scenes.scan_surveys import (
    ScanField,
    ScanWater,
    around,
    images,
    survey_of,
)
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey
from amulor.units import write

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What a range image says about the ladder."""

    heights: Floats
    """Heights of the steps; not numbers where too few pixels have a range [m]."""
    uncertainties: Floats
    """Their standard uncertainties; of noise alone with the water left in [m]."""
    noise: float
    """Scatter of the slant range among the lines, on the treads [m]."""
    error: float
    """Root mean square of slant range less truth, on the treads [m]."""
    pixels: int
    """Pixels on the treads that have a range [1]."""
    wanted: int
    """Pixels on the treads [1]."""


@dataclass(frozen=True, kw_only=True)
class LadderScan:
    """One scan of the ladder, with and without its water signal."""

    survey: Survey
    """What was simulated."""
    truth: Floats
    """True slant range, shape (row, column) [m]."""
    treads: NDArray[np.intp]
    """Tread of each pixel, counted from 1; 0 near edges."""
    water_ratio: dict[str, float]
    """Channel to mean of the water signal over that of the ladder [1]."""
    raw: dict[str, xr.Dataset]
    """Channel to range image with the water left in."""
    subtracted: dict[str, xr.Dataset]
    """Channel to range image with open water subtracted."""
    stated: dict[str, xr.Dataset]
    """Channel to the raw range image that knows about its water: the shift stands as
    a bias, and pixels with too much water have no range. Without polarizers only."""

    def farthest(self, image: xr.Dataset) -> float:
        """Return where the farthest tread stands in one of the images."""
        cloud = imaging.point_cloud(image)
        tread = self.treads[cloud["row"].values, cloud["column"].values]
        return float(cloud["z"].values[tread == 1].mean())

    def off(self, image: xr.Dataset) -> Floats:
        """Return how far the steps in one of the images are off."""
        true = np.diff(np.concatenate([[0.0], _heights(self.survey)]))
        wrong: Floats = self.steps(image).heights - true
        return wrong

    def steps(self, image: xr.Dataset) -> Steps:
        """Compare one of the images with the ladder."""
        on = self.treads > 0
        error = np.where(on, image["slant_range"].values - self.truth, np.nan)
        known = np.isfinite(error)
        lines = known.sum(axis=0)
        several = lines > 1
        values = error[:, several]
        count = self.treads.max()
        try:
            result = metrics.step_heights(image, self.treads)
        except CubeError:
            heights = uncertainties = np.full(count - 1, np.nan)
        else:
            heights = np.array([step.height for step in result])
            # With the water left in, the image states no error: the noise is known.
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
            error=_root_mean(error[known] ** 2),
            pixels=int(known.sum()),
            wanted=int(on.sum()),
        )


def _heights(survey: Survey) -> Floats:
    """Return the heights of the treads above the farthest one [m]."""
    target: Any = survey.targets[0]
    return np.cumsum(np.asarray(target.step_heights, dtype=np.float64))


def _root_mean(squares: Floats) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else math.nan


def _scan(study: Study, survey: Survey, *, label: str) -> LadderScan:
    interval = around(survey.targets[0].position[2])
    # The paper's form of the water, whatever the default is.
    cube = simulate(survey, rng=study.rng(label), model=DiffusionModel())
    truth = cube.amulor.truth
    on = treads(survey)
    water = np.hypot(truth["water_in_phase"], truth["water_quadrature"]).values[0]
    echo = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values[0]
    channels = survey.instrument.polarizations
    stated: dict[str, xr.Dataset] = {}
    if len(channels) == 1:
        frequency = study["frequency"]
        one = rejection.frequency(
            cube, modulation_frequency=frequency, interval=interval
        )
        stated = images(one, interval=interval)
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
        stated=stated,
    )


def _ladder(study: Study) -> str:
    steps = [study["first_step"], *[study["other_steps"]] * 3]
    heights = ", ".join(f'"{write(step, "length")}"' for step in steps)
    return f"""
kind = "staircase"
tread_width = "{write(study["tread_width"], "length")}"
step_heights = [{heights}]
height = "6 cm"
"""


def _field(
    study: Study, *, distance: float, baseline: float, coarser: int = 1
) -> ScanField:
    """Return the 10 cm x 4 cm of the ladder as seen from a distance."""
    closer = study["short_distance"] / distance
    return ScanField(
        distance=distance,
        baseline=baseline,
        columns=round(study["scan_columns"] / coarser),
        rows=round(study["scan_rows"] / coarser),
        width=2 * math.atan(math.tan(study["scan_width"] / 2) * closer),
        height=2 * math.atan(math.tan(study["scan_height"] / 2) * closer),
    )


def _coarser(study: Study) -> int:
    """Return how much coarser a quick scan is; no noise is measured in these."""
    return 2 if study.quick else 1


def _clear_water(study: Study) -> ScanWater:
    """Return the tap water of the short tank."""
    return ScanWater(
        attenuation=study["attenuation_tap"],
        second_moment=study["second_moment_low"],
        backscatter=study["scan_backscatter"],
        m22=study["clear_m22"],
        fluctuation=study["clear_fluctuation"],
    )


def _milk(study: Study) -> ScanWater:
    """Return the short tank's water with the most milk."""
    return ScanWater(
        attenuation=study["milk_attenuation"],
        second_moment=study["second_moment_high"],
        backscatter=study["scan_backscatter"],
        m22=study["milk_m22"],
        fluctuation=study["milk_fluctuation"],
    )


def unpolarized_clear(study: Study) -> LadderScan:
    """Scan the ladder in clear water at 1.5 m without polarizers."""
    survey = survey_of(
        study,
        name="Ladder in clear water, no polarizers",
        water=_clear_water(study),
        field=_field(
            study,
            distance=study["short_distance"],
            baseline=study["short_baseline"],
            coarser=_coarser(study),
        ),
        target=_ladder(study),
        polarizations=["none"],
    )
    return _scan(study, survey, label="ladder, clear, no polarizers")


def unpolarized_turbid(study: Study) -> LadderScan:
    """Scan the ladder in thin, turbid water at 3.7 m without polarizers."""
    water = ScanWater(
        attenuation=study["ladder_attenuation"],
        second_moment=study["second_moment_low"],
        backscatter=study["long_backscatter"],
        m22=study["milk_m22"],
        # The water signal of the long tank is as steady as in its sweeps.
        fluctuation=study["amplitude_noise"],
    )
    survey = survey_of(
        study,
        name="Ladder in turbid water, no polarizers",
        water=water,
        field=_field(
            study,
            distance=study["turbid_distance"],
            baseline=study["long_baseline"],
            coarser=_coarser(study),
        ),
        target=_ladder(study),
        polarizations=["none"],
    )
    return _scan(study, survey, label="ladder, turbid, no polarizers")


def polarized_clear(study: Study) -> LadderScan:
    """Scan the ladder in clear water, crossed and parallel."""
    return _polarized(study, _clear_water(study), name="clear water")


def polarized_milk(study: Study) -> LadderScan:
    """Scan the ladder in milk, crossed and parallel."""
    return _polarized(study, _milk(study), name="milk")


def _polarized(study: Study, water: ScanWater, *, name: str) -> LadderScan:
    survey = survey_of(
        study,
        name=f"Ladder in {name}",
        water=water,
        field=_field(
            study, distance=study["short_distance"], baseline=study["short_baseline"]
        ),
        target=_ladder(study),
        polarizations=["VH", "VV"],
    )
    return _scan(study, survey, label=f"ladder, {name}")


#: Panels of figures 13 and 14: title, scan, channel.
PANELS = (
    ("VH, clear water", polarized_clear, "VH"),
    ("VV, clear water", polarized_clear, "VV"),
    ("VH, milk", polarized_milk, "VH"),
    ("VV, milk", polarized_milk, "VV"),
)


def cut_off(survey: Survey, *, end: float | None = None) -> float:
    """Return the cut-off of the water signal in the middle of a scan."""
    ended = survey.water.model_copy(update={"column_end": end})
    shown = survey.model_copy(update={"water": ended})
    return low_pass.cut_off(lambda f: backscatter.diffusion_response(shown, f))


def phase_step(study: Study, height: float) -> float:
    """Return the change of phase that a height stands for."""
    interval = ranging.ambiguity_interval(
        study["frequency"], group_index=study["index"]
    )
    return float(2 * np.pi * height / interval)


def steps_are_faithful(
    study: Study, statement: str, steps: Steps, *, place: str
) -> Check:
    """Return the check that no step is off by more than the phase error stands for."""
    interval = ranging.ambiguity_interval(
        study["frequency"], group_index=study["index"]
    )
    limit = float(study["phase_noise"] / (2 * np.pi) * interval) * 1e3
    true = np.array([study["first_step"], *[study["other_steps"]] * 3])
    off = (steps.heights - true) * 1e3
    worst = float(off[np.argmax(np.abs(off))])
    shown = ", ".join(f"{height * 1e3:.1f}" for height in steps.heights)
    return replace(
        holds(
            statement,
            abs(worst) <= limit,
            found=f"{shown} mm",
            wanted=", ".join(f"{height * 1e3:.0f}" for height in true)
            + f" mm, each within {limit:.1f} mm, what 0.25 degrees stand for",
            place=place,
        ),
        value=worst,
    )


def steps_agree(
    study: Study,
    statement: str,
    steps: Steps,
    *,
    place: str,
    significance: float = 3.0,
) -> Check:
    """Return the check that the steps of the ladder are right."""
    true = np.array([study["first_step"], *[study["other_steps"]] * 3])
    off = np.abs(steps.heights - true) / steps.uncertainties
    result = ", ".join(
        f"{height * 1e3:.1f} ± {error * 1e3:.1f}"
        for height, error in zip(steps.heights, steps.uncertainties, strict=True)
    )
    if not np.isfinite(off).all():
        result = f"no range on {steps.wanted - steps.pixels} of {steps.wanted} pixels"
    wanted = ", ".join(f"{height * 1e3:.0f}" for height in true)
    check = holds(
        statement,
        bool((off <= significance).all()),
        found=result if "no range" in result else f"{result} mm",
        place=place,
        wanted=f"{wanted} mm, each within {significance:g} standard errors",
    )
    return replace(check, value=float(np.max(off)))
