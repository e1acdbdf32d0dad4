"""Shared parameters of the joint fit, their priors, and instrument uncertainty."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.linalg import solve_triangular

from amulor.optics import rays
from amulor.optics._geometry import Geometry
from amulor.rejection.covariance import times
from amulor.rejection.joint.overlap import COEFFICIENTS, Shape
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.joint.tables import Table
from amulor.rejection.observation import Observation, ScanObservation

Floats = NDArray[np.float64]

#: Standard uncertainty of the axis of a receiver by default [rad].
DIRECTION = float(np.radians(1.0))
#: Standard uncertainty of the delay of scattered light, over `late_echo` [1].
LATE_ECHO = 0.5
#: Steps of path and position [m] and of the index [1] for derivatives.
_STEP, _INDEX_STEP = 1e-5, 1e-6


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """Standard uncertainties of instrument parameters that samples cannot constrain."""

    delay: float
    """Uncertainty of the delay common to all channels [s]."""
    group_index: float
    """Uncertainty of the group index of the water [1]."""
    position: float
    """Uncertainty of the receiver position, right and down; the forward part belongs to
    the delay [m]."""
    direction: float
    """Uncertainty of the receiver's axis, in azimuth and in elevation [rad]."""
    late_echo: float
    """Uncertainty of the late-echo delay, relative to `late_echo` [1]."""

    @classmethod
    def checked(
        cls,
        *,
        delay: float,
        group_index: float,
        position: float,
        direction: float,
        late_echo: float,
    ) -> Instrument:
        """Return the uncertainties, checked to be finite and not negative."""
        uncertainties = {
            "delay_uncertainty": delay,
            "group_index_uncertainty": group_index,
            "receiver_position_uncertainty": position,
            "receiver_direction_uncertainty": direction,
            "late_echo_uncertainty": late_echo,
        }
        for name, value in uncertainties.items():
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(
                    f"{name} must be a finite number not below 0, got {value:g}; it is "
                    "a standard uncertainty, 0 where the survey is exact"
                )
        return cls(
            delay=delay,
            group_index=group_index,
            position=position,
            direction=direction,
            late_echo=late_echo,
        )


def late_echo(depth: Floats, spread: float) -> Floats:
    r"""Return the range error for light that is entirely forward-scattered [m].

    A path that is inclined by small angles of mean square :math:`\sigma^2 z` at the
    depth z is longer by :math:`\int \theta^2 / 2 \, dz = \sigma^2 z^2 / 4`. Unscattered
    light and a receiver that accepts small angles only make the echo less late: the
    spread in view is such that half of this detour is what theory says.
    """
    late: Floats = 0.25 * spread * np.square(depth)
    return late


def range_variance(instrument: Instrument, path: Floats, geometry: Geometry) -> Floats:
    r"""Return the slant-range variance due to instrument errors [m^2].

    To first order :math:`(c_0 u_\tau \partial r / \partial p)^2 + (u_n \partial r /
    \partial n_g)^2 + u_x^2 |\partial r / \partial x|^2` with the two coordinates x of
    the receiver across the scan, and with the path p held fixed. The phase of the
    water signal depends on delay and baseline too, but only as well as the model of the
    water is right, so it is not used.
    """
    receiver, medium = geometry.receiver, geometry.medium

    def to_range(
        length: Floats, place: Floats = receiver, through: rays.Medium = medium
    ) -> Floats:
        return rays.slant_range_of_path(length, geometry.beam, place, medium=through)

    nominal = to_range(path)
    by_path = (to_range(path + _STEP) - nominal) / _STEP
    changed = dataclasses.replace(medium, group_index=medium.group_index + _INDEX_STEP)
    by_index = (to_range(path, through=changed) - nominal) / _INDEX_STEP
    variance = (speed_of_light * instrument.delay * by_path) ** 2
    variance += (instrument.group_index * by_index) ** 2
    for axis in range(2):
        step = np.zeros(3)
        step[axis] = _STEP
        by_place = (to_range(path, receiver + step) - nominal) / _STEP
        variance += (instrument.position * by_place) ** 2
    total: Floats = variance
    return total


#: Legendre polynomials over the time of the scan that describe a change of the water.
TRENDS = 3
#: Number of pixels below which the water is regarded as constant.
FEWEST = 96


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Begin and duration of a scan."""

    rows: int
    """Number of rows of the scan."""
    columns: int
    """Number of columns of the scan."""
    has_times: bool
    """Whether all pixels have times; otherwise pixels are counted row by row."""
    begin: float
    """Time of the first pixel [s]; 0 without times."""
    length: float
    """Time from first to last pixel [s], or number of pixels without times."""


def clock_of(scan: ScanObservation) -> Clock:
    """Return the time span of a scan: as recorded, else counted in pixels."""
    rows, columns = scan.rows, scan.columns
    row_by_row = Clock(
        rows=rows,
        columns=columns,
        has_times=False,
        begin=0.0,
        length=float(max(rows * columns - 1, 0)),
    )
    first, last = np.inf, -np.inf
    for begin, end in scan.bands:
        time = scan.tile(begin, end).time
        if time is None:
            return row_by_row
        first, last = min(first, float(time.min())), max(last, float(time.max()))
    return replace(row_by_row, has_times=True, begin=first, length=last - first)


def trends_of(
    rows: Observation, clock: Clock, *, row: int = 0, column: int = 0
) -> Floats:
    """Return Legendre polynomials of time at each pixel, (pixel, trend) [1]."""
    shape = rows.azimuth.shape
    if clock.has_times:
        assert rows.time is not None
        time = rows.time.ravel()
    else:
        first = np.arange(row, row + shape[0])[:, None] * clock.columns
        time = (first + np.arange(column, column + shape[1])).ravel().astype(float)
    if clock.rows * clock.columns < FEWEST or not clock.length > 0:
        return np.zeros((time.size, 0))
    place = 2 * (time - clock.begin) / clock.length - 1
    return np.asarray(legendre.legvander(place, TRENDS)[:, 1:])


def drifted(pixels: Pixels, trend: Floats) -> Pixels:
    """Return pixels whose interpolation weights include the water-signal drift."""
    if not len(trend):
        return replace(pixels, trends=pixels.trends[:, :0])
    if not np.any(trend):
        return pixels
    factor = 1 + times(pixels.trends, trend[:, None])[:, 0]
    return replace(
        pixels,
        interpolation=pixels.interpolation * factor[:, None],
        # By these the water, as it is then, changes with the coefficients.
        trends=pixels.trends / factor[:, None],
    )


def change_of(trend: Floats) -> float:
    """Return the relative water-signal change from first to last pixel [1]."""
    return float(2 * np.sum(trend[::2]))


def change_uncertainty(covariance: Floats, *, preferred: bool) -> float:
    """Return the standard uncertainty of `change_of` [1]."""
    if not len(covariance) or not preferred:
        return np.inf
    slope = np.where(np.arange(len(covariance)) % 2 == 0, 2.0, 0.0)
    return float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))


Complex = NDArray[np.complex128]
#: Standard deviations of correction, departure, echo, departure of the shots and drift.
Widths = tuple[float, float, float, float, float]

#: Weak knowledge of natural waters: centre and standard deviation of the logarithms of
#: k' [1/m], b_f <theta^2> [rad^2/m] and b_f [1/m]; a factor of 7 either way.
_CENTRE = np.log([0.4, 0.02, 1.0])
_PRIOR = 2.0
#: Trial prior widths of model departures: logarithm of the overlap at the knots,
#: relative departures of the water signal, and relative departures of the echo [1].
_TRIED = (
    (1e-3, 0.01, 0.03, 0.1, 0.3, 1.0),
    (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1),
    (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03),
    (1e-6, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 1.0),
    (1e-6, 3e-3, 0.01, 0.03, 0.1, 0.3),
)
#: The strength of the shots may be off by this much more than their shape [1].
_STRENGTH = 30.0
#: Where the search for the widths starts: a model that is right, and one that is not.
_STARTS: tuple[Widths, ...] = (
    (1e-3, 1e-6, 1e-6, 1e-6, 1e-6),
    (0.1, 3e-3, 1e-3, 0.01, 1e-6),
    (1e-3, 1e-6, 1e-6, 1e-6, 0.1),
)

#: Negligible information, far above the overflow of its inverse [1].
_NOTHING = 1e-200
#: Twice the logarithm of odds beyond which the model's departures are real [1].
DECISIVE = 10.0
#: No widths yet.
NONE: Widths = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Shared:
    """Estimated parameters that are common to all pixels."""

    shape: Shape
    """Shape of the water signal."""
    table: Table
    """Water signal of this shape, against the depth where the water ends."""
    strength: Floats
    """Strength of the water signal in each channel, see `Table` [V]."""
    departure: Complex
    """Departure of the water signal from the model, in front of all targets, relative
    to the strength, (channel, frequency) [1]."""
    echo: Complex
    """Relative departure of the echo from a pure delay, (frequency,) [1]."""
    shot_change: float
    """Logarithm of the water-strength ratio of open-water shots to scan [1]."""
    shot_departure: Complex
    """Departure of the shots from the scan's water, relative to the strength, (channel,
    frequency); empty if the shots count as exact [1]."""
    trend: Floats
    """Coefficients of the water drift during the scan, for `trends_of`; empty for
    constant water [1]."""
    fluctuation: float
    """Relative random change of the water signal from sample to sample [1]."""
    noise_scale: float
    """Factor on the stated errors, 1 or more [1]."""
    judged: NDArray[np.bool_]
    """Samples tested for outliers, (channel, frequency); False where the model itself
    is wrong."""
    turn_width: float
    """Prior standard deviation of the direction of the receiver [rad]."""
    covariance: Floats
    """Covariance of all parameters, in the order of `Layout`."""
    parametric: Floats
    """Covariance of strengths and logarithms of k' and spread, for an exact model
    without priors."""
    widths: Widths
    """Prior widths of highest evidence: correction, departure, echo [1]."""
    evidence: float
    """Twice the log odds in favor of departures from the model [1]."""
    misfit: float
    """Sum of squared errors over its degrees of freedom [1]."""

    @property
    def gain(self) -> Complex:
        """Water-signal strength at each frequency, (channel, frequency) [V]."""
        gain = np.repeat(self.strength[:, None], self.echo.size, axis=1)
        return gain.astype(complex)

    def water_signal(self, water: Complex, foreground: Complex) -> Complex:
        """Return the water signal of pixels, (pixel, channel, frequency) [V]."""
        return (
            self.strength[:, None] * water[:, None]
            + self.foreground * foreground[:, None]
        )

    @property
    def water_departs(self) -> bool:
        """Whether the data favor a departure of the water signal from the model."""
        return self.widths[0] > _TRIED[0][0] or self.widths[1] > _TRIED[1][0]

    @property
    def echo_departs(self) -> bool:
        """Whether the data favor a departure of the echo from a pure delay."""
        return self.widths[2] > _TRIED[2][0]

    @property
    def water_drifts(self) -> bool:
        """Whether the data favor a change of the water signal during the scan."""
        return self.widths[4] > _TRIED[4][0]

    @property
    def shot_factor(self) -> float:
        """Water-signal strength in open-water references relative to the scan [1]."""
        return float(np.exp(self.shot_change))

    def shot_signal(self, water_signal: Complex, foreground: Complex) -> Complex:
        """Return the modeled signal of open-water shots, whose water may differ [V]."""
        signal: Complex = self.shot_factor * water_signal
        if self.shot_departure.size:
            departure = self.strength[:, None] * self.shot_departure
            signal = signal + departure * foreground[:, None]
        return signal

    @property
    def foreground(self) -> Complex:
        """Water-signal departure in front of all targets, (channel, frequency) [V]."""
        return self.strength[:, None] * self.departure


def layout_of(state: Shared) -> Layout:
    """Return the positions of parameter groups for the current shared parameters."""
    channels, frequencies = state.departure.shape
    shape = state.shape
    return Layout(
        channels,
        frequencies,
        len(shape.knots),
        len(shape.turn),
        bool(state.shot_departure.size),
        len(state.trend),
    )


@dataclass(frozen=True)
class Layout:
    """Positions of the groups of parameters in the vector of all parameters."""

    channels: int
    frequencies: int
    knots: int
    turns: int = 0
    doubts: bool = False
    trends: int = 0

    @property
    def strength(self) -> slice:
        """Positions of the channels' water-signal strengths in the parameters."""
        return slice(0, self.channels)

    @property
    def shape(self) -> slice:
        """Positions of all parameters of the shape of the water signal."""
        return slice(self.channels, self.trend.stop)

    @property
    def trend(self) -> slice:
        """Positions of the water-signal drift in the parameter vector."""
        begin = self.rigid + self.knots
        return slice(begin, begin + self.trends)

    @property
    def turn(self) -> slice:
        """Positions of the deviation of the receiver direction from the survey."""
        return slice(self.parametric.stop, self.rigid)

    @property
    def rigid(self) -> int:
        """Number of parameters before the model departures."""
        return self.channels + COEFFICIENTS + self.turns

    @property
    def parametric(self) -> slice:
        """Positions of water strengths, reduced attenuation and angular spread."""
        return slice(0, self.channels + COEFFICIENTS)

    @property
    def blocks(self) -> tuple[slice, slice, slice]:
        """Positions of the model departures: overlap correction, water, echo."""
        a = self.rigid
        b = self.trend.stop
        c = b + 2 * self.channels * self.frequencies
        return slice(a, a + self.knots), slice(b, c), slice(c, c + 2 * self.frequencies)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.doubt.stop)

    @property
    def doubt(self) -> slice:
        """Positions of the differences in water between open-water shots and scan."""
        begin = self.blocks[2].stop
        count = 2 * self.channels * self.frequencies + 1 if self.doubts else 0
        return slice(begin, begin + count)


def whitened(weights: Floats, values: Complex) -> Floats:
    """Whiten values by the errors, shape (pixel, channel, output)."""
    return whitened_columns(weights, values[..., None]).reshape(*values.shape[:2], -1)


def whitened_columns(weights: Floats, values: Complex) -> Floats:
    """Whiten columns by the errors, shape (pixel, output, column)."""
    xx, xy, yy = (weights[..., k, :, None] for k in range(3))
    root = np.sqrt(xx)
    slant = np.divide(xy, root, out=np.zeros_like(root), where=root > 0)
    diagonal = np.sqrt(np.maximum(yy - slant**2, 0.0))
    out = np.stack(
        [root * values.real + slant * values.imag, diagonal * values.imag], axis=-2
    )
    return out.reshape(len(values), -1, values.shape[-1])


def inverse_of(matrix: Floats) -> Floats:
    """Return the inverse of normal equations, after scaling rows and columns."""
    diagonal = np.diag(matrix)
    # A parameter without any effect stays unknown.
    scale = np.sqrt(np.where(diagonal > _NOTHING, diagonal, 1.0))
    scaled = matrix / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-13 * values[-1])
    inverse: Floats = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return inverse


def prior_of(state: Shared, layout: Layout, widths: Widths) -> tuple[Floats, Floats]:
    """Return prior precisions, and the parameters relative to the prior means."""
    precision, origin = np.zeros(layout.size), np.zeros(layout.size)
    at = layout.shape.start
    shape = state.shape
    precision[at : at + COEFFICIENTS] = _PRIOR**-2
    origin[at : at + COEFFICIENTS] = (
        np.log([shape.reduced_attenuation, shape.spread, shape.forward_scattering])
        - _CENTRE
    )
    precision[layout.turn] = 1 / max(state.turn_width, 1e-9) ** 2
    origin[layout.turn] = shape.turn
    current = (
        state.shape.correction,
        np.concatenate([state.departure.real.ravel(), state.departure.imag.ravel()]),
        np.concatenate([state.echo.real, state.echo.imag]),
    )
    for block, width, values in zip(layout.blocks, widths[:3], current, strict=True):
        if width > 0:
            precision[block] = width**-2
        origin[block] = values
    origin[layout.trend] = state.trend
    if widths[4] > 0:
        precision[layout.trend] = widths[4] ** -2
    if layout.doubts:
        departure = state.shot_departure
        origin[layout.doubt] = np.concatenate(
            [departure.real.ravel(), departure.imag.ravel(), [state.shot_change]]
        )
        if widths[3] > 0:
            precision[layout.doubt] = widths[3] ** -2
            precision[layout.size - 1] = (_STRENGTH * widths[3]) ** -2
    return precision, origin


def widths_of(
    matrix: Floats, vector: Floats, state: Shared, layout: Layout
) -> tuple[Widths, float]:
    """Find the prior widths of highest evidence, and the evidence for departures."""
    costs: dict[Widths, float] = {}

    def value(widths: Widths) -> float:
        if widths not in costs:
            costs[widths] = cost_of(matrix, vector, state, layout, widths)
        return costs[widths]

    def best(start: Widths, free: tuple[int, ...]) -> Widths:
        """Return the widths of highest evidence by coordinate descent."""
        chosen, before = start, NONE
        while chosen != before:
            before = chosen
            for k in free:
                candidates = [_replaced(chosen, k, width) for width in _TRIED[k]]
                chosen = min(candidates, key=value)
        return chosen

    # The shots are doubted first, as they were measured at another time.
    blocks: tuple[int, ...] = (3, 0, 1, 2) if layout.doubts else (0, 1, 2)
    # A drift of the water is likelier than a wrong model.
    blocks = (4, *blocks) if layout.trends else blocks
    starts = _STARTS if state.widths == NONE else (state.widths,)
    chosen = min((best(start, blocks) for start in starts), key=value)
    # A correct model allows for drift and for shots of other water.
    harmless = tuple(k for k in blocks if k in (0, 3, 4))
    plain = best((chosen[0], _TRIED[1][0], _TRIED[2][0], *chosen[3:]), harmless)
    return chosen, value(plain) - value(chosen)


def _replaced(widths: Widths, place: int, width: float) -> Widths:
    """Return a copy of the widths with one element replaced."""
    changed = list(widths)
    changed[place] = width
    return changed[0], changed[1], changed[2], changed[3], changed[4]


def cost_of(
    matrix: Floats, vector: Floats, state: Shared, layout: Layout, widths: Widths
) -> float:
    """Return minus twice the logarithm of the evidence, up to a constant."""
    prior, origin = prior_of(state, layout, widths)
    root = np.sqrt(1 / np.where(prior > 0, prior, 1.0))
    # In units of the priors' widths the determinant is that of the evidence.
    scaled = matrix * np.outer(root, root)
    scaled[np.diag_indices(layout.size)] += prior > 0
    downhill = root * (vector - prior * origin)
    scale = np.sqrt(np.diag(scaled))
    scaled /= np.outer(scale, scale)
    scaled[np.diag_indices(layout.size)] += 1e-12
    factor = np.linalg.cholesky(scaled)
    solved = solve_triangular(factor, downhill / scale, lower=True, check_finite=False)
    return (
        float(prior @ origin**2)
        - float(solved @ solved)
        + 2 * float(np.sum(np.log(np.diag(factor))) + np.sum(np.log(scale)))
    )
