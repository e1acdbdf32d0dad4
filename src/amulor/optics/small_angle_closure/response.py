r"""Water signal and overlap by the small-angle closure.

Scattering damps a spatial frequency by an exponent. The closure replaces this exponent,
as a function of the squared frequency, by its tangent at the mean squared frequency of
the light. F(z) is the overlap of beam and receiver at the depth z [sr], and w the phase
per depth [rad/m].
"""

from __future__ import annotations

import math
import warnings
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import AmulorWarning
from amulor.optics._quadrature import RULE, bessel
from amulor.optics.small_angle import _kernels as small_angle_kernels
from amulor.optics.small_angle._columns import (
    Arguments,
    Column,
    PhaseFunction,
    Table,
    depth_rule,
    looks,
    overlap_of,
    response_of,
)
from amulor.optics.small_angle_closure import _kernels

__all__ = ["LARGEST_DEPARTURE", "departure", "overlap", "water_response"]

Array = NDArray[np.float64]

#: Share by which eq. (29) may have more light where the closure holds [1].
LARGEST_DEPARTURE = 0.25
_DEPTHS = 48  # at which what a column lacks is estimated
_REACH = 7.0  # depth at which they end, times k'


def water_response(
    modulation_frequency: ArrayLike,
    *,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    backscatter_vsf: ArrayLike | None = None,
    group_index: ArrayLike,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
    end: ArrayLike = np.inf,
) -> NDArray[np.complex128]:
    r"""Return the water signal by the small-angle closure of eq. (29).

    All arguments but the phase function and its split angle are broadcast against
    each other; axes along which only the frequency changes cost little.

    Parameters
    ----------
    modulation_frequency : array_like
        Frequency of the intensity modulation, not negative [Hz].
    absorption, scattering : array_like
        Coefficients a and b of the water, b forward and diffuse [1/m].
    phase_function : callable
        Phase function [1/sr], as in `amulor.optics.small_angle.water_response`.
    split_angle : float
        Angle between the forward and the diffuse part, above 0 to pi [rad]. Light
        scattered by larger angles is lost, except for backscatter; 90 degrees is right
        for natural water.
    backscatter_vsf : array_like, optional
        Volume scattering function beta_pi at 180 degrees [1/(m sr)]; scattering
        times the phase function there if not given.
    group_index : array_like
        Group index of the water at the laser wavelength, at least 1 [1].
    baseline : array_like
        Distance rho_0 of laser beam and receiver axis at the instrument [m].
    receiver_radius : array_like
        1/e radius R of the receiver aperture [m].
    acceptance_angle : array_like
        1/e semi-angle gamma of the receiver, in water [rad].
    beam_radius : array_like, optional
        1/e radius of the intensity of the Gaussian beam at the instrument [m].
    beam_divergence : array_like, optional
        1/e semi-angle of the beam, in water [rad].
    tilt, cross_tilt : array_like, optional
        Inclination of the beam against the receiver axis, along the baseline and
        across it, in water [rad].
    standoff : array_like, optional
        Path in front of the water, as the depth of water in which light spreads
        equally, without attenuation and delay [m].
    end : array_like, optional
        Depth of the end of the water, or of a target [m]; open water if infinite.

    Returns
    -------
    ndarray of complex
        Received per launched power, of the broadcast shape [1]. The phase is the delay
        of the echo relative to light returned at the start of the water.

    Raises
    ------
    ValueError
        If an argument is outside its range or, except for `end`, not finite, or if the
        phase function cannot be used.

    Warns
    -----
    AmulorWarning
        If the closure does not hold.

    See Also
    --------
    overlap : The integrand, and the equations.
    amulor.optics.small_angle.water_response : Exact model, slower.
    amulor.optics.small_angle_diffusion.water_response : Diffusion model of the paper.

    Notes
    -----
    Eq. (46) of Ricci et al. 2010 [1]_ with the F(z) of `overlap`. The closure
    underestimates light scattered by large angles, so its cut-off is too high. If the
    missing light by `departure`, summed over the column, is at most 0.25 of the
    closure's light, the cut-off is 0 to 30 % above that of eq. (29) in random
    geometries. Elsewhere, as for receivers with an acceptance below some 30 mrad and a
    baseline, an `AmulorWarning` is issued: there it was 0.7 to 3.9 times that of eq.
    (29). Panels over the depth are halved until less than 1e-10 of the response is
    unresolved.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> response = water_response(
    ...     [0.0, 20e6], absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.97),
    ...     split_angle=np.pi / 2, group_index=1.34, baseline=0.2,
    ...     receiver_radius=0.02, acceptance_angle=0.08,
    ... )
    >>> print(f"{abs(response[1] / response[0]):.3f}")
    0.519
    """
    arguments = Arguments(
        absorption=absorption,
        scattering=scattering,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
        end=end,
    )
    lacking: list[float] = []
    response = response_of(
        partial(_response, lacking=lacking),
        modulation_frequency,
        arguments,
        group_index=group_index,
        phase_function=phase_function,
        split_angle=split_angle,
        backscatter_vsf=backscatter_vsf,
    )
    beyond = [share for share in lacking if share > LARGEST_DEPARTURE]
    if beyond:
        which = f"{len(beyond)} of {len(lacking)} columns of water"
        most = f"{max(beyond):.0%} or more" if max(beyond) < 9 else "most"
        warnings.warn(
            f"the closure does not hold in {which}: it lacks {most} of its own light "
            f"beside eq. (29), at most {LARGEST_DEPARTURE:.0%} is sound; use the "
            "small-angle model",
            AmulorWarning,
            stacklevel=2,
        )
    return response


def overlap(
    depth: ArrayLike,
    *,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
) -> Array:
    r"""Return the overlap F(z) of beam and receiver by the small-angle closure [sr].

    Parameters
    ----------
    depth : array_like
        Depth z in the water along the receiver axis, not negative [m].
    absorption, scattering, phase_function, split_angle, baseline, \
    receiver_radius, acceptance_angle, beam_radius, beam_divergence, tilt, \
    cross_tilt, standoff : array_like
        As in `water_response`.

    Returns
    -------
    ndarray
        F(z), of the broadcast shape; times the volume scattering function at 180
        degrees and a step of depth it is received over launched power, and times
        reflectance over pi it is the echo of a diffuse plane [sr].

    Raises
    ------
    ValueError
        If an argument is not finite or outside its range, or if the phase function
        cannot be used.

    Notes
    -----
    In eq. (29) of Ricci et al. 2010 [1]_, as rederived, scattering damps the spatial
    frequency :math:`\kappa` by :math:`\exp(-L)`,

    .. math:: L(\kappa^2) = 2 b \int_0^z [1 - \hat p_f(\kappa s)] \, ds ,

    with the transform of the forward part, which at zero is its fraction of the
    scattering. The closure replaces L by the line with its value and its slope at one
    frequency :math:`\kappa_*`,

    .. math::

       L \simeq A + \tfrac14 B \kappa^2, \quad B = 4 L'(\kappa_*^2), \quad
       A = L(\kappa_*^2) - \tfrac14 B \kappa_*^2 ,

       F(z) = \frac{\pi R^2 \gamma^2}{S} \exp\Bigl[-2 a z - A
       - \frac{|\boldsymbol\rho_0 - \mathbf n_0 \zeta|^2}{S}\Bigr], \quad
       S = R^2 + \gamma^2 \zeta^2 + B ,

    and :math:`\kappa_*^2 = 4 / S` is the mean square frequency of this very light, so S
    is found by iteration. L is concave, so every tangent gives less light on the axis
    than eq. (29), and this tangent gives the most. If there are two solutions, as for
    receivers with an acceptance below some 10 mrad, the solution with more light is
    used. At :math:`\kappa_* = 0` it would be the diffusion model of the same split. The
    closure is exact without forward scattering, and for few or very many scattering
    events. It is valid at depths where `departure` is at most 0.25: there it has 0.7 to
    1 of the light of eq. (29). Elsewhere it may have almost none of it: close to the
    instrument, and off the axis of a receiver with a small acceptance, which receives
    only light scattered by large angles.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> taken = overlap(
    ...     1.5, absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.97),
    ...     split_angle=np.pi / 2, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=0.08,
    ... )
    >>> print(f"{taken:.2e} sr")
    2.39e-05 sr
    """
    arguments = Arguments(
        absorption=absorption,
        scattering=scattering,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
    )
    return overlap_of(
        _light,
        depth,
        arguments,
        phase_function=phase_function,
        split_angle=split_angle,
    )


def departure(
    depth: ArrayLike,
    *,
    absorption: ArrayLike,
    scattering: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    baseline: ArrayLike,
    receiver_radius: ArrayLike,
    acceptance_angle: ArrayLike,
    beam_radius: ArrayLike = 0.0,
    beam_divergence: ArrayLike = 0.0,
    tilt: ArrayLike = 0.0,
    cross_tilt: ArrayLike = 0.0,
    standoff: ArrayLike = 0.0,
) -> Array:
    r"""Estimate the ratio of the overlap of eq. (29) to that of the closure, less 1.

    Parameters
    ----------
    depth, absorption, scattering, phase_function, split_angle, baseline, \
    receiver_radius, acceptance_angle, beam_radius, beam_divergence, tilt, \
    cross_tilt, standoff : array_like
        As in `overlap`.

    Returns
    -------
    ndarray
        Eq. (29) over the closure, less 1, of the broadcast shape [1]; infinite where
        it is beyond 1, too large for an estimate.

    Raises
    ------
    ValueError
        As `overlap`.

    Notes
    -----
    From S, A, B of `overlap` and the exponent L alone, with :math:`q = |\boldsymbol
    \rho_0 - \mathbf n_0 \zeta|^2 / S`,

    .. math::

       e^q \int_0^\infty e^{-t} J_0(2 \sqrt{q t}) \bigl[e^{-L(4 t / S) + A
       + B t / S} - 1\bigr] \, dt

    by Gauss's rule of 16 nodes; infinite, too, where A is above 3 (the closure then
    loses 95 % of the light, most of it wrongly) or q above 30. For small departures it
    is :math:`-\tfrac12 L'' \kappa_*^4 (1 - q)^2`: the closure fails by the curvature of
    L, and the more the farther the spot is off the axis.

    The closure holds where this is at most `LARGEST_DEPARTURE`, 0.25, either way. In
    drawn geometries (acceptance 5 to 100 mrad, baseline 0 to 0.4 m, 0.1 to 3 1/m) it
    then has 0.7 to 1 of the light of eq. (29).

    Examples
    --------
    A receiver aside that accepts 80 mrad, and one that accepts 20:

    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> off = departure(
    ...     2.0, absorption=0.15, scattering=0.35,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     split_angle=np.pi / 2, baseline=0.2, receiver_radius=0.02,
    ...     acceptance_angle=[0.08, 0.02],
    ... )
    >>> print(off.round(2))
    [0.12  inf]
    """
    arguments = Arguments(
        absorption=absorption,
        scattering=scattering,
        baseline=baseline,
        receiver_radius=receiver_radius,
        acceptance_angle=acceptance_angle,
        beam_radius=beam_radius,
        beam_divergence=beam_divergence,
        tilt=tilt,
        cross_tilt=cross_tilt,
        standoff=standoff,
    )
    return overlap_of(
        _departures,
        depth,
        arguments,
        phase_function=phase_function,
        split_angle=split_angle,
    )


def _water(column: Column, spread: Table) -> small_angle_kernels.Water:
    """Convert a water column to an argument of the compiled loops."""
    return small_angle_kernels.Water(
        loss=column.loss(spread),
        forward=2 * column.scattering * spread.fraction,
        split_angle=spread.split,
        **column.look(),
        radius_squared=column.receiver_radius**2 + column.beam_radius**2,
        angle_squared=column.acceptance_angle**2 + column.beam_divergence**2,
    )


def _peak(column: Column) -> float:
    """Return the scale pi R^2 gamma^2 of the overlap [m^2 sr]."""
    return math.pi * (column.receiver_radius * column.acceptance_angle) ** 2


def _light(depth: Array, column: Column, spread: Table) -> Array:
    """Return the overlap F(z) of beam and receiver at each depth [sr]."""
    out = np.empty(depth.size)
    water = _water(column, spread)
    _kernels.collected(looks(depth, column), water, spread.cells, out)
    return np.asarray(_peak(column) * out)


def _departures(depth: Array, column: Column, spread: Table) -> Array:
    """Return the overlap of eq. (29) minus the closure's, over the closure's [1]."""
    return _lacking(depth, column, spread)[:, 1]


def _lacking(depth: Array, column: Column, spread: Table) -> Array:
    """Return the overlap of eq. (29) minus the closure's, absolute and relative."""
    out = np.empty((depth.size, 2))
    _kernels.departures(
        looks(depth, column),
        _water(column, spread),
        spread.cells,
        bessel(),
        _laguerre(),
        out,
    )
    return out


@cache
def _laguerre() -> Array:
    """Return 16 Gauss-Laguerre nodes and weights."""
    return np.stack(np.polynomial.laguerre.laggauss(16))


def _lacked(column: Column, spread: Table) -> float:
    """Return the closure's error against eq. (29), over the column's light [1]."""
    loss = column.loss(spread) / 2
    across = (column.receiver_radius + column.baseline) / column.acceptance_angle
    faded = _REACH / loss if loss > 0 else np.inf
    end = min(column.end, faded, max(100.0 * across, 10.0))
    depth = np.geomspace(1e-3 * end, end, _DEPTHS)
    light = float(depth @ _light(depth, column, spread)) / _peak(column)
    lacking = float(depth @ np.abs(_lacking(depth, column, spread)[:, 0]))
    if light > 0:
        return lacking / light
    return np.inf if lacking > 0 else 0.0


def _response(
    phase_per_depth: Array, column: Column, spread: Table, *, lacking: list[float]
) -> NDArray[np.complex128]:
    """Return the depth integral of exp(i w z) times the overlap F(z) [m sr]."""
    result = np.zeros(phase_per_depth.size, dtype=complex)
    if column.end == 0:
        return result
    lacking.append(_lacked(column, spread))
    water = _water(column, spread)
    aspect = math.sqrt(water.radius_squared / water.angle_squared)
    step = 0.3 * (aspect + column.baseline)
    if water.loss > 0:
        step = min(step, 1 / water.loss)
    layout = _kernels.Layout(step=step, **_meeting(water), end=column.end)
    order = np.argsort(phase_per_depth)
    sums = np.zeros((2, phase_per_depth.size))
    _kernels.water_column(
        water,
        layout,
        spread.cells,
        phase_per_depth[order],
        (RULE, *depth_rule()),
        sums,
    )
    result[order] = sums[0] + 1j * sums[1]
    return np.asarray(_peak(column) * result)


def _meeting(water: small_angle_kernels.Water) -> dict[str, float]:
    """Return depth and extent of the closest approach of beam and receiver axis [m]."""
    slant = water.tilt**2 + water.cross_tilt**2
    if slant == 0:
        return {"nearest": -1.0, "narrow": 0.0}
    path = water.baseline * water.tilt / slant
    width = math.sqrt((water.radius_squared + water.angle_squared * path**2) / slant)
    return {"nearest": path - water.standoff, "narrow": width}
