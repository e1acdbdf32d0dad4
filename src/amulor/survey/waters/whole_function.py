"""Phase function of any kind of water over all angles, for small-angle models."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import phase_functions
from amulor.optics.phase_functions.models import henyey_greenstein_function, isotropic
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import tabulated
from amulor.survey.properties import WaterProperties
from amulor.survey.survey import Survey
from amulor.survey.view import (
    View,
    beam_arguments,
    has_sharp_receiver,
    kernel_arguments,
    refuse_layers,
)
from amulor.survey.water import Water
from amulor.survey.waters.phase_function import phase_function as stated_phase_function

__all__ = [
    "gaussian_arguments",
    "phase_function_of",
    "whole_function_arguments",
    "whole_phase_function",
]

#: Scattering beyond the split angle up to which a survey may call it none [1].
NEGLIGIBLE = 0.02
#: Range in which the shape k of the curve beyond the split angle is searched.
_LOWEST, _HIGHEST = -5.0, 12.0
_POINTS = 2000
#: Replaces a phase function of 0 at 180 degrees; the models use the survey's value
#: there [1/sr].
_DARK = 1e-6

Array = NDArray[np.float64]


def phase_function_of(water: Water | WaterProperties) -> PhaseFunction:
    r"""Return the phase function of a survey's water, for all angles.

    Let :math:`u = (\cos\theta_s - \cos\theta) / (\cos\theta_s + 1)`, which is 0 at the
    split angle and 1 at 180 degrees. For k = 0, :math:`\ln p` is a straight line in u
    between its values at both ends. For k > 0, :math:`4 k u (1 - u)` is added; for
    k < 0, it is a straight line in :math:`u^{e^k}`. k is chosen such that the integral
    is right. If the stated scattering beyond the split angle is smaller than that of
    any such curve, the straight line is used, provided that it puts at most 2 % there.
    """
    if water.scattering == 0:
        return isotropic()
    if isinstance(water, WaterProperties):
        if water.phase_function is not None:
            return water.phase_function
        moment: float | None = water.second_moment
        fraction: float | None = water.forward_scattering / water.scattering
        backwards: float | None = water.backscatter_vsf / water.scattering
    else:
        if water.phase_function is not None:
            return stated_phase_function(water.phase_function)
        if water.asymmetry is not None:
            return henyey_greenstein_function(asymmetry=water.asymmetry)
        moment, fraction = water.second_moment, water.forward_fraction
        backwards = water.phase_function_at_180
    if not moment or not fraction or not backwards:
        raise SurveyError(
            "the models need the whole phase function; it follows from a "
            "second_moment, a forward_fraction and a phase_function_at_180 above 0, "
            f"got {moment!r} rad^2, {fraction!r} and {backwards!r} 1/sr: state them, "
            "or an asymmetry"
        )
    # One function for water of any turbidity, although coefficients differ in the last
    # bits.
    moments = (float(f"{value:.12g}") for value in (moment, fraction, backwards))
    return _joined(*moments, split=water.split_angle)


def whole_function_arguments(
    survey: Survey, water: WaterProperties, view: View
) -> dict[str, Any]:
    """Return keyword arguments for the functions of the small-angle model.

    For water that states moments only, `phase_function_of` computes a phase function
    from them. Water without forward scattering needs none: all scattered light is lost.
    """
    refuse_layers(water, model="the small-angle model")
    arguments = kernel_arguments(survey, water, view)
    forward, moment = (
        arguments.pop("forward_scattering"),
        arguments.pop("second_moment"),
    )
    diffuse = arguments.pop("diffuse_scattering")
    if forward * moment == 0:
        # Scattering by an angle of zero counts as no scattering.
        arguments["absorption"] = arguments["absorption"] + diffuse
        beam = beam_arguments(survey, water)
        return {**arguments, **beam, "scattering": 0.0, **_no_scattering()}
    try:
        function = whole_phase_function(water)
    except SurveyError as problem:
        raise SurveyError(
            f"{problem}; or choose the diffusion model, which needs moments only"
        ) from None
    return {
        **arguments,
        **beam_arguments(survey, water),
        "scattering": water.scattering,
        "phase_function": function,
        "split_angle": water.split_angle,
    }


def gaussian_arguments(
    survey: Survey, water: WaterProperties, view: View
) -> dict[str, Any]:
    """Return the arguments with a Gaussian receiver of equal mean square width."""
    arguments = whole_function_arguments(survey, water, view)
    if has_sharp_receiver(survey):
        for name in ("receiver_radius", "acceptance_angle"):
            arguments[name] = arguments[name] / math.sqrt(2)
    return arguments


@lru_cache(maxsize=8)
def whole_phase_function(water: WaterProperties) -> PhaseFunction:
    """Return the phase function of water for all angles; cached."""
    if water.phase_function is None and water.backscatter_vsf == 0:
        # Small-angle models need the forward part, which has a curve to continue.
        water = replace(water, backscatter_vsf=_DARK * water.scattering)
    return phase_function_of(water)


@lru_cache(maxsize=1)
def _no_scattering() -> dict[str, Any]:
    """Return the phase-function arguments of water that does not scatter."""
    return {"phase_function": isotropic(), "split_angle": np.pi / 2}


@lru_cache(maxsize=32)
def _joined(
    moment: float, fraction: float, backwards: float, *, split: float
) -> PhaseFunction:
    """Return a phase function with given moment, forward fraction and backscatter."""
    from scipy.optimize import brentq

    g = asymmetry_of(moment, split=split)
    forward = henyey_greenstein_function(asymmetry=g)
    below, _ = forward.forward_split(split)
    # Dense where the curve may fall steeply, at the split angle.
    theta = split + (np.pi - split) * np.linspace(0, 1, _POINTS) ** 3
    u = (math.cos(split) - np.cos(theta)) / (math.cos(split) + 1)
    weight = 2 * np.pi * np.sin(theta)

    def beyond(k: float, diffuse_fraction: float) -> Array:
        start = (1 - diffuse_fraction) * float(forward(split)) / below
        along = u ** math.exp(min(k, 0.0))
        line = math.log(start) + along * math.log(backwards / start)
        curve: Array = np.exp(line + 4 * max(k, 0.0) * u * (1 - u))
        return curve

    def excess(k: float, diffuse_fraction: float) -> float:
        return (
            float(np.trapezoid(weight * beyond(k, diffuse_fraction), theta))
            - diffuse_fraction
        )

    diffuse_fraction, k = 1 - fraction, 0.0
    if (
        diffuse_fraction > 0
        and excess(_LOWEST, diffuse_fraction) * excess(_HIGHEST, diffuse_fraction) < 0
    ):
        k = float(brentq(excess, _LOWEST, _HIGHEST, args=(diffuse_fraction,)))
    else:
        straight = float(brentq(lambda value: excess(0.0, value), 0.0, 1 - 1e-9))
        if not (diffuse_fraction < straight <= NEGLIGIBLE):
            raise SurveyError(
                f"no smooth phase function has a forward_fraction of {fraction:g} with "
                f"a phase_function_at_180 of {backwards:g} 1/sr and a second_moment of "
                f"{moment:g} rad^2: these alone put {straight:.3g} of the scattering "
                f"beyond {math.degrees(split):g} deg; state an asymmetry, or moments "
                "that fit"
            )
        diffuse_fraction = straight
    head = np.concatenate([[0.0], np.geomspace(1e-5, split, _POINTS)[:-1]])
    return tabulated(
        np.concatenate([head, theta]),
        value=np.concatenate(
            [
                (1 - diffuse_fraction) / below * forward(head),
                beyond(k, diffuse_fraction),
            ]
        ),
        name=f"Henyey-Greenstein forwards (g = {g:.4f}), then to {backwards:g} 1/sr",
    )


@lru_cache(maxsize=32)
def asymmetry_of(moment: float, *, split: float) -> float:
    """Return the asymmetry that has a given second moment below the split angle [1]."""
    from scipy.optimize import brentq

    def excess(g: float) -> float:
        value = phase_functions.henyey_greenstein_second_moment(
            asymmetry=g, split_angle=split
        )
        return float(value) - moment

    lowest, highest = 0.0, 1 - 1e-7
    if not excess(highest) < 0 < excess(lowest):
        raise SurveyError(
            f"second_moment must be from {moment + excess(highest):.3g} to "
            f"{moment + excess(lowest):.3g} rad^2 for a Henyey-Greenstein peak below "
            f"{math.degrees(split):g} deg, got {moment:g} rad^2"
        )
    return float(brentq(excess, lowest, highest, xtol=1e-12))
