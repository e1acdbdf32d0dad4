"""What can be held against scans of the ladder: cut-off, phase of a step, heights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amulor.optics import low_pass, ranging
from amulor.simulation import backscatter
from amulor.studies.ricci2010.checks import Check, holds
from amulor.studies.ricci2010.scenes.ladder_scans import Steps
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey


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
