"""Water signal of the long tank over modulation frequency, by four models."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from amulor.optics import low_pass, phase_functions, small_angle, small_angle_diffusion
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.simulation.transport import half_power, relative_amplitude_uncertainty
from amulor.studies.ricci2010.study import Study
from amulor.transport import GaussianReceiver, Medium, Source, Tally, simulate

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Turbidity = Literal["low", "high"]
Response = Callable[[Floats], Complex]

TURBIDITIES: tuple[Turbidity, Turbidity] = ("low", "high")
#: Names of the models, as legends and checks call them.
SIMPLE, REALISTIC = "simple water, diffusion form", "realistic water, diffusion form"
SMALL_ANGLE = "realistic water, small-angle form"
MONTE_CARLO = "realistic water, Monte Carlo"
#: Points of a curve, relative error of the photons at 0 Hz, and most of them: of a
#: quick study, and of a full one.
_POINTS = {True: 56, False: 221}
_ERROR = {True: 0.04, False: 0.003}
_HISTORIES = {True: 96_000, False: 16_000_000}
#: Parts of the photons that are left out in turn to find the error of a fit.
_PARTS = 16


@dataclass(frozen=True, kw_only=True)
class Water:
    """Optical properties of the water at one turbidity."""

    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    second_moment: float
    """Second moment <theta^2> of the forward part [rad^2]."""
    split_angle: float
    """Angle between forward and diffuse scattering [rad]."""
    phase_function: PhaseFunction
    """Henyey-Greenstein phase function with the given second moment."""

    @property
    def realistic(self) -> dict[str, float]:
        """Arguments of the diffusion model, with forward and diffuse scattering."""
        fraction, _ = self.phase_function.forward_split(self.split_angle)
        return {
            "absorption": self.absorption,
            "forward_scattering": fraction * self.scattering,
            "diffuse_scattering": (1 - fraction) * self.scattering,
            "second_moment": self.second_moment,
        }

    @property
    def simple(self) -> dict[str, float]:
        """Arguments of the diffusion model, with diffuse scattering only."""
        return {
            "absorption": 0.0,
            "forward_scattering": 0.0,
            "diffuse_scattering": self.absorption + self.scattering,
            "second_moment": 0.0,
        }


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Normalized amplitude over frequency by one model, with its cut-offs."""

    name: str
    """Name of the model."""
    amplitude: Floats
    """Amplitude relative to 0 Hz, at the frequencies of the sweep [1]."""
    cut_off: float
    """Half-power frequency [Hz]."""
    fitted: float
    """Cut-off frequency by an unconstrained fit of eq. (71) to amplitudes [Hz]."""
    of_power: float
    """Cut-off frequency by a fit of eq. (71) to normalized squared amplitudes [Hz]."""
    at_cut_off: float
    """Amplitude at the cut-off frequency rounded to 10 kHz [1]."""
    cut_off_error: float = 0.0
    """Standard error of the half-power frequency [Hz]."""
    fitted_error: float = 0.0
    """Standard error of the fitted cut-off frequency [Hz]."""
    ratio_error: float = 0.0
    """Standard error of the ratio of fitted to half-power cut-off [1]."""
    of_power_error: float = 0.0
    """Standard error of the cut-off fitted to squares [Hz]."""
    of_power_ratio_error: float = 0.0
    """Standard error of the ratio of `of_power` to the half-power cut-off [1]."""
    band: Floats | None = None
    """Standard errors of the amplitudes [1]."""


@dataclass(frozen=True, kw_only=True)
class Squares:
    """Synthetic measurement of a frequency sweep, with fits of eq. (71)."""

    frequency: Floats
    """Modulation frequencies [Hz]."""
    amplitude: Floats
    """Amplitudes relative to the true amplitude at 0 Hz [1]."""
    made_with: float
    """True half-power frequency of the synthetic measurement [Hz]."""
    fit: low_pass.LowPassFit
    """Unconstrained fit of eq. (71) to the amplitudes."""
    of_power: low_pass.LowPassFit
    """Fit of eq. (71) to the normalized squared amplitudes."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Curves and synthetic measurements of figure 3 or 4."""

    turbidity: Turbidity
    """Name of the turbidity: "low" or "high"."""
    attenuation: float
    """Attenuation coefficient k [1/m]."""
    water: Water
    """Optical properties of the water."""
    frequency: Floats
    """Modulation frequencies of the curves [Hz]."""
    simple: Curve
    """Dashed curve: diffusion model with attenuation by diffuse scattering only."""
    realistic: Curve
    """Solid curve: diffusion model of the realistic water."""
    small_angle: Curve
    """Small-angle model of the realistic water, unscattered light included."""
    monte_carlo: Curve
    """Monte Carlo transport in the realistic water, all scattering orders."""
    squares: Squares
    """Synthetic measurement of the solid curve."""
    first_order: Squares
    """Synthetic measurement of a first-order low-pass with the same half-power
    frequency.
    """

    @property
    def curves(self) -> tuple[Curve, ...]:
        """Curves of all four models."""
        return self.simple, self.realistic, self.small_angle, self.monte_carlo


def water(study: Study, turbidity: Turbidity) -> Water:
    """Return the optical properties of the water at one turbidity."""
    return study.once(_WATER[turbidity])


def sweep(study: Study, turbidity: Turbidity) -> Sweep:
    """Return the frequency sweep of figure 3 (low) or 4 (high)."""
    return study.once(_SWEEP[turbidity])


def receiver(study: Study) -> dict[str, float]:
    """Return the receiver of the long tank, as arguments of the water signal."""
    return {
        "baseline": study["long_baseline"],
        "receiver_radius": study["receiver_radius"],
        "acceptance_angle": study["acceptance"],
    }


def asymmetry(second_moment: float, *, split_angle: float) -> float:
    """Return the Henyey-Greenstein asymmetry for a given second moment."""

    def excess(g: float) -> float:
        result = phase_functions.henyey_greenstein_second_moment(
            asymmetry=g, split_angle=split_angle
        )
        return float(result) - second_moment

    return float(brentq(excess, 0.0, 0.9999, xtol=1e-13))


def forward_fraction(second_moment: float, *, split_angle: float) -> float:
    """Return the Henyey-Greenstein forward fraction for a given second moment."""
    g = asymmetry(second_moment, split_angle=split_angle)
    fraction, _ = henyey_greenstein_function(asymmetry=g).forward_split(split_angle)
    return float(fraction)


def _phase_function(study: Study, *, turbidity: Turbidity) -> PhaseFunction:
    g = asymmetry(study[f"second_moment_{turbidity}"], split_angle=study["split_angle"])
    return henyey_greenstein_function(asymmetry=g)


def _water(study: Study, *, turbidity: Turbidity) -> Water:
    attenuation, fraction = study[f"attenuation_{turbidity}"], study["absorption_share"]
    return Water(
        absorption=fraction * attenuation,
        scattering=(1 - fraction) * attenuation,
        second_moment=study[f"second_moment_{turbidity}"],
        split_angle=study["split_angle"],
        # Cached, since the small-angle model has a table for each one.
        phase_function=study.once(_PHASE_FUNCTION[turbidity]),
    )


def _photons(study: Study, *, turbidity: Turbidity) -> Tally:
    medium, place = water(study, turbidity), receiver(study)
    return simulate(
        Medium.homogeneous(
            absorption=medium.absorption,
            scattering=medium.scattering,
            phase_function=medium.phase_function,
            group_index=study["index"],
        ),
        Source(),
        GaussianReceiver(
            position=(place["baseline"], 0.0, 0.0),
            radius=place["receiver_radius"],
            acceptance_angle=place["acceptance_angle"],
        ),
        np.concatenate([[0.0], _frequencies(study)]),
        histories=_HISTORIES[study.quick],
        seed=int(study.rng(f"photons, {turbidity} turbidity").integers(2**31)),
        relative_error=_ERROR[study.quick],
    )


def _sweep(study: Study, *, turbidity: Turbidity) -> Sweep:
    medium, frequency = water(study, turbidity), _frequencies(study)
    place: dict[str, Any] = receiver(study) | {"group_index": study["index"]}

    def simple(f: Floats) -> Complex:
        return small_angle_diffusion.water_response(
            f, **medium.simple, backscatter_vsf=1.0, **place
        )

    def realistic(f: Floats) -> Complex:
        return small_angle_diffusion.water_response(
            f, **medium.realistic, backscatter_vsf=1.0, **place
        )

    def whole(f: Floats) -> Complex:
        return small_angle.water_response(
            f,
            absorption=medium.absorption,
            scattering=medium.scattering,
            phase_function=medium.phase_function,
            split_angle=medium.split_angle,
            **place,
        )

    diffusion = _curve(REALISTIC, realistic, frequency)

    def first_order(f: Floats) -> Complex:
        return low_pass.first_order_response(f, cut_off=diffusion.cut_off)

    return Sweep(
        turbidity=turbidity,
        attenuation=medium.absorption + medium.scattering,
        water=medium,
        frequency=frequency,
        simple=_curve(SIMPLE, simple, frequency),
        realistic=diffusion,
        small_angle=_curve(SMALL_ANGLE, whole, frequency),
        monte_carlo=_traced(study.once(_PHOTONS[turbidity])),
        squares=_measured(
            study, f"water sweep, {turbidity} turbidity", realistic, diffusion.cut_off
        ),
        first_order=_measured(
            study, f"(71), {turbidity} turbidity", first_order, diffusion.cut_off
        ),
    )


def _frequencies(study: Study) -> Floats:
    """Return evenly spaced frequencies for the curves, over the measured band [Hz]."""
    return np.linspace(study["sweep_first"], study["sweep_last"], _POINTS[study.quick])


def _curve(name: str, response: Response, frequency: Floats) -> Curve:
    """Return the curve of a closed-form model."""
    corner = low_pass.cut_off(response)
    reported = round(corner, -4)
    still, modulated = np.abs(response(np.array([0.0, reported])))
    amplitude = np.abs(response(frequency)) / still
    return Curve(
        name=name,
        amplitude=amplitude,
        cut_off=corner,
        fitted=low_pass.fit(frequency, amplitude).cut_off,
        of_power=low_pass.fit_of_power(frequency, amplitude).cut_off,
        at_cut_off=float(modulated / still),
    )


def _traced(tally: Tally) -> Curve:
    """Return the curve of a Monte Carlo run with 0 Hz as first frequency."""
    frequency = tally.modulation_frequency
    corner, error = half_power(tally)
    amplitude = np.abs(tally.signal) / abs(tally.signal[0])
    fits = (low_pass.fit, low_pass.fit_of_power)
    fitted, of_power = (f(frequency[1:], amplitude[1:]).cut_off for f in fits)
    corners = []
    for signal in _left_out(tally):
        part = np.abs(signal) / abs(signal[0])
        half = float(np.interp(-math.sqrt(0.5), -part, frequency))
        corners.append([f(frequency[1:], part[1:]).cut_off for f in fits] + [half])
    free, power, halves = np.transpose(corners)
    return Curve(
        name=MONTE_CARLO,
        amplitude=amplitude[1:],
        cut_off=corner,
        fitted=fitted,
        of_power=of_power,
        at_cut_off=float(np.interp(round(corner, -4), frequency, amplitude)),
        cut_off_error=error,
        fitted_error=_jackknife(free),
        ratio_error=_jackknife(free / halves),
        of_power_error=_jackknife(power),
        of_power_ratio_error=_jackknife(power / halves),
        band=relative_amplitude_uncertainty(tally)[1:],
    )


def _left_out(tally: Tally) -> list[Complex]:
    """Return jackknife replicates of the signals, with parts of the batches omitted."""
    values = tally.batches.sum(axis=1)[:, 0]
    number = np.arange(values.shape[0])
    signals: list[Complex] = []
    for part in range(min(_PARTS, number.size)):
        chosen = number % _PARTS != part
        signals.append(
            np.average(values[chosen], axis=0, weights=tally.histories_of[chosen])
        )
    return signals


def _jackknife(left_out: Floats) -> float:
    """Return the jackknife standard error from jackknife replicates."""
    return math.sqrt((left_out.size - 1) * float(np.var(left_out)))


def _measured(study: Study, label: str, response: Response, corner: float) -> Squares:
    """Return a frequency sweep with noise added in both quadratures."""
    span = study["sweep_last"] - study["sweep_first"]
    count = round(span / study["sweep_step"]) + 1
    frequency = np.linspace(study["sweep_first"], study["sweep_last"], count)
    still = abs(response(np.zeros(1))[0])
    rng = study.rng(label)
    noise = rng.normal(size=count) + 1j * rng.normal(size=count)
    signal = response(frequency) / still + study["amplitude_noise"] * noise
    amplitude = np.abs(signal)
    return Squares(
        frequency=frequency,
        amplitude=amplitude,
        made_with=corner,
        fit=low_pass.fit(frequency, amplitude),
        of_power=low_pass.fit_of_power(frequency, amplitude),
    )


# The study remembers results by function, so each turbidity has its own.
_PHASE_FUNCTION = {t: partial(_phase_function, turbidity=t) for t in TURBIDITIES}
_WATER = {t: partial(_water, turbidity=t) for t in TURBIDITIES}
_PHOTONS = {t: partial(_photons, turbidity=t) for t in TURBIDITIES}
_SWEEP = {t: partial(_sweep, turbidity=t) for t in TURBIDITIES}
