"""Compiled loops of instrument design: signals, phase errors and range errors."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor._compiled import numba

__all__ = [
    "Nodes",
    "assess",
    "astray",
    "fill_columns",
    "phase_errors",
    "range_information",
    "see",
]


Floats = NDArray[np.float64]
Index = NDArray[np.intp]

#: Columns of `Points.number`.
NUMBERS = (
    "rate",  # photoelectrons if all launched light came back [1/s]
    "shot",  # variance of either output per rate, 2 F / T [1/s]
    "dark",  # dark counts [1/s]
    "sky",  # photoelectrons by daylight without an analyzer [1/s]
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
    "depth",  # modulation depth [1]
    "motion",  # change of the range from reading to reading, rms [m]
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
    DEPTH,
    MOTION,
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
    "frequency_index",  # index of the selected frequency, -1 for all [1]
)
(O_WRONG, O_ASTRAY, O_SIGNAL, O_OUTPUT, O_UNSEEN, O_CHANNEL, O_TONE) = range(10, 17)

#: Ways to take the water out.
KEPT, ONE_FREQUENCY, OPEN_WATER, UNMIX, COMBINED, JOINT = range(6)


class Points(NamedTuple):
    """Pairs of candidate instrument and target distance, one pair per row."""

    number: Floats
    """Parameters of each point, in the columns `NUMBERS`, shape (point, ...)."""
    look: Index
    """Row of the arrays in `Light`, shape (point,)."""
    reach: Index
    """Index of the target distance, shape (point,)."""
    place: Index
    """Index of the receiver position, shape (point,)."""
    frequency_index: Index
    """Frequency indices of each point's set, -1 for none, shape (point, K)."""
    target_fraction: Floats
    """Fraction of the echo that each analyzer transmits, shape (point, channel) [1]."""
    water_fraction: Floats
    """Fraction of the water signal that each analyzer transmits [1]."""
    has_analyser: NDArray[np.bool_]
    """Whether each channel has an analyzer, shape (channel,)."""


class Light(NamedTuple):
    """Overlaps, water signals and optical paths of all receiver views and distances."""

    overlap: Floats
    """Overlap F of beam and receiver, shape (look, distance) [sr]."""
    mean: Floats
    """Unmodulated water signal, shape (look, distance + 1) [1]."""
    water: NDArray[np.complex128]
    """Water signal, shape (version, look, distance + 1, frequency);
    later versions have slightly more absorption or scattering [1].
    """
    step: float
    """Relative increase of absorption or scattering in the later versions [1]."""
    frequency: Floats
    """Modulation frequencies, shape (frequency,) [Hz]."""
    path: Floats
    """Two-way optical path, shape (place, distance) [m]."""
    slope: Floats
    """Derivative of the slant range by the optical path, shape (place, distance) [1].
    """
    offset: Floats
    """Optical path before the water, shape (place,) [m]."""


class Scratch(NamedTuple):
    """Work arrays for signals and errors at one point, by frequency and channel."""

    target: NDArray[np.complex128]
    """Target signal [1/s]."""
    water: NDArray[np.complex128]
    """Water signal before the target [1/s]."""
    open_water: NDArray[np.complex128]
    """Open-water signal, without a target [1/s]."""
    change: NDArray[np.complex128]
    """Derivatives of the water signal by log absorption and log scattering [1/s].

    Along the last axis: the two of the water before the target, then those of the whole
    column.
    """
    laser_rate: Floats
    """Photoelectron rate of the laser light, shape (channel,) [1/s]."""
    sky_rate: Floats
    """Photoelectron rate of daylight, shape (channel,) [1/s]."""
    open_rate: Floats
    """Photoelectron rate of the laser without a target, shape (channel,) [1/s]."""
    to_range: Floats
    """Range per phase, 0 for a missing frequency, shape (frequency,) [m/rad]."""
    variance: Floats
    """Phase variance by each term of `RANDOM`, shape (frequency, 6) [rad^2]."""
    bias: Floats
    """Phase bias by each term of `SYSTEMATIC`, shape (frequency, 4) [rad]."""
    size: Floats
    """Modulus of the signal used for ranging, shape (frequency,) [1/s]."""


_LIGHT_SPEED = 299792458.0


@numba.njit(cache=True, error_model="numpy")
def see(p: int, points: Points, light: Light, scratch: Scratch) -> float:
    """Compute signals at a point; return the largest channel output over its limit.

    Signals are photoelectron rates, with the phase of the delay.
    """
    x = points.number[p]
    look, reach, place = points.look[p], points.reach[p], points.place[p]
    end = light.mean.shape[1] - 1
    echo = x[ECHO] * light.overlap[look, reach]
    still = x[PASSED] * light.mean[look, reach]
    open_mean = x[PASSED] * light.mean[look, end]
    loudest = 0.0
    for c in range(points.target_fraction.shape[1]):
        of_target, of_water = points.target_fraction[p, c], points.water_fraction[p, c]
        scratch.laser_rate[c] = x[RATE] * (of_target * echo + of_water * still)
        scratch.open_rate[c] = x[RATE] * of_water * open_mean
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
                changed = unit * before * light.water[v, look, reach, chosen]
                scratch.change[k, c, v - 1] = (changed - water) / light.step
                changed = unit * before * light.water[v, look, end, chosen]
                scratch.change[k, c, v + 1] = (changed - column) / light.step
    return float(loudest * x[SATURATION])


@numba.njit(cache=True, error_model="numpy")
def across(value: complex, along: complex) -> float:
    """Phase shift of a signal due to an added small signal [rad]."""
    square = along.real * along.real + along.imag * along.imag
    if square == 0.0:
        return np.inf
    return (value.imag * along.real - value.real * along.imag) / square


#: Largest number of intervals considered on either side.
_MOST = 400


@numba.njit(cache=True, error_model="numpy")
def astray(
    to_range: Floats,
    variance: Floats,
    motion: float,
    distance: float,
    near: float,
    far: float,
) -> tuple[float, float]:
    """Probability of a wrong ambiguity interval, and its mean square range error [m^2].

    `variance` is that of the phases [rad^2], `to_range` the range per phase [m/rad], 0
    for missing frequencies. Candidates are ranges that differ by whole intervals of the
    most precise frequency. At a distance of D standard errors, a candidate is chosen
    with the probability Q(D / 2) that normal errors move the phases past the middle.
    The sum of these is an upper limit, and nearly the probability if it is small.

    From one frequency to the next the range changes by `motion` times an unknown
    standard normal number [m], which explains part of the misfit.
    """
    best = -1
    total, along, rated = 0.0, 0.0, 1.0
    for k in range(to_range.size):
        if to_range[k] <= 0.0 or not variance[k] < np.inf:
            continue
        precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
        total += precision
        along += precision * k * motion
        rated += precision * (k * motion) ** 2
        if best < 0 or precision > 1.0 / (
            to_range[best] ** 2 * max(variance[best], 1e-18)
        ):
            best = k
    if best < 0:
        return 1.0, (far - near) ** 2 / 12
    spread = rated - along * along / total
    step = 2 * math.pi * to_range[best]
    chance, square = 0.0, 0.0
    for sign in (-1.0, 1.0):
        room = (far - distance) if sign > 0 else (distance - near)
        count = min(math.floor(max(room, 0.0) / step * (1 + 1e-9)), _MOST)
        for m in range(1, count + 1):
            offset = sign * m * step
            first, second, moved = 0.0, 0.0, 0.0
            for k in range(to_range.size):
                if k == best or to_range[k] <= 0.0 or not variance[k] < np.inf:
                    continue
                interval = 2 * math.pi * to_range[k]
                remainder = offset - interval * round(offset / interval)
                precision = 1.0 / (to_range[k] ** 2 * max(variance[k], 1e-18))
                first += precision * remainder
                second += precision * remainder * remainder
                moved += precision * remainder * k * motion
            # Least squares of range and rate; without motion of the range alone.
            moved -= first * along / total
            misfit = second - first * first / total
            misfit = max(misfit - moved * moved / spread, 0.0)
            probability = 0.5 * math.erfc(0.5 * math.sqrt(misfit) / math.sqrt(2.0))
            chance += probability
            square += probability * offset * offset
    return min(chance, 1.0), square


class Nodes(NamedTuple):
    """Quadrature nodes along the water column."""

    segment: NDArray[np.intp]
    """Spline segment of each node, shape (node,)."""
    within: Floats
    """Position in the spline segment, as logarithm of the depth, shape (node,)."""
    weight: Floats
    """Quadrature weight, shape (node,) [m]."""
    turn: NDArray[np.complex128]
    """Complex phase factor, shape (node, frequency) [1]."""
    stop: NDArray[np.intp]
    """Number of nodes in front of each distance, increasing, shape (distance,)."""


@numba.njit(cache=True, error_model="numpy")
def fill_columns(
    piece: Floats,
    nodes: Nodes,
    mean: Floats,
    water: NDArray[np.complex128],
) -> None:
    """Integrate the water signal up to each distance, and over the whole column.

    `piece` has the spline coefficients of the log overlap, (4, segment, look). `mean`
    has the shape (look, distance + 1), `water` (look, distance + 1, frequency).
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


#: Errors of a phase beyond which it is lost: counting noise, all together [rad].
_COUNTING, _LOST = 0.2, 0.3


@numba.njit(cache=True, error_model="numpy")
def phase_errors(
    method: int, channel: int, x: Floats, passed: Floats, scratch: Scratch
) -> None:
    """Compute phase variance and bias of a rejection method, and the signal modulus.

    `passed` has the fractions of target and water light in each channel, (2, channel).
    The range is computed from a weighted sum of channels with real weights.
    """
    count = passed.shape[1]
    weight = np.zeros(count)
    for k in range(scratch.to_range.size):
        scratch.variance[k] = np.inf
        scratch.bias[k] = 0.0
        scratch.size[k] = 0.0
        if scratch.to_range[k] == 0.0:
            continue
        weight[:] = 0.0
        aim = scratch.target[k, channel]
        if method in (KEPT, ONE_FREQUENCY):
            aim = aim + scratch.water[k, channel]
            weight[channel] = 1.0
        elif method in (OPEN_WATER, JOINT):
            weight[channel] = 1.0
        else:
            aim = scratch.target[k, 0]
            _mix(method, k, x, passed, scratch, weight)
        scratch.size[k] = abs(aim)
        scratch.variance[k] = 0.0
        _add_noise(method, k, x, weight, aim, scratch)
        _add_bias(method, k, x, weight, aim, scratch)


@numba.njit(cache=True, error_model="numpy")
def _mix(
    method: int, k: int, x: Floats, passed: Floats, scratch: Scratch, weight: Floats
) -> None:
    """Compute the channel weights of unmixing, or of the least-variance combination."""
    of_target = passed[0, 1] / max(passed[0, 0], 1e-12)
    of_water = passed[1, 1] / max(passed[1, 0], 1e-12)
    if method == UNMIX:
        contrast = of_target - of_water
        if abs(contrast) < 1e-6:
            contrast = 1e-6
        weight[0], weight[1] = -of_water / contrast, 1.0 / contrast
        return
    # Subtracted channels, by the inverse of their variances.
    total = 0.0
    share = np.array([1.0, of_target])
    aim = scratch.target[k, 0]
    for c in range(2):
        signal = scratch.target[k, c] + scratch.water[k, c]
        square = max(abs(aim), 1e-300) ** 2
        rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
        variance = x[SHOT] * rate / square
        variance += (x[FLOOR] * across(1j * signal, aim)) ** 2
        variance += (x[FLUCTUATION] * across(scratch.water[k, c], aim)) ** 2
        weight[c] = share[c] / variance
        total += share[c] * weight[c]
    weight[:2] /= total


@numba.njit(cache=True, error_model="numpy")
def _amplified(water: complex, column: complex) -> float:
    """Factor of the variance of open water in that of the water before the target.

    The water before the target is a model's multiple of the open water. Where the light
    from all depths cancels, the multiple is large, and as uncertain as the turbidity
    that the noise of the shots leaves open.
    """
    square = (abs(water) / max(abs(column), 1e-300)) ** 2
    return square * max(square, 1.0)


@numba.njit(cache=True, error_model="numpy")
def _add_noise(
    method: int, k: int, x: Floats, weight: Floats, aim: complex, scratch: Scratch
) -> None:
    """Add the phase variance of each noise source at one frequency [rad^2]."""
    square = max(abs(aim), 1e-300) ** 2
    variance = scratch.variance[k]
    for c in range(weight.size):
        square_weight = weight[c] ** 2
        if square_weight == 0.0:
            continue
        water = scratch.water[k, c]
        counted = square_weight * x[SHOT] / square
        variance[R_SHOT] += counted * scratch.laser_rate[c]
        variance[R_DARK] += counted * x[DARK]
        variance[R_SKY] += counted * scratch.sky_rate[c]
        turned = across(1j * (scratch.target[k, c] + water), aim)
        variance[R_FLOOR] += square_weight * (x[FLOOR] * turned) ** 2
        moved = square_weight * (x[FLUCTUATION] * across(water, aim)) ** 2
        variance[R_FLUCTUATION] += moved
        if method in (OPEN_WATER, COMBINED, JOINT):
            rate = scratch.open_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = counted * rate
            if method != JOINT:
                noise *= _amplified(water, scratch.open_water[k, c])
            variance[R_REFERENCE] += x[REFERENCE] * (noise + moved)


@numba.njit(cache=True, error_model="numpy")
def _add_bias(
    method: int, k: int, x: Floats, weight: Floats, aim: complex, scratch: Scratch
) -> None:
    """Compute the systematic phase errors at one frequency [rad]."""
    bias = scratch.bias[k]
    if method in (KEPT, ONE_FREQUENCY):
        for c in range(weight.size):
            if weight[c] != 0.0 and scratch.target[k, c] != 0.0:
                bias[B_SHIFT] = cmath.phase(aim * np.conj(scratch.target[k, c]))
        return
    if method == UNMIX:
        contrast = 1.0 / weight[1]
        bias[B_RATIO] = x[RATIO] / contrast * across(scratch.water[k, 0], aim)
        return
    for c in range(weight.size):
        water = scratch.water[k, c]
        behind = scratch.open_water[k, c] - water
        bias[B_DRIFT] += x[CHANGE] * weight[c] * across(water, aim)
        bias[B_COLUMN] += x[COLUMN] * weight[c] * across(behind, aim)


Complex = NDArray[np.complex128]

#: Standard deviation of the logarithms of absorption and scattering beforehand [1].
_UNKNOWN = 2.0


@numba.njit(cache=True, error_model="numpy")
def _inverse(
    counting: float, along: complex, floor: float, water: complex, part: float
) -> tuple[float, float, float]:
    """Elements 11, 22, 12 of a sample's inverse covariance (in-phase, quadrature)."""
    turned = 1j * along * floor
    moved = water * part
    a = counting + turned.real**2 + moved.real**2
    b = counting + turned.imag**2 + moved.imag**2
    c = turned.real * turned.imag + moved.real * moved.imag
    determinant = a * b - c * c
    return b / determinant, a / determinant, -c / determinant


@numba.njit(cache=True, error_model="numpy")
def _add(slope: Complex, inverse: tuple[float, float, float], out: Floats) -> None:
    """Add the Fisher information of one sample to a matrix."""
    for i in range(slope.size):
        re = inverse[0] * slope[i].real + inverse[2] * slope[i].imag
        im = inverse[2] * slope[i].real + inverse[1] * slope[i].imag
        for j in range(slope.size):
            out[i, j] += re * slope[j].real + im * slope[j].imag


@numba.njit(cache=True, error_model="numpy")
def range_information(x: Floats, scratch: Scratch, out: Floats, bias: Floats) -> None:
    """Compute the terms of range variance [m^2] and bias [m] of joint estimation.

    Parameters of a pixel are the range and the logarithm of the echo in each channel.
    Parameters that all pixels share are the logarithms of water strength in each
    channel, of absorption and of scattering. The shared ones follow from the open-water
    shots and all pixels; a Schur complement eliminates them with their uncertainty.
    """
    channels = scratch.laser_rate.size
    single = 1 + channels
    size = single + channels + 2
    information = np.zeros((size, size))
    shared = np.zeros((size, size))
    slope = np.zeros(size, dtype=np.complex128)
    for k in range(scratch.to_range.size):
        if scratch.to_range[k] == 0.0:
            continue
        for c in range(channels):
            slope[:] = 0.0
            target, water = scratch.target[k, c], scratch.water[k, c]
            rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(
                x[SHOT] * rate, target + water, x[FLOOR], water, x[FLUCTUATION]
            )
            slope[0] = 1j * target / scratch.to_range[k]
            slope[1 + c] = target
            slope[single + c] = water
            slope[single + channels :] = scratch.change[k, c, :2]
            _add(slope, noise, information)
            column = scratch.open_water[k, c]
            rate = scratch.open_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(x[SHOT] * rate, column, x[FLOOR], column, x[FLUCTUATION])
            slope[: 1 + channels] = 0.0
            slope[single + c] = column
            slope[single + channels :] = scratch.change[k, c, 2:]
            _add(slope, noise, shared)
    # The echo of a channel without light has no range information.
    for i in range(single):
        information[i, i] = max(information[i, i], 1e-200)
    inner = np.linalg.inv(_scaled(information[:single, :single])).astype(np.float64)
    scale = 1.0 / np.sqrt(np.diag(information)[:single])
    for i in range(single):
        for j in range(single):
            inner[i, j] *= scale[i] * scale[j]
    mixed = inner @ np.ascontiguousarray(information[:single, single:])
    shared_information = x[SHOTS] * shared[single:, single:] + x[PIXELS] * (
        information[single:, single:]
        - np.ascontiguousarray(information[single:, :single]) @ mixed
    )
    for i in range(size - single):
        shared_information[i, i] += _UNKNOWN**-2
    shared_variance = mixed[0] @ np.linalg.inv(shared_information) @ mixed[0]
    out[:] = 0.0
    out[R_REFERENCE] = max(shared_variance, 0.0)
    _terms(x, scratch, inner, out, bias)


@numba.njit(cache=True, error_model="numpy")
def _scaled(matrix: Floats) -> Floats:
    """Scale a matrix to a unit diagonal, then add 1e-12 to its diagonal."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    out = np.empty(matrix.shape)
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[0]):
            out[i, j] = matrix[i, j] * scale[i] * scale[j]
        out[i, i] += 1e-12
    return out


@numba.njit(cache=True, error_model="numpy")
def _terms(
    x: Floats, scratch: Scratch, inner: Floats, out: Floats, bias: Floats
) -> None:
    """Compute range variances by noise source, and bias, for known water properties."""
    departed = 0.0
    for k in range(scratch.to_range.size):
        if scratch.to_range[k] == 0.0:
            continue
        for c in range(scratch.laser_rate.size):
            target, water = scratch.target[k, c], scratch.water[k, c]
            rate = scratch.laser_rate[c] + scratch.sky_rate[c] + x[DARK]
            noise = _inverse(
                x[SHOT] * rate, target + water, x[FLOOR], water, x[FLUCTUATION]
            )
            pull = inner[0, 0] * 1j * target / scratch.to_range[k]
            pull += inner[0, 1 + c] * target
            re = noise[0] * pull.real + noise[2] * pull.imag
            im = noise[2] * pull.real + noise[1] * pull.imag
            square = re * re + im * im
            out[R_SHOT] += square * x[SHOT] * scratch.laser_rate[c]
            out[R_DARK] += square * x[SHOT] * x[DARK]
            out[R_SKY] += square * x[SHOT] * scratch.sky_rate[c]
            turned = 1j * (target + water)
            out[R_FLOOR] += (x[FLOOR] * (re * turned.real + im * turned.imag)) ** 2
            moved = re * water.real + im * water.imag
            out[R_FLUCTUATION] += (x[FLUCTUATION] * moved) ** 2
            departed += square * abs(water) ** 2 / 2
    bias[:] = 0.0
    bias[B_COLUMN] = x[DEPARTURE] * np.sqrt(departed)


@numba.njit(cache=True, error_model="numpy")
def _phase_variance(k: int, scratch: Scratch) -> float:
    """Total random phase variance at one frequency [rad^2]."""
    total = 0.0
    for j in range(scratch.variance.shape[1]):
        total += scratch.variance[k, j]
    return total


@numba.njit(cache=True, error_model="numpy")
def _combine(only: int, x: Floats, scratch: Scratch, row: Floats) -> float:
    """Compute errors of the weighted mean range; return the squared total error [m^2].

    `only` is the index of a single frequency to use, -1 for all.
    """
    row[:] = 0.0
    count = scratch.to_range.size
    weight, phase = np.zeros(count), np.empty(count)
    to_range = np.zeros(count)
    total, unseen, frequencies = 0.0, 0.0, 0.0
    for k in range(count):
        phase[k] = np.inf
        if scratch.to_range[k] == 0.0 or (only >= 0 and k != only):
            continue
        frequencies += 1.0
        variance = _phase_variance(k, scratch)
        counted = scratch.variance[k, R_SHOT] + scratch.variance[k, R_DARK]
        counted += scratch.variance[k, R_SKY]
        if not (variance < _LOST**2 and counted < _COUNTING**2):
            unseen += 1.0
        if not variance < np.inf:
            continue
        to_range[k] = scratch.to_range[k]
        phase[k] = variance
        weight[k] = 1.0 / (to_range[k] ** 2 * max(variance, 1e-30))
        total += weight[k]
        row[O_SIGNAL] = max(row[O_SIGNAL], scratch.size[k])
    row[O_UNSEEN] = unseen / max(frequencies, 1.0)
    if total == 0.0:
        row[:O_WRONG] = np.inf
        row[O_WRONG] = 1.0
        return np.inf
    error = 0.0
    for k in range(count):
        pull = weight[k] / total * to_range[k]
        if pull == 0.0:
            continue
        for j in range(scratch.variance.shape[1]):
            row[j] += pull**2 * scratch.variance[k, j]
        offset = scratch.variance.shape[1]
        shifted = 0.0
        for j in range(scratch.bias.shape[1]):
            row[offset + j] += pull * scratch.bias[k, j]
            shifted += scratch.bias[k, j] ** 2
        phase[k] += shifted
    for j in range(scratch.variance.shape[1]):
        error += row[j]
    for j in range(scratch.bias.shape[1]):
        error += row[scratch.variance.shape[1] + j] ** 2
    row[O_WRONG], row[O_ASTRAY] = astray(
        to_range, phase, x[MOTION], x[DISTANCE], x[NEAR], x[FAR]
    )
    return error


@numba.njit(cache=True, error_model="numpy")
def _jointly(x: Floats, passed: Floats, scratch: Scratch, row: Floats) -> None:
    """Compute the range errors of joint estimation."""
    # Which interval it is follows from the phases, channel by channel together.
    best = 0
    for c in range(passed.shape[1]):
        if passed[0, c] > passed[0, best]:
            best = c
    phase_errors(JOINT, best, x, passed, scratch)
    _combine(-1, x, scratch, row)
    variance = np.zeros(scratch.variance.shape[1])
    bias = np.zeros(scratch.bias.shape[1])
    range_information(x, scratch, variance, bias)
    row[: variance.size] = variance
    row[variance.size : variance.size + bias.size] = bias
    row[O_CHANNEL] = -1.0


@numba.njit(cache=True, error_model="numpy")
def assess(
    method: int, points: Points, light: Light, scratch: Scratch, out: Floats
) -> None:
    """Compute the errors of each point, in the columns of `RESULTS`.

    The loop is compiled because there are hundreds of thousands of small points.
    """
    channels = points.target_fraction.shape[1]
    frequency_count = points.frequency_index.shape[1]
    passed = np.empty((2, channels))
    row = np.empty(out.shape[1])
    for p in range(points.look.size):
        x = points.number[p]
        output = see(p, points, light, scratch)
        passed[0], passed[1] = points.target_fraction[p], points.water_fraction[p]
        if method == JOINT:
            _jointly(x, passed, scratch, row)
            out[p] = row
            out[p, O_TONE] = -1.0
            out[p, O_OUTPUT] = output
            continue
        least = math.inf
        out[p] = np.inf
        channel_count = channels if method in (KEPT, ONE_FREQUENCY, OPEN_WATER) else 1
        for c in range(channel_count):
            phase_errors(method, c, x, passed, scratch)
            first, last = -1, 0
            if method == ONE_FREQUENCY:
                first, last = 0, frequency_count
            for only in range(first, last):
                error = _combine(only, x, scratch, row)
                if error < least or (c == 0 and only == first):
                    least = min(error, least)
                    out[p] = row
                    out[p, O_CHANNEL] = c
                    out[p, O_TONE] = only
        out[p, O_OUTPUT] = output
