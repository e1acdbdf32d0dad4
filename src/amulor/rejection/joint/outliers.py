"""Samples that disagree with the rest of their pixel, left out one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint.pixels import Pixels
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Probability that the sample that disagrees most of a good pixel is left out [1].
CHANCE = 1e-3
#: Part of the samples of a pixel that may be left out: the breakdown point [1].
BREAKDOWN = 1 / 3
#: Another sample that explains the last disagreement as well, but for this in
#: chi-square, leaves open which of both is wrong [1].
MARGIN = 9.0
#: A frequency that more of the pixels would lose in a channel shows that the model is
#: wrong there, not the pixels; so does one that some would lose, many times more than
#: lose another one, beyond standard errors of chance [1].
_MANY, _TIMES, _CHANCES = 0.15, 3.0, 4.0


@dataclass(frozen=True)
class Kept:
    """Pixels without the samples that disagree."""

    pixels: Pixels
    """Samples, of which those that are left out do not count."""
    estimates: Estimates
    """Estimates from the rest."""
    unsettled: Bools
    """Pixels in which it stays open which samples are wrong."""

    def restored(
        self, pixels: Pixels, estimates: Estimates, which: NDArray[np.intp]
    ) -> Kept:
        """Return this with all samples of some pixels."""
        if not len(which):
            return self
        usable, unsettled = self.pixels.usable.copy(), self.unsettled.copy()
        usable[which], unsettled[which] = pixels.usable[which], False
        found = {}
        for f in fields(estimates):
            found[f.name] = getattr(self.estimates, f.name).copy()
            found[f.name][which] = getattr(estimates, f.name)[which]
        signal = np.where(usable, pixels.signal, 0.0)
        return Kept(
            replace(pixels, usable=usable, signal=signal),
            Estimates(**found),
            unsettled,
        )


def part_of(estimates: Estimates, which: NDArray[np.intp]) -> Estimates:
    """Return the estimates of some pixels."""
    return Estimates(
        **{f.name: getattr(estimates, f.name)[which] for f in fields(estimates)}
    )


def disagrees(estimates: Estimates, typical: float = 1.0) -> Bools:
    """Return in which pixels one sample disagrees with all others.

    Parameters
    ----------
    estimates : Estimates
        Solutions.
    typical : float, optional
        What chi-square is over its degrees of freedom in most pixels [1].

    Returns
    -------
    ndarray of bool
        Where chi-square falls by more without it than chance explains, at 1e-3 for a
        pixel: 2 log(n / 1e-3) of n samples of two outputs.
    """
    samples = np.maximum(estimates.used / 2, 1)
    return np.asarray(estimates.outlying > 2 * typical * np.log(samples / CHANCE))


def may_be_left_out(
    estimates: Estimates, shape: tuple[int, int], typical: float
) -> Bools:
    """Return the samples that are not wrong in far too many pixels.

    Parameters
    ----------
    estimates : Estimates
        Solutions of many pixels.
    shape : tuple of int
        Channels and frequencies.
    typical : float
        As in `disagrees` [1].

    Returns
    -------
    ndarray of bool, shape (channel, frequency)
        False where one pixel in seven disagrees, or far more than elsewhere: there it
        is the model that does. Particles and spikes prefer no frequency.
    """
    wrong = estimates.which[disagrees(estimates, typical)]
    count = np.bincount(wrong, minlength=shape[0] * shape[1])
    usual = float(np.median(count))
    most = _TIMES * usual + _CHANCES * np.sqrt(usual + 1)
    pixels = len(estimates.path)
    few = count <= min(most, max(_MANY * pixels, 1))
    return np.asarray(few.reshape(shape))


def without_outliers(
    pixels: Pixels,
    estimates: Estimates,
    again: Callable[[Pixels], Estimates],
    allowed: Bools,
    typical: float,
) -> Kept:
    """Return pixels and estimates without the samples that disagree with the rest.

    Parameters
    ----------
    pixels : Pixels
        Samples.
    estimates : Estimates
        Their solutions.
    again : callable
        From pixels to new solutions.
    allowed : ndarray of bool, shape (channel, frequency)
        Samples that may be left out.
    typical : float
        As in `disagrees` [1].

    Returns
    -------
    Kept
        At most a third of the samples of a pixel is left out.

    Notes
    -----
    A spike, a particle or a fish is in one sample, since the frequencies are measured
    one after the other. The sample that lowers chi-square most by its absence goes
    first, then all is estimated anew, other ambiguity intervals included. The
    likelihood is that of independent normal errors of which some, anywhere, have a mean
    of their own. It stays open which samples are wrong where another choice in the last
    step is as likely as 1 to 90, or more than a third would have to go.
    """
    frequencies = allowed.shape[1]
    usable = pixels.usable
    found = {f.name: getattr(estimates, f.name) for f in fields(estimates)}
    most = np.floor(BREAKDOWN * estimates.used / 2).astype(int)
    left = np.zeros(len(pixels), dtype=int)
    margin = np.full(len(pixels), np.inf)
    permitted = allowed.ravel()

    def next_ones(which: NDArray[np.intp], now: Estimates) -> NDArray[np.intp]:
        return which[disagrees(now, typical) & permitted[now.which]]

    every = np.arange(len(pixels))
    wrong = next_ones(every, estimates)
    stuck = np.zeros(len(pixels), dtype=bool)
    while len(wrong):
        stuck[wrong[left[wrong] >= most[wrong]]] = True
        wrong = wrong[left[wrong] < most[wrong]]
        if not len(wrong):
            break
        if usable is pixels.usable:
            usable = usable.copy()
            found = {name: values.copy() for name, values in found.items()}
        channel, frequency = np.divmod(found["which"][wrong], frequencies)
        usable[wrong, channel, frequency] = False
        left[wrong] += 1
        margin[wrong] = found["outlying"][wrong] - found["next_outlying"][wrong]
        rest = pixels.part(wrong)
        now = again(
            replace(
                rest,
                usable=usable[wrong],
                signal=np.where(usable[wrong], rest.signal, 0.0),
            )
        )
        for name, values in found.items():
            values[wrong] = getattr(now, name)
        wrong = next_ones(wrong, now)
    if usable is not pixels.usable:
        pixels = replace(
            pixels, usable=usable, signal=np.where(usable, pixels.signal, 0.0)
        )
        estimates = Estimates(**found)
    return Kept(pixels, estimates, stuck | ((left > 0) & (margin < MARGIN * typical)))
