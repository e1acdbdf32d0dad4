"""What the compiled loops are told of each candidate, and what they give back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = ["Nodes", "astray", "fill_columns", "see"]


Floats = NDArray[np.float64]
Index = NDArray[np.intp]

#: Columns of `Points.number`.
NUMBERS = (
    "rate",  # photoelectrons if all launched light came back [1/s]
    "shot",  # variance of either output per rate, 2 F / T [1/s]
    "dark",  # dark counts [1/s]
    "sky",  # photoelectrons by daylight without an analyser [1/s]
    "echo",  # reflectance over pi, cosine, window [1/sr]
    "passed",  # window [1]
    "phase_floor",  # [rad]
    "fluctuation",  # of the water from sample to sample [1]
    "water_change",  # between shots and scan [1]
    "column_uncertainty",  # of the water behind the target [1]
    "ratio_uncertainty",  # of depolarization ratios [1]
    "departure",  # of the water from the model of the joint estimation [1]
    "reference",  # variance of the fit of the shots over that of one shot [1]
    "shots",  # number of open-water shots [1]
    "pixels",  # number of pixels that share the water [1]
    "per_saturation",  # mean output over the largest linear one, per rate [s]
    "near",  # nearest slant range that is possible [m]
    "far",  # farthest one [m]
    "distance",  # slant range [m]
    "late",  # error of the correction for late light [m]
    "footprint",  # error by uneven light on a slope [m]
    "depth",  # modulation depth [1]
)
(
    RATE,
    SHOT,
    DARK,
    SKY,
    ECHO,
    PASSED,
    FLOOR,
    FLUCTUATION,
    CHANGE,
    COLUMN,
    RATIO,
    DEPARTURE,
    REFERENCE,
    SHOTS,
    PIXELS,
    SATURATION,
    NEAR,
    FAR,
    DISTANCE,
    LATE,
    FOOTPRINT,
    DEPTH,
) = range(len(NUMBERS))

#: Random terms of the phase error, then systematic ones.
RANDOM = ("shot", "dark", "daylight", "phase_floor", "fluctuation", "reference")
(R_SHOT, R_DARK, R_SKY, R_FLOOR, R_FLUCTUATION, R_REFERENCE) = range(6)
SYSTEMATIC = ("drift", "column", "ratio", "shift")
(B_DRIFT, B_COLUMN, B_RATIO, B_SHIFT) = range(4)

#: Columns of the result; the first six are variances [m^2], the next four biases [m].
RESULTS = (
    *RANDOM,
    *SYSTEMATIC,
    "wrong",  # probability of another interval [1]
    "astray",  # mean square error by it [m^2]
    "signal",  # largest target signal of a frequency, photoelectrons [1/s]
    "output",  # mean output over the largest linear one [1]
    "unseen",  # share of the frequencies whose phase is lost in noise [1]
    "channel",  # number of the channel that the range is from [1]
    "frequency_index",  # number of the frequency that is kept, -1 for all [1]
)
(O_WRONG, O_ASTRAY, O_SIGNAL, O_OUTPUT, O_UNSEEN, O_CHANNEL, O_TONE) = range(10, 17)

#: Ways to take the water out.
KEPT, ONE_FREQUENCY, OPEN_WATER, UNMIX, COMBINED, JOINT = range(6)


class Points(NamedTuple):
    """Candidates at distances, one a row."""

    number: Floats
    """`NUMBERS`, shape (point, ...)."""
    look: Index
    """Row of `Light`, shape (point,)."""
    reach: Index
    """Number of the distance, shape (point,)."""
    place: Index
    """Number of the place of the receiver, shape (point,)."""
    frequency_index: Index
    """Numbers of the frequencies of a set, -1 for none, shape (point, K)."""
    target_fraction: Floats
    """Share of the echo that each analyser passes, shape (point, channel) [1]."""
    water_fraction: Floats
    """The same of the water's light [1]."""
    has_analyser: NDArray[np.bool_]
    """Whether a channel has one, shape (channel,)."""


class Light(NamedTuple):
    """Light of all looks, as `amulor.design.column.Columns` has it."""

    overlap: Floats
    """F(d), shape (look, distance) [sr]."""
    mean: Floats
    """Water without modulation, shape (look, distance + 1) [1]."""
    water: NDArray[np.complex128]
    """Water at each frequency, shape (version, look, distance + 1, frequency); the
    first version is the water, the others have a little more absorption and scattering
    [1]."""
    step: float
    """Relative change of absorption and of scattering in these [1]."""
    frequency: Floats
    """Modulation frequencies, shape (frequency,) [Hz]."""
    path: Floats
    """Optical path, shape (place, distance) [m]."""
    slope: Floats
    """Derivative of the slant range by it, shape (place, distance) [1]."""
    offset: Floats
    """Optical path where the water begins, shape (place,) [m]."""


class Scratch(NamedTuple):
    """What a point sees, arrays over (frequency, channel) or one of them."""

    target: NDArray[np.complex128]
    """Target signal [1/s]."""
    water: NDArray[np.complex128]
    """Water in front of it [1/s]."""
    open_water: NDArray[np.complex128]
    """The whole column [1/s]."""
    change: NDArray[np.complex128]
    """Derivatives of the water by the logarithms of absorption and scattering, last
    axis the two; then those of the whole column [1/s]."""
    laser_rate: Floats
    """Photoelectrons by the laser, shape (channel,) [1/s]."""
    sky_rate: Floats
    """By daylight, shape (channel,) [1/s]."""
    open_rate: Floats
    """By the laser without a target, shape (channel,) [1/s]."""
    to_range: Floats
    """Range per phase, 0 where a set has no such frequency, shape (frequency,)
    [m/rad]."""
    variance: Floats
    """Phase variance by `RANDOM`, shape (frequency, 6) [rad^2]."""
    bias: Floats
    """Phase error by `SYSTEMATIC`, shape (frequency, 4) [rad]."""
    size: Floats
    """Modulus of what the phase is taken of, shape (frequency,) [1/s]."""


_LIGHT_SPEED = 299792458.0


@numba.njit(cache=True, error_model="numpy")
def see(p: int, points: Points, light: Light, scratch: Scratch) -> float:
    """Fill what a point sees, and return its mean output over the largest linear one.

    Signals are rates of photoelectrons; the phase is that of the delay.
    """
    x = points.number[p]
    look, reach, place = points.look[p], points.reach[p], points.place[p]
    end = light.mean.shape[1] - 1
    echo = x[ECHO] * light.overlap[look, reach]
    still = x[PASSED] * light.mean[look, reach]
    whole = x[PASSED] * light.mean[look, end]
    loudest = 0.0
    for c in range(points.target_fraction.shape[1]):
        of_target, of_water = points.target_fraction[p, c], points.water_fraction[p, c]
        scratch.laser_rate[c] = x[RATE] * (of_target * echo + of_water * still)
        scratch.open_rate[c] = x[RATE] * of_water * whole
        scratch.sky_rate[c] = x[SKY] * (0.5 if points.has_analyser[c] else 1.0)
        rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
        loudest = max(loudest, rate)
    for k in range(points.frequency_index.shape[1]):
        chosen = points.frequency_index[p, k]
        scratch.to_range[k] = 0.0
        if chosen < 0:
            continue
        wave = 2 * math.pi * light.frequency[chosen] / _LIGHT_SPEED
        scratch.to_range[k] = light.slope[place, reach] / wave
        phase = wave * light.path[place, reach]
        turn = complex(math.cos(phase), math.sin(phase))
        phase = wave * light.offset[place]
        before = complex(math.cos(phase), math.sin(phase)) * x[PASSED]
        for c in range(points.target_fraction.shape[1]):
            unit = x[RATE] * x[DEPTH]
            scratch.target[k, c] = unit * points.target_fraction[p, c] * echo * turn
            unit = unit * points.water_fraction[p, c]
            water = unit * before * light.water[0, look, reach, chosen]
            column = unit * before * light.water[0, look, end, chosen]
            scratch.water[k, c], scratch.open_water[k, c] = water, column
            for v in range(1, light.water.shape[0]):
                other = unit * before * light.water[v, look, reach, chosen]
                scratch.change[k, c, v - 1] = (other - water) / light.step
                other = unit * before * light.water[v, look, end, chosen]
                scratch.change[k, c, v + 1] = (other - column) / light.step
    return float(loudest * x[SATURATION])


@numba.njit(cache=True, error_model="numpy")
def across(value: complex, along: complex) -> float:
    """Return by what phase a small signal turns another one [rad]."""
    square = along.real * along.real + along.imag * along.imag
    if square == 0.0:
        return np.inf
    return (value.imag * along.real - value.real * along.imag) / square


#: Most intervals on either side that are looked at.
_MOST = 400


@numba.njit(cache=True, error_model="numpy")
def astray(
    to_range: Floats, variance: Floats, distance: float, near: float, far: float
) -> tuple[float, float]:
    """Return the probability of a wrong interval and the mean square error by it.

    Phases of the given variances [rad^2] and ranges per phase [m/rad], 0 for those that
    are not there. Candidates are the ranges that differ by whole intervals of the most
    precise frequency; each is taken with the chance Q(D / 2) that normal errors move
    the phases past the middle, D its distance in standard errors. Their sum is an upper
    limit, and nearly the probability where it is small.
    """
    best = -1
    total = 0.0
    for k in range(to_range.size):
        if to_range[k] <= 0.0 or not variance[k] < np.inf:
            continue
        precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
        total += precision
        if best < 0 or precision > 1.0 / (
            to_range[best] ** 2 * max(variance[best], 1e-18)
        ):
            best = k
    if best < 0:
        return 1.0, (far - near) ** 2 / 12
    step = 2 * math.pi * to_range[best]
    chance, square = 0.0, 0.0
    for sign in (-1.0, 1.0):
        room = (far - distance) if sign > 0 else (distance - near)
        count = min(math.floor(max(room, 0.0) / step * (1 + 1e-9)), _MOST)
        for m in range(1, count + 1):
            offset = sign * m * step
            first, second = 0.0, 0.0
            for k in range(to_range.size):
                if k == best or to_range[k] <= 0.0 or not variance[k] < np.inf:
                    continue
                own = 2 * math.pi * to_range[k]
                rest = offset - own * round(offset / own)
                precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
                first += precision * rest
                second += precision * rest * rest
            misfit = max(second - first * first / total, 0.0)
            each = 0.5 * math.erfc(0.5 * math.sqrt(misfit) / math.sqrt(2.0))
            chance += each
            square += each * offset * offset
    return min(chance, 1.0), square


class Nodes(NamedTuple):
    """Depths at which the light of a column is summed up."""

    segment: NDArray[np.intp]
    """Piece of the spline that each one lies in, shape (node,)."""
    within: Floats
    """Place in that piece, in logarithms of the depth, shape (node,)."""
    weight: Floats
    """Width that each one stands for, shape (node,) [m]."""
    turn: NDArray[np.complex128]
    """Phase factor, shape (node, frequency) [1]."""
    stop: NDArray[np.intp]
    """Number of nodes in front of each distance, increasing, shape (distance,)."""


@numba.njit(cache=True, error_model="numpy")
def fill_columns(
    piece: Floats,
    nodes: Nodes,
    mean: Floats,
    water: NDArray[np.complex128],
) -> None:
    """Fill the light of columns up to each distance, and to the end as the last one.

    `piece` is that of the logarithm of the overlap, (4, segment, look); `mean` has the
    shape (look, distance + 1), `water` (look, distance + 1, frequency).
    """
    count = nodes.stop.size
    sums = np.zeros(water.shape[2], dtype=np.complex128)
    for look in range(water.shape[0]):
        sums[:] = 0.0
        total = 0.0
        reached = 0
        for m in range(nodes.segment.size + 1):
            while reached < count and nodes.stop[reached] <= m:
                mean[look, reached] = total
                water[look, reached] = sums
                reached += 1
            if m == nodes.segment.size:
                break
            i, x = nodes.segment[m], nodes.within[m]
            value = piece[0, i, look] * x + piece[1, i, look]
            value = (value * x + piece[2, i, look]) * x + piece[3, i, look]
            light = nodes.weight[m] * np.exp(value)
            total += light
            for k in range(sums.size):
                sums[k] += light * nodes.turn[m, k]
        mean[look, count] = total
        water[look, count] = sums
