"""The water signal in front of the target: open water less the column behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._progress import tell
from amulor.cube.tiles import Span
from amulor.optics.ambiguity import Choices
from amulor.rejection.covariance import Covariance, covariance_of
from amulor.rejection.reference import column
from amulor.rejection.reference.column_fraction import Column
from amulor.rejection.reference.fit import Reference
from amulor.rejection.reference.shots import (
    ShotsFit,
    drift_of,
    expected_at_pixels,
    fit_shots,
    fluctuation_of,
    shots_of,
)
from amulor.rejection.reference.turbidity import Turbidity, turbidity_of
from amulor.survey import Survey

Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class WaterFit:
    """What a scan and its shots tell of the water in front of the targets."""

    shots: ShotsFit
    """Interpolation of the shots over the scan."""
    told: Turbidity | None
    """What the shots tell of the survey's water; None without a survey."""
    choices: Choices | None
    """Choices between frequencies for the optical path; None without a survey."""
    column: Column | None
    """Fractions of the open water from behind the targets; None without a survey."""
    steeper: Column | None
    """The same in water that is more turbid by one standard uncertainty; None where
    the survey is taken as it stands."""


@dataclass(frozen=True, kw_only=True)
class WaterBeforeTarget:
    """Water signal of every sample, arrays of the shape of the samples."""

    fits: list[Reference]
    """The fits of the shots, frequency by frequency, channel by channel."""
    to_the_end: Complex
    """Water signal of the whole column, as the shots show it [V]."""
    difference: Complex
    """Samples less that: the target, and the water missing behind it [V]."""
    hidden_fraction: Complex | None
    """Fraction of `to_the_end` from behind the target; NaN where the distance is not
    settled, None if no survey describes the water [1]."""
    hidden_error: Covariance | None
    """Error of that fraction times `to_the_end`, from what the shots tell of the
    water, which all pixels share; None where the survey is taken as it stands [V^2]."""
    survey: Survey | None
    """The survey that the fraction was computed from."""
    turbidity: Turbidity | None
    """How the shots corrected it; None where it is taken as it stands."""
    told: Turbidity | None
    """What the shots tell of the survey's water, whether it was corrected or not."""
    signal: Complex
    """Water signal up to the target, or to the end where that is not known [V]."""
    fluctuation: Covariance
    """How `signal` fluctuates from sample to sample [V^2]."""
    common: Covariance
    """Error of the reference, which the pixels share [V^2]."""
    path: NDArray[np.float64]
    """Optical path out and back of every pixel, NaN where it is not settled [m]."""
    fit: WaterFit
    """What of it the whole scan tells."""

    @property
    def drift(self) -> Complex:
        """Relative change from the first to the last shot, 0 where it may be chance."""
        return drift_of(self.fits, self.signal.shape)


def water_before_target(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None,
    survey_is_right: bool = False,
    fit: WaterFit | None = None,
    span: Span | None = None,
) -> WaterBeforeTarget:
    """Return the water signal in front of the target of every sample.

    `survey_is_right` says that the survey's absorption and scattering are taken as they
    stand, not corrected by what the shots show. CubeError as `open_water`.
    """
    tell("open water at each pixel", 0.0)
    fits, by_shots = fit_shots(
        cube, shots_of(cube), fit=None if fit is None else fit.shots, span=span
    )
    samples = cube.amulor.signal.values
    water, common = expected_at_pixels(fits, samples.shape)
    difference = subtract(samples, water)
    text = cube.attrs.get("survey")
    survey, told, turbidity, hidden, steeper = None, None, None, None, None
    choices = None if fit is None else fit.choices
    behind = None if fit is None else fit.column
    steeper_behind = None if fit is None else fit.steeper
    path = np.full(samples.shape[2:], np.nan)
    if text:
        survey = Survey.from_text(text, name="survey in the cube")
        tell("turbidity that the shots tell", 0.2)
        told = None if fit is None else fit.told
        if told is None:
            told = turbidity_of(cube, survey, water, common)
        if not survey_is_right:
            turbidity, survey = told, told.survey
        errors = covariance_of(cube) + common
        tell("water behind the targets", 0.6)
        depth, path, choices = column.depth(
            cube, difference, errors, survey, interval=interval, fit=choices
        )
        paper = turbidity is not None and turbidity.paper
        hidden, behind = column.hidden_fraction(
            cube, survey, depth, paper=paper, fit=behind
        )
        if turbidity is not None:
            steeper, steeper_behind = column.hidden_fraction(
                cube, turbidity.steeper, depth, paper=paper, fit=steeper_behind
            )
    signal = water if hidden is None else (1 - np.nan_to_num(hidden)) * water
    return WaterBeforeTarget(
        fits=fits,
        to_the_end=water,
        difference=difference,
        hidden_fraction=hidden,
        hidden_error=(
            None
            if turbidity is None or hidden is None or steeper is None
            else column.hidden_error(water, hidden, steeper, misfit=turbidity.misfit)
        ),
        survey=survey,
        turbidity=turbidity,
        told=told,
        signal=signal,
        fluctuation=fluctuation_of(fits, signal),
        common=common,
        path=path,
        fit=WaterFit(
            shots=by_shots,
            told=told,
            choices=choices,
            column=behind,
            steeper=steeper_behind,
        ),
    )


def subtract(
    signal: NDArray[np.complex128], water_signal: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Take the water signal out of samples, in the memory of the samples.

    `amulor.optics.interference.target_signal`, (55)-(57) of Ricci et al. 2010, as
    rebuilt, without new memory: fetching that takes as long as the subtraction.
    """
    return np.subtract(signal, water_signal, out=signal)
