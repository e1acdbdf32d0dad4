r"""Excess delay of an echo by forward scattering between instrument and target.

Light scattered by small angles takes a longer path than unscattered light. The receiver
detects both, and the phase of their sum gives a distance that is too long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.special import j0, j1, jv

from amulor.optics._bounds import broadcast, finite, not_negative, positive
from amulor.optics.phase_functions.integrals import gauss_legendre
from amulor.optics.phase_functions.phase_function import PhaseFunction

__all__ = ["RELATIVE_UNCERTAINTY", "late_echo", "sharp_receiver_late_echo"]

Array = NDArray[np.float64]
Phasors = NDArray[np.complex128]

#: Relative standard uncertainty of `late_echo` for a known phase function, from its
#: differences to photon transport [1].
RELATIVE_UNCERTAINTY = 0.05
#: Phase over a panel of angles that is still resolved [rad].
_OSCILLATIONS = 20.0
#: Where the Gaussian of receiver and beam ends, in its own widths [1].
_END = 12.0
_NODES, _SHARP_NODES = 192, 768
#: Width over which the edges of a sharp view are softened, over its own width [1].
_SOFT = 0.05
#: Beams worked on at once, for the memory.
_AT_ONCE = 2048
#: Below this share of the light without regard to phases the sum is rounding [1].
_ROUNDING = 1e-9
#: Wavenumber of the modulation in place of zero [rad/m].
_SLOW = 1e-4
#: Grid points per factor of two, of spatial frequency and distance.
_PER_OCTAVE = 7
#: Least kappa times the depth, and least distance times the largest kappa [1].
_SMALLEST, _NEAREST = 0.05, 2.0
#: Least angle at which the plane of small angles is corrected, widest panel, and the
#: angle to the axis from which light is lost [rad].
_STRAIGHT, _PANEL, _GRAZING = 1e-5, 0.03, 1.5
#: Excess of the series over photons, relative to the square root of scattering lengths
#: times phase: fit to `benchmarks/late_light.csv` [1].
_EXCESS = 0.045


def late_echo(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float = np.pi / 2,
    group_index: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    absorption: ArrayLike = 0.0,
) -> Array:
    r"""Return the range excess of an echo due to forward scattering and aperture [m].

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    depth : array_like
        Water between instrument and surface, along the beam, above zero [m].
    scattering : array_like
        Scattering coefficient b of the water, forward and diffuse [1/m].
    phase_function : PhaseFunction
        Phase function of the water; light scattered beyond the split angle is lost.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].
    group_index : array_like
        Group index of the water [1].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; 1/e half-width of the aperture [m].
    acceptance_angle : array_like
        1/e semi-angle of the receiver, in water [rad].
    beam_radius : array_like
        1/e radius of the intensity of the Gaussian beam [m].
    beam_divergence : array_like
        1/e semi-angle of the beam [rad].
    tilt, cross_tilt : array_like
        Inclination of the beam against the receiver's axis, along and across the
        baseline, as in `small_angle.overlap` [rad].
    standoff : array_like
        Air and glass before the water, as a depth of water [m].
    absorption : array_like
        Absorption coefficient a of the water [1/m].

    Returns
    -------
    ndarray
        Slant range of the phase less that of the straight path between the centers of
        beam and aperture, of the broadcast shape [m]. NaN where the receiver does not
        see the echo.

    Raises
    ------
    ValueError
        If an argument is outside of its range, or if the phase function cannot be
        used.

    Notes
    -----
    A ray of directions :math:`\mathbf n(s)` is longer than the axis by
    :math:`\ell = \frac12 \int n^2 ds`, and light with this path has the factor
    :math:`e^{m \ell}`, :math:`m = i \omega / v - a`. In the transforms of eq. (20) of
    [1]_, as rederived, :math:`n^2 / 2` is minus half the Laplacian in the frequency of
    the direction. The transform of the light at the surface is therefore the mean of
    :math:`\exp b \int (\hat p(\kappa x + B_x) - 1) \, dx` over random walks B of the
    variance :math:`-m x` per component, x being the distance from the surface. Its
    logarithm is expanded in the number of scatterings on one path, up to three,

    .. math::

       b \int (\hat q - 1) dx
       + b^2 \int \Bigl( \frac{m^2}{2} \sum_i \hat q_{ii} \int_0^x x'^2 \hat q_{ii} dx'
       - m \hat q' \int_0^x x' \hat q' dx' \Bigr) dx
       + \frac{m^2 b^3}{2} \int \hat q'' \Bigl( \int \min(x, x') \hat q' dx'
       \Bigr)^2 dx ,

    .. math::

       \hat q(\kappa, x) = \int p(\theta) J_0(\kappa x \tan\theta)
       e^{m x (1 / \cos\theta - 1)} d\Omega .

    Each scattering has its exact lateral displacement and path. The transforms of light
    out and, by reciprocity, back are multiplied, and the phase of their integral over
    :math:`\kappa` is the delay. Directions and places at the start are Gaussian. If the
    receiver sees all of a plane, the delay at low frequency is
    :math:`b_f \langle\theta^2\rangle z^2 / 4` for small angles.

    The series is up to 12 % too large, since it ends after three scatterings and paths
    are of second order in their angles. The delay L of the series is therefore divided
    by :math:`1 + 0.045 \sqrt{b z k L}`, with the wavenumber k of the modulation. The
    constant is fitted to photon transport. With it, the relative difference is at most
    0.04 (Petzold, Fournier-Forand, Henyey-Greenstein 0.90 to 0.99; 1 to 12 attenuation
    lengths; 50 to 500 MHz; fields of view of 20 and 80 mrad). Where the series does not
    hold, the delay is that of half the frequency.
    Light scattered repeatedly between water and surface is neglected: at reflectance 1
    it adds 0.08 to 0.4 of the delay at 1.6 m. Valid for surfaces that face the
    instrument within about half a radian.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> late = late_echo(
    ...     50e6, depth=[1.6, 3.2], scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     group_index=1.38, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08, tilt=0.07,
    ... )
    >>> print(np.round(late * 1e3, 1), "mm")
    [0.8 4.4] mm
    """
    return _Lateness.of(
        modulation_frequency,
        sharp=False,
        phase_function=phase_function,
        split_angle=split_angle,
        group_index=group_index,
        depth=depth,
        scattering=scattering,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        absorption=absorption,
    ).distance()


def sharp_receiver_late_echo(
    modulation_frequency: ArrayLike,
    *,
    depth: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float = np.pi / 2,
    group_index: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    absorption: ArrayLike = 0.0,
) -> Array:
    r"""Return the range excess of an echo for a sharp aperture and field of view [m].

    Parameters
    ----------
    modulation_frequency, depth, scattering : array_like
        As in `late_echo` [Hz, m, 1/m].
    phase_function : PhaseFunction
        Phase function of the water, as in `late_echo`.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad].
    group_index : array_like
        Group index of the water [1].
    baseline, receiver_radius : array_like
        Distance of emitter and receiver; radius of the circular aperture [m].
    acceptance_angle : array_like
        Semi-angle of the receiver's acceptance cone, in water [rad].
    beam_radius, beam_divergence, tilt, cross_tilt, standoff : array_like
        As in `late_echo` [m, rad, rad, rad, m].
    absorption : array_like
        Absorption coefficient a of the water [1/m].

    Returns
    -------
    ndarray
        As from `late_echo` [m].

    Raises
    ------
    ValueError
        If an argument is outside of its range, or if the phase function cannot be
        used.

    See Also
    --------
    late_echo : For a Gaussian receiver.

    Notes
    -----
    The transforms of aperture and field of view are
    :math:`2 J_1(x) / x` of :math:`R \kappa` and :math:`\gamma \kappa z` in place of
    Gaussians, eq. (29) of [1]_, as rederived. Edges are softened over a twentieth of
    the width, at the same mean square width. If the receiver sees the spot, this
    changes the delay by less than 1 %.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    A sharp field of view excludes the latest light.

    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> late = sharp_receiver_late_echo(
    ...     50e6, depth=[1.6, 3.2], scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     group_index=1.38, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08, tilt=0.07,
    ... )
    >>> print(np.round(late * 1e3, 1), "mm")
    [0.6 4.1] mm
    """
    return _Lateness.of(
        modulation_frequency,
        sharp=True,
        phase_function=phase_function,
        split_angle=split_angle,
        group_index=group_index,
        depth=depth,
        scattering=scattering,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        absorption=absorption,
    ).distance()


#: Check and unit of each argument that may differ from place to place.
_PLACES: dict[str, tuple[Callable[..., Array], str]] = {
    "depth": (positive, "m"),
    "scattering": (not_negative, "1/m"),
    "baseline": (not_negative, "m"),
    "receiver_radius": (positive, "m"),
    "acceptance_angle": (positive, "rad"),
    "beam_radius": (not_negative, "m"),
    "beam_divergence": (not_negative, "rad"),
    "tilt": (finite, "rad"),
    "cross_tilt": (finite, "rad"),
    "standoff": (not_negative, "m"),
    "absorption": (not_negative, "1/m"),
}


def response(modulation_frequency: ArrayLike, **arguments: Any) -> Phasors:
    """Return echoes with late light over those on the straight path, at 0 Hz 1 [1].

    Arguments as in `late_echo`, and `sharp`: whether the field of view is. The
    logarithm of the amplitude has the factor of the delay: without it, it is up to 11 %
    too large in harbor water at seven lengths.
    """
    lateness = _Lateness.of(modulation_frequency, **arguments)
    phase = 2 * lateness.wavenumber * lateness.distance().ravel()
    everywhere = np.arange(phase.size)
    slow = np.full(phase.size, _SLOW)
    loss = lateness.turns(lateness.wavenumber, everywhere).imag
    loss -= lateness.turns(slow, everywhere).imag
    return np.asarray(
        np.exp(1j * phase - loss / lateness.excess(phase)).reshape(lateness.shape)
    )


@dataclass(frozen=True, kw_only=True)
class _Lateness:
    """Echoes of which the late light is wanted, arrays over all of them."""

    phase_function: PhaseFunction
    split_angle: float
    sharp: bool
    shape: tuple[int, ...]
    wavenumber: Array
    """Wavenumbers of the modulation [rad/m]."""
    loss: Array
    """Absorption [1/m]."""
    flat: dict[str, Array]
    """Other arguments of `_delay`."""

    @classmethod
    def of(
        cls,
        modulation_frequency: ArrayLike,
        *,
        sharp: bool,
        phase_function: PhaseFunction,
        split_angle: float,
        group_index: ArrayLike,
        **arguments: ArrayLike,
    ) -> _Lateness:
        """Check arguments."""
        frequency = not_negative(
            modulation_frequency, name="modulation_frequency", unit="Hz"
        )
        index = positive(group_index, name="group_index")
        places = {
            name: check(arguments.get(name, 0.0), name=name, unit=unit)
            for name, (check, unit) in _PLACES.items()
        }
        shape = broadcast(modulation_frequency=frequency, group_index=index, **places)
        flat = {
            name: np.broadcast_to(value, shape).ravel()
            for name, value in places.items()
        }
        wavenumber = 2 * np.pi * index * frequency / speed_of_light
        return cls(
            phase_function=phase_function,
            split_angle=float(split_angle),
            sharp=sharp,
            shape=shape,
            wavenumber=np.broadcast_to(np.maximum(wavenumber, _SLOW), shape).ravel(),
            loss=flat.pop("absorption"),
            flat=flat,
        )

    def turns(self, wavenumber: Array, where: NDArray[np.int_]) -> Phasors:
        """Return phases of the late light at these places, within a half turn [rad].

        The imaginary part is that of `_delay`.
        """
        rate = 1j * wavenumber - self.loss[where]
        turn = np.empty(rate.size, dtype=complex)
        for value in np.unique(rate):
            (alike,) = np.nonzero(rate == value)
            for begin in range(0, alike.size, _AT_ONCE):
                part = alike[begin : begin + _AT_ONCE]
                turn[part] = _delay(
                    self.phase_function,
                    self.split_angle,
                    complex(value),
                    sharp=self.sharp,
                    **{name: array[where[part]] for name, array in self.flat.items()},
                )
        return turn

    def unwrapped(
        self, wavenumber: Array, where: NDArray[np.int_], slow: Array
    ) -> Array:
        """Return phases between those of half the frequency and twice these [rad]."""
        turn = self.turns(wavenumber, where).real
        (far,) = np.nonzero(slow * wavenumber > np.pi)
        if far.size:
            half = self.unwrapped(wavenumber[far] / 2, where[far], slow[far])
            whole = 2 * np.pi * np.round((1.5 * half - turn[far]) / (2 * np.pi))
            # Where the series no longer holds, the delay at half the frequency.
            held = np.abs(turn[far] + whole - 1.5 * half) <= np.abs(0.5 * half)
            turn[far] = np.where(held, turn[far] + whole, 2 * half)
        return turn

    def excess(self, turn: Array) -> Array:
        """Return the series over photons, from the phase of either [1]."""
        scattered = self.flat["scattering"] * self.flat["depth"]
        return 1 + _EXCESS * np.sqrt(scattered * np.maximum(turn, 0.0) / 2)

    def distance(self) -> Array:
        """Return the range excess [m]."""
        everywhere = np.arange(self.wavenumber.size)
        # A receiver that sees all of the surface sees no more than this delay.
        fraction, moment = self.phase_function.forward_split(self.split_angle)
        slow = self.flat["scattering"] * fraction * moment * self.flat["depth"] ** 2 / 2
        (far,) = np.nonzero(slow * self.wavenumber > np.pi)
        slow[far] = self.turns(np.full(far.size, _SLOW), far).real / _SLOW
        turn = self.unwrapped(self.wavenumber, everywhere, slow)
        turn = turn / self.excess(turn)
        return np.asarray((turn / self.wavenumber / 2).reshape(self.shape))


def _delay(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    *,
    sharp: bool,
    depth: Array,
    scattering: Array,
    baseline: Array,
    receiver_radius: Array,
    acceptance_angle: Array,
    beam_radius: Array,
    beam_divergence: Array,
    tilt: Array,
    cross_tilt: Array,
    standoff: Array,
) -> Phasors:
    """Return the phase of echoes beyond the straight path [rad].

    The imaginary part is minus the logarithm of the amplitude, up to a constant. The
    rate is that of the logarithm of the light with the path, i k - a [1/m].
    """
    way = depth + standoff
    # Light from the rim of a wide view has other phases, so less of the view counts.
    seen = acceptance_angle * np.sqrt(
        (1 / (1 - rate * acceptance_angle**2 * way / 2)).real
    )
    view = np.hypot(receiver_radius, seen * way)
    beam = np.hypot(beam_radius, beam_divergence * depth)
    # The middle of the receiver's view on the surface, from the middle of the beam.
    along, across = baseline - tilt * way, -cross_tilt * way
    offset = np.hypot(along, across)
    aside = -(tilt * along + cross_tilt * across) / np.where(offset > 0, offset, 1.0)
    if sharp:
        dark = offset > receiver_radius + acceptance_angle * way + 2 * beam
        end = _END / np.hypot(beam, _SOFT * view)
        node, weight = gauss_legendre(_SHARP_NODES)
    else:
        dark = offset > np.sqrt(-np.log(_ROUNDING)) * np.hypot(view, beam)
        end = _END / np.hypot(view, beam)
        node, weight = gauss_legendre(_NODES)
    kappa = end[:, None] * (node + 1) / 2
    fields = _at_places(
        phase_function, split_angle, rate, kappa, depth, float(np.max(end))
    )
    b = scattering[:, None]
    exponent = 2 * (b * fields[0] + b**2 * fields[1] + b**3 * fields[2])
    exponent -= (beam_radius[:, None] * kappa) ** 2 / 4
    starts = (b * fields[3] + b**2 * fields[4], b * fields[5])
    out, _ = _gaussian_start(rate, kappa, beam_divergence, depth, starts)
    exponent += out
    if sharp:
        # Softer edges, with the same mean square radii of aperture and view.
        shrink = np.sqrt(1 - 2 * _SOFT**2)
        exponent -= ((_SOFT * view)[:, None] * kappa) ** 2 / 4
        direct, turned = _sharp_start(
            rate, kappa, shrink * acceptance_angle, way, starts[0]
        )
        edge = shrink * receiver_radius[:, None] * kappa
        direct, turned = direct * 2 * j1(edge) / edge, turned * 2 * j1(edge) / edge
    else:
        back, turned = _gaussian_start(rate, kappa, acceptance_angle, way, starts)
        exponent += back - (receiver_radius[:, None] * kappa) ** 2 / 4
        direct = np.ones_like(turned)
    light = weight * kappa * np.exp(exponent)
    first, zeroth = j1(kappa * offset[:, None]), j0(kappa * offset[:, None])
    signal = light * (direct * zeroth + rate * aside[:, None] * turned * first)
    total = np.sum(signal, axis=1)
    dark |= np.abs(total) <= _ROUNDING * np.sum(np.abs(light), axis=1)
    total[dark] = np.nan
    straight = (tilt**2 + cross_tilt**2) * way - baseline**2 / way
    turn = np.angle(total) + rate.imag * straight / 2
    return np.asarray(turn - 1j * np.log(np.abs(total)))


def _gaussian_start(
    rate: complex,
    kappa: Array,
    spread: Array,
    way: Array,
    starts: tuple[Phasors, Phasors],
) -> tuple[Phasors, Phasors]:
    """Return the exponent of a Gaussian spread of directions, and its factor of a tilt.

    `spread` is the 1/e semi-angle. Starts are the terms of `_exponents` that are linear
    and quadratic in the shift of a start.
    """
    square, path = spread[:, None] ** 2, way[:, None]
    turned = 1 - rate * square * path / 2
    slope = rate * square * path * kappa / 2 / turned
    linear, quadratic = starts
    exponent = slope * (linear + slope * quadratic)
    exponent = exponent - square * (path * kappa) ** 2 / 4 / turned - np.log(turned)
    return exponent, linear + 2 * slope * quadratic - slope * path / rate


def _sharp_start(
    rate: complex, kappa: Array, semi_angle: Array, way: Array, linear: Phasors
) -> tuple[Phasors, Phasors]:
    """Return the transform of a uniform cone of directions, and its factor of a tilt.

    The transform is at a frequency that the scattering has shifted.
    """
    angle, path = semi_angle[:, None], way[:, None]
    frequency = kappa * path - rate * linear
    edge = angle * frequency
    first = jv(1, edge)
    second = 2 * first / edge - jv(0, edge)
    mean_square = 2 * angle**2 * (first / edge - 2 * second / edge**2)
    cone = 2 * first / edge + rate * path / 2 * mean_square
    return cone, linear * cone - path * angle * 2 * second / edge


def _at_places(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    kappa: Array,
    depth: Array,
    largest: float,
) -> Phasors:
    """Interpolate the exponents of the light to spatial frequencies and depths."""
    from scipy.interpolate import CubicSpline

    shortest, longest = float(np.min(depth)), float(np.max(depth))
    grid = (
        _step(_SMALLEST / longest, up=False),
        _step(largest, up=True),
        _step(min(_NEAREST / largest, shortest / 10), up=False),
        _step(longest, up=True),
    )
    table = _exponents(phase_function, split_angle, rate, grid)
    column = np.log2(kappa) * _PER_OCTAVE
    low, high, near, far = grid
    places, which = np.unique(depth, return_inverse=True)
    at_depth = CubicSpline(np.arange(near, far + 1), table, axis=2)(
        np.log2(places) * _PER_OCTAVE
    )
    fields = np.empty((table.shape[0], *kappa.shape), dtype=complex)
    steps = np.arange(low, high + 1)
    for number in range(len(places)):
        here = which == number
        spline = CubicSpline(steps, at_depth[:, :, number], axis=1)
        # Below the lowest frequency nothing changes any more.
        fields[:, here] = spline(np.maximum(column[here], low))
    return fields


def _step(value: float, *, up: bool) -> int:
    """Return the step of the logarithmic grid next to a value, above or below."""
    step = np.log2(value) * _PER_OCTAVE
    return int(np.ceil(step) if up else np.floor(step))


@lru_cache(maxsize=32)
def _exponents(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    grid: tuple[int, int, int, int],
) -> Phasors:
    """Tabulate exponents of one way, per power of b, over kappa and the distance x.

    Grids are logarithmic, so that kappa x has few values. The fields are: single
    scatterings; pairs (b^2) and triples (b^3) of scatterings on one path; and the
    factors of a start with the shift s x, s (b [3] + b^2 [4]) + s^2 b [5].
    """
    _, _, near, far = grid
    x = 2.0 ** (np.arange(near, far + 1) / _PER_OCTAVE)
    value, slope, curl, bend = _damped(phase_function, split_angle, rate, grid)

    def sum_over(integrand: Phasors) -> Phasors:
        """Integrate over the distance from the surface, from 0."""
        return _integral(x, integrand)

    distance = x[:, None]
    # Shift of the direction's frequency by all scatterings up to the far end z.
    moment, total = sum_over(distance * slope), sum_over(slope)
    shift = moment - distance * total
    straight = sum_over(bend * distance**2)
    bent = sum_over(bend * distance * shift)
    pairs = -rate * sum_over(slope * moment)
    for second in (bend, curl):
        repeated = sum_over(distance**2 * second)
        pairs = pairs + rate**2 / 2 * sum_over(second * repeated)
    triples = sum_over(bend * shift**2) + 2 * total * bent + total**2 * straight
    fields = (
        sum_over(value),
        pairs,
        rate**2 / 2 * triples,
        moment,
        -rate * (bent + total * straight),
        straight / 2,
    )
    return np.asarray(np.swapaxes(fields, 1, 2))


def _integral(x: Array, integrand: Phasors) -> Phasors:
    """Integrate over a logarithmic grid from 0, where the integrand is 0."""
    from scipy.interpolate import CubicSpline

    parts = CubicSpline(np.log(x), integrand * x[:, None], axis=0).antiderivative()
    integral: Phasors = parts(np.log(x)) + integrand[0] * x[0] / 2
    return integral


def _damped(
    phase_function: PhaseFunction,
    split_angle: float,
    rate: complex,
    grid: tuple[int, int, int, int],
) -> tuple[Phasors, Phasors, Phasors, Phasors]:
    """Return transform, slope, slope over frequency, and curvature of delayed light.

    Each over distance and kappa: of the scattering into each angle, with the phase
    and loss of the longer path from there to the surface.
    """
    low, high, near, far = grid
    fraction, _ = phase_function.forward_split(split_angle)
    angle, share, flat, straight, value, gradient = _single(
        phase_function, split_angle, low + near, high + far
    )
    excess = 1 / np.cos(angle) - 1
    out = np.empty((4, far - near + 1, high - low + 1), dtype=complex)
    for row, step in enumerate(range(near, far + 1)):
        x = 2.0 ** (step / _PER_OCTAVE)
        light = share * np.exp(rate * x * excess)
        turned = np.stack([light, angle**2 * light]).view(float).reshape(2, -1, 2)
        part = slice(row, row + high - low + 1)
        y = 2.0 ** (np.arange(low + step, high + step + 1) / _PER_OCTAVE)
        zeroth = [(value[part] @ each).view(complex)[:, 0] for each in turned]
        lever = np.stack([angle * light]).view(float).reshape(-1, 2)
        first = (gradient[part] @ lever).view(complex)[:, 0]
        out[0, row] = flat[part] - fraction + (zeroth[0] - straight[part])
        out[1, row] = -first
        out[2, row] = -first / y
        out[3, row] = first / y - zeroth[1]
    return out[0], out[1], out[2], out[3]


@lru_cache(maxsize=8)
def _single(
    phase_function: PhaseFunction, split_angle: float, low: int, high: int
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return angles with their share of the light, and transforms of single scattering.

    These are the transform of small angles, its part by these angles, and J0 and J1 of
    kappa x times the tangent, over kappa x and angle.
    """
    angle, share, width = _angles(phase_function, split_angle)
    y = 2.0 ** (np.arange(low, high + 1) / _PER_OCTAVE)
    fraction, _ = phase_function.forward_split(split_angle)
    flat = fraction * phase_function.hankel(y, split_angle=split_angle)
    resolved = _resolved(np.outer(y, width))
    straight = (j0(np.outer(y, angle)) * resolved) @ share
    passed = angle < _GRAZING
    angle, share, width = angle[passed], share[passed], width[passed]
    place = np.outer(y, np.tan(angle))
    resolved = _resolved(np.outer(y, width / np.cos(angle) ** 2))
    return angle, share, flat, straight, j0(place) * resolved, j1(place) * resolved


def _resolved(phase: Array) -> Array:
    """Return 1 where a panel has few oscillations, and 0 where they cancel out."""
    return np.asarray(np.exp(-((phase / _OSCILLATIONS) ** 6)))


def _angles(
    phase_function: PhaseFunction, split_angle: float
) -> tuple[Array, Array, Array]:
    """Return scattering angles up to a right angle, shares of light, panel widths."""
    top = min(split_angle, np.pi / 2)
    bottom = min(_STRAIGHT, top / 1000)
    inner = phase_function.panels.edges
    inner = inner[(inner > bottom) & (inner < top)]
    edges = np.concatenate([[bottom], inner, [top]])
    pieces = [edges[:1]]
    for low, high in pairwise(edges):
        count = int(np.ceil((high - low) / _PANEL))
        pieces.append(np.linspace(low, high, count + 1)[1:])
    edges = np.concatenate(pieces)
    node, weight = gauss_legendre(16)
    half = np.diff(edges)[:, None] / 2
    angle = edges[:-1, None] + half * (node + 1)
    share = 2 * np.pi * phase_function.panels.value(angle) * np.sin(angle)
    width = np.broadcast_to(2 * half, angle.shape)
    return angle.ravel(), (share * half * weight).ravel(), width.ravel()
