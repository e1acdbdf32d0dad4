"""Readings of a pixel in turn from a vehicle: the rate of the path, and its error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import search as joint_search
from amulor.rejection.joint.normal import (
    Fitted,
    foreground,
    modelled,
    path_derivatives,
    water_at,
)
from amulor.rejection.joint.priors import Shared
from amulor.rejection.joint.samples import Pixels, weight
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Steps of the path rate, and its largest size in prior standard deviations [1].
_STEPS, _FARTHEST = 2, 4.0
#: Relative change of the amplitude over the change of the optical path, by distance,
#: light that is lost, and another place on the surface [1/m]; largest change [1].
_AMPLITUDE, _MOST = 10.0, 0.1


def at_instant(
    pixels: Pixels,
    path: Floats,
    rate: Floats | None,
    state: Shared,
    phase_per_path: Floats,
) -> Pixels:
    """Return samples as if all readings of a pixel were at the instant of its path.

    `rate` is in prior standard deviations. None means unknown, which is an error of the
    readings. The echo is turned back by the change of its path since this instant. The
    water does not move with the vehicle. The change of the amplitude of the echo is an
    error of the readings.
    """
    if pixels.motion is None:
        return pixels
    at = np.where(np.isfinite(path), path, np.inf)
    _, water, _ = water_at(pixels, at, state.table, phase_per_path)
    light = state.water_signal(water, foreground(pixels, state.table, phase_per_path))
    steady, bend = pixels.motion[..., 0], pixels.motion[..., 1]
    if rate is None:
        rate, bend = np.zeros(len(pixels)), np.hypot(steady, bend)
    turn = np.exp(-1j * phase_per_path * steady * rate[:, None, None])
    echo = np.where(pixels.usable, pixels.signal - light, 0.0) * turn
    along = np.minimum(_AMPLITUDE * np.abs(steady), _MOST) * echo
    across = 1j * np.minimum(phase_per_path * bend, _MOST) * echo
    return replace(
        pixels,
        signal=np.where(pixels.usable, echo + light, 0.0),
        covariance=pixels.covariance.turned(turn) + _spread(along) + _spread(across),
    )


def _spread(error: Complex) -> Covariance:
    """Return the covariance of errors along phasors, one standard deviation long."""
    return Covariance(error.real**2, error.imag**2, error.real * error.imag)


def estimates_of(
    pixels: Pixels,
    state: Shared,
    *,
    transfer: Complex,
    phase_per_path: Floats,
    start: Floats | None = None,
    still: bool = False,
) -> Estimates:
    """Estimate paths, and the rates at which they change from reading to reading.

    The rate of a pixel is a parameter with a normal prior, or an error if `still`. Its
    error is correlated over the readings of the pixel, and part of the variance of the
    path.
    """

    def estimate(pixels: Pixels, start: Floats | None) -> Estimates:
        return joint_search.estimate(
            joint_search.without_foreground(
                pixels, state.table, strength=state.foreground,
                phase_per_path=phase_per_path,
            ),
            weight(pixels, None, state.noise_scale),
            state.table,
            gain=state.gain,
            transfer=transfer * (1 + state.echo),
            phase_per_path=phase_per_path,
            fluctuation=state.fluctuation,
            front=state.foreground,
            start=start,
        )  # fmt: skip

    if pixels.motion is None or not len(pixels):
        return estimate(pixels, start)
    rate = np.zeros(len(pixels))
    before = np.full(len(pixels), np.inf) if start is None else start
    found = estimate(at_instant(pixels, before, None, state, phase_per_path), start)
    if still:
        return found

    def now() -> Pixels:
        return at_instant(pixels, found.path, rate, state, phase_per_path)

    def equations() -> _Equations:
        return _equations(
            now(), found, state, transfer=transfer, phase_per_path=phase_per_path
        )

    for step in range(_STEPS):
        rate = np.clip(rate + equations().step(rate), -_FARTHEST, _FARTHEST)
        again = np.nan_to_num(found.path)
        is_last = start is None and step == _STEPS - 1
        found = estimate(now(), None if is_last else again)
    return _with_rate_errors(found, rate, equations())


@dataclass(frozen=True)
class _Equations:
    """Normal equations of path and rate, with the amplitudes eliminated, by pixel."""

    path: Floats
    """Information on the path at a known rate [1/m^2]."""
    mixed: Floats
    """Cross information of path and rate [1/m]."""
    rate: Floats
    """Information on the rate, without its prior [1]."""
    downhill: Floats
    """Negative half gradient of chi-square by the rate, without its prior [1]."""
    pull: Complex
    """Change of this gradient by each sample, (pixel, channel, frequency) [1/V]."""

    def step(self, rate: Floats) -> Floats:
        """Return the step of the rate, with the path that follows it [1]."""
        left = self.rate - np.divide(
            self.mixed**2, self.path, out=np.zeros_like(rate), where=self.path > 0
        )
        return np.asarray((self.downhill - rate) / (1 + np.maximum(left, 0.0)))


def _equations(
    pixels: Pixels,
    found: Estimates,
    state: Shared,
    *,
    transfer: Complex,
    phase_per_path: Floats,
) -> _Equations:
    """Return the normal equations of path and rate at the estimates of pixels."""
    assert pixels.motion is not None
    path = np.where(np.isfinite(found.path), found.path, np.inf)
    fitted = Fitted(pixels, path, found.amplitude)
    model = modelled(state, fitted, transfer=transfer, phase_per_path=phase_per_path)
    deviation = None
    if state.fluctuation > 0:
        deviation = state.fluctuation * model.water_signal
    inverse = weight(pixels, deviation, state.noise_scale)
    echo = np.broadcast_to(
        (model.echo * (1 + state.echo))[:, None], pixels.signal.shape
    )
    by_path = path_derivatives(state, fitted, model, phase_per_path)
    by_rate = pixels.motion[..., 0] * by_path
    weighed = [_weighed(inverse, column) for column in (echo, by_path, by_rate)]

    def dot(first: Complex, second: Complex) -> Floats:
        return np.asarray((first.real * second.real + first.imag * second.imag).sum(-1))

    square = dot(weighed[0], echo)
    has_echo = (found.amplitude > 0) & (square > 0)
    share = np.where(has_echo, 1 / np.where(square > 0, square, 1.0), 0.0)
    path_echo, rate_echo = dot(weighed[1], echo), dot(weighed[2], echo)
    pull = weighed[2] - (share * rate_echo)[..., None] * weighed[0]

    def eliminated(values: Floats, first: Floats, second: Floats) -> Floats:
        return np.asarray((values - share * first * second).sum(axis=1))

    return _Equations(
        path=eliminated(dot(weighed[1], by_path), path_echo, path_echo),
        mixed=eliminated(dot(weighed[1], by_rate), path_echo, rate_echo),
        rate=eliminated(dot(weighed[2], by_rate), rate_echo, rate_echo),
        downhill=dot(pull, model.residual).sum(axis=1),
        pull=pull,
    )


def _weighed(inverse: Floats, values: Complex) -> Complex:
    """Multiply values by the inverse covariance of the samples."""
    xx, xy, yy = (inverse[..., k, :] for k in range(3))
    return np.asarray(
        xx * values.real + xy * values.imag + 1j * (xy * values.real + yy * values.imag)
    )


def _with_rate_errors(
    found: Estimates, rate: Floats, equations: _Equations
) -> Estimates:
    """Return estimates with the error of the rate in the variance of the path."""
    ratio = equations.mixed / (1 + equations.rate)
    information = found.information - ratio * equations.mixed
    known = (found.information > 0) & (information > 0)
    safe = np.where(known, information, 1.0)
    wide = np.where(known, np.sqrt(found.information / safe), 1.0)
    turned = np.where(known, ratio / safe, 0.0)[:, None, None]
    return replace(
        found,
        cost=found.cost + rate**2,
        information=np.where(known, information, found.information),
        lower=found.lower * wide,
        upper=found.upper * wide,
        influence=found.influence * (wide**2)[:, None, None] - turned * equations.pull,
        rate=rate,
    )
