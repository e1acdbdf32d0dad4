r"""Excess delay of an echo by forward scattering between instrument and target.

Light scattered by small angles takes a longer path than unscattered light. The receiver
detects both, and the phase of their sum gives a distance that is too long.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.special import j0, j1, jv

from amulor.optics._bounds import broadcast, finite, not_negative, positive
from amulor.optics._delayed_light import at_places, gaussian_start
from amulor.optics.phase_functions.integrals import gauss_legendre
from amulor.optics.phase_functions.phase_function import PhaseFunction

__all__ = ["RELATIVE_UNCERTAINTY", "late_echo", "sharp_receiver_late_echo"]

Array = NDArray[np.float64]
Phasors = NDArray[np.complex128]

#: Relative standard uncertainty of `late_echo` for a known phase function, from its
#: differences to photon transport [1].
RELATIVE_UNCERTAINTY = 0.05
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
    fields = at_places(
        phase_function, split_angle, rate, kappa, depth, float(np.max(end))
    )
    b = scattering[:, None]
    exponent = 2 * (b * fields[0] + b**2 * fields[1] + b**3 * fields[2])
    exponent -= (beam_radius[:, None] * kappa) ** 2 / 4
    starts = (b * fields[3] + b**2 * fields[4], b * fields[5])
    out, _ = gaussian_start(rate, kappa, beam_divergence, depth, starts)
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
        back, turned = gaussian_start(rate, kappa, acceptance_angle, way, starts)
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
