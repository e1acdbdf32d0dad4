r"""Pairs of launched and analyzed polarization states with imperfect components.

With ideal components these functions agree with
`amulor.optics.polarization.mueller.detected_fraction`. Letters of states and the
meaning of axes are those of `amulor.optics.polarization.stokes`: those of an analyzer
refer to the axes of the returning light.

A linear state needs a polarizer in its direction and no plate. For a circular state the
polarizer is along the parallel axis. A quarter-wave plate, on the side of the scene,
has its fast axis at +45 or -45 degrees.

References
----------
.. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
   :doi:`10.1155/2010/958360`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, finite, require, within
from amulor.optics.polarization import mueller as _mueller
from amulor.optics.polarization import stokes
from amulor.optics.polarization.components import linear_polarizer, retarder

__all__ = [
    "IDEAL",
    "PolarizationArm",
    "analyser",
    "circular_leak",
    "cross_talk",
    "generator",
    "launched_stokes",
    "linear_leak",
    "received_fraction",
]


@dataclass(frozen=True, eq=False, kw_only=True)
class PolarizationArm:
    """Polarizer and quarter-wave plate of the emitter or of the receiver.

    Fields are numbers or arrays that broadcast; by default all is ideal.

    Examples
    --------
    A sheet polarizer that lets a thousandth of the crossed light through:

    >>> sheet = PolarizationArm(extinction_ratio=1e-3)
    >>> print(launched_stokes("H", arm=sheet).round(3))  # (1 - r) / (1 + r)
    [1.    0.998 0.    0.   ]
    """

    extinction_ratio: ArrayLike = 0.0
    """Ratio of crossed to aligned transmission of the polarizer [1]."""
    polarizer_transmission: ArrayLike = 1.0
    """Fraction of aligned light that the polarizer passes [1]."""
    polarizer_error: ArrayLike = 0.0
    """Angle error of the polarizer [rad]."""
    retardance_error: ArrayLike = 0.0
    """Deviation of the plate's retardance from a quarter wave [rad]."""
    plate_error: ArrayLike = 0.0
    """Angle error of the plate's fast axis [rad]."""
    plate_diattenuation: ArrayLike = 0.0
    """Diattenuation of the plate, positive if the fast axis transmits more [1]."""
    plate_transmission: ArrayLike = 1.0
    """Transmission of the plate for unpolarized light [1]."""


IDEAL = PolarizationArm()
"""Components without errors or losses."""

# Direction of the polarizer, and of the fast axis of the plate of a generator [rad].
_LINEAR = {"H": 0.0, "P": np.pi / 4, "V": np.pi / 2, "M": -np.pi / 4}
_CIRCULAR = {"R": np.pi / 4, "L": -np.pi / 4}


def generator(state: str, *, arm: PolarizationArm = IDEAL) -> NDArray[np.float64]:
    """Return the Mueller matrix of emitter optics set to a polarization state.

    Parameters
    ----------
    state : str
        State as in `amulor.optics.polarization.stokes.state`; "none" means no
        component.
    arm : PolarizationArm
        Components of the emitter.

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape of the fields of `arm` with last axes (4, 4)
        [1]: the polarizer, then for "R" and "L" the plate.

    Raises
    ------
    ValueError
        If there is no state of this name, or a component is not physical.

    Examples
    --------
    >>> made = generator("R") @ stokes.state("none")
    >>> print(np.round(made + 0.0, 12))
    [0.5 0.  0.  0.5]
    """
    polarizer, plate = _components(state, arm, side=1)
    return polarizer if plate is None else plate @ polarizer


def analyser(state: str, *, arm: PolarizationArm = IDEAL) -> NDArray[np.float64]:
    """Return the Mueller matrix of receiver optics set to a polarization state.

    Parameters
    ----------
    state : str
        State that passes, as in `amulor.optics.polarization.stokes.state`; "none" means
        no component.
    arm : PolarizationArm
        Components of the receiver.

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape of the fields of `arm` with last axes (4, 4)
        [1]: for "R" and "L" the plate, then the polarizer. A detector measures only its
        first row.

    Raises
    ------
    ValueError
        If there is no state of this name, or a component is not physical.

    Examples
    --------
    >>> for state in "RL":
    ...     passed = _mueller.apply(analyser("R"), stokes.state(state))[0]
    ...     print(state, f"{passed + 0.0:.3f}")
    R 1.000
    L 0.000
    """
    polarizer, plate = _components(state, arm, side=-1)
    return polarizer if plate is None else polarizer @ plate


def launched_stokes(
    state: str,
    *,
    arm: PolarizationArm = IDEAL,
    laser: ArrayLike = (1.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Return the Stokes vector behind real emitter optics, scaled to unit intensity.

    Parameters
    ----------
    state : str
        State as in `amulor.optics.polarization.stokes.state`.
    arm : PolarizationArm
        Components of the emitter.
    laser : array_like
        Stokes vector before the components, last axis (4,), any unit; unpolarized by
        default, the worst case. A polarized laser aligned with the polarizer leaks
        less.

    Returns
    -------
    ndarray
        Stokes vector over its own intensity, last axis (4,) [1].

    Raises
    ------
    ValueError
        If there is no such state, a component is not physical, or no light leaves.

    Notes
    -----
    Relative to launched power, not to the power of the laser. The absolute Stokes
    vector after the components is ``generator(state, arm=arm) @ laser``.

    Examples
    --------
    >>> print(launched_stokes("H", arm=PolarizationArm(extinction_ratio=1 / 3)))
    [1.  0.5 0.  0. ]
    """
    light = _mueller.apply(generator(state, arm=arm), laser)
    intensity = light[..., :1]
    require(
        intensity,
        intensity > 0,
        name=f"light that leaves the emitter for the state {state!r}",
        rule="above 0",
        hint="turn the laser so that the polarizer passes it",
    )
    vector: NDArray[np.float64] = light / intensity
    return vector


def received_fraction(
    mueller: ArrayLike,
    *,
    pair: str,
    emitter: PolarizationArm = IDEAL,
    receiver: PolarizationArm = IDEAL,
    laser: ArrayLike = (1.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    r"""Return the received fraction of launched light for a real polarizer pair [1].

    Parameters
    ----------
    mueller : array_like
        Mueller matrices of target or water, last axes (4, 4) [1].
    pair : str
        Launched and analysed state, such as "VH" or "RR", or "none" for no components;
        letters as in `amulor.optics.polarization.stokes.state`.
    emitter, receiver : PolarizationArm
        Components of both sides.
    laser : array_like
        Stokes vector of the laser, as in `launched_stokes`.

    Returns
    -------
    ndarray
        Received over launched power, broadcast shape of `mueller` without the last two
        axes and the fields of the arms [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4), the pair is not known, or a component is not
        physical.

    See Also
    --------
    amulor.optics.polarization.mueller.detected_fraction : With ideal components.

    Notes
    -----
    First element of :math:`A M \mathbf s` with the matrix A of the analyzer and the
    launched vector s of intensity 1, from eq. (60) of Ricci et al. 2010 [1]_, as
    rederived; with ideal components the readings of eqs. (68) and (69). Losses in the
    emitter occur before the launch and have no effect.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> sheet = PolarizationArm(extinction_ratio=1e-3, polarizer_transmission=0.8)
    >>> mirror = _mueller.ideal_backscatter()
    >>> for pair in ("VV", "VH"):
    ...     part = received_fraction(mirror, pair=pair, emitter=sheet, receiver=sheet)
    ...     print(pair, f"{part:.4f}")
    VV 0.7992
    VH 0.0016
    """
    first, second = stokes.pair_states(pair)
    launched = launched_stokes(first, arm=emitter, laser=laser)
    returned = _mueller.apply(mueller, launched)
    row = analyser(second, arm=receiver)[..., 0, :]
    fraction: NDArray[np.float64] = np.sum(row * returned, axis=-1)
    return fraction


def cross_talk(
    mueller: ArrayLike,
    *,
    pair: str,
    emitter: PolarizationArm = IDEAL,
    receiver: PolarizationArm = IDEAL,
    laser: ArrayLike = (1.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    r"""Return the error of the detected fraction caused by imperfect components.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices of target or water, last axes (4, 4) [1].
    pair : str
        Launched and analysed state, as in `received_fraction`.
    emitter, receiver : PolarizationArm
        Components of both sides.
    laser : array_like
        Stokes vector of the laser, as in `launched_stokes`.

    Returns
    -------
    ndarray
        Received fraction over the transmission of the receiver's components, less the
        fraction with ideal components [1]. For a dark ideal pair this is the leak. For
        a bright pair it is negative: the light lost to the other pair.

    Raises
    ------
    ValueError
        As `received_fraction`, or if the receiver's components pass nothing at all.

    Notes
    -----
    The transmission is that of the polarizer along its direction, for a circular state
    times that of the plate, so a mere loss is no cross-talk. The scene that shows the
    arms alone is `amulor.optics.polarization.mueller.ideal_backscatter`, dark in VH,
    HV, PP, RR and LL, eq. (65) of Ricci et al. 2010 (:doi:`10.1155/2010/958360`), as
    rederived. Leaks of both sides add up as powers if they come from extinction ratios,
    but retardance and axis errors of polarized light add up as amplitudes: two equal
    errors may cause four times the leak of one, or almost none.

    Examples
    --------
    >>> sheet = PolarizationArm(extinction_ratio=1e-3)
    >>> mirror = _mueller.ideal_backscatter()
    >>> print(f"{cross_talk(mirror, pair='VH', receiver=sheet):.1e}")
    1.0e-03
    """
    fraction = received_fraction(
        mueller, pair=pair, emitter=emitter, receiver=receiver, laser=laser
    )
    _, second = stokes.pair_states(pair)
    passed = np.asarray(1.0)
    if second in _LINEAR or second in _CIRCULAR:
        passed = np.asarray(receiver.polarizer_transmission, dtype=np.float64)
    if second in _CIRCULAR:
        passed = passed * np.asarray(receiver.plate_transmission, dtype=np.float64)
    require(
        passed,
        passed > 0,
        name="transmission of the receiver's components",
        rule="above 0",
        hint="else nothing is received",
    )
    added: NDArray[np.float64] = fraction / passed - _mueller.detected_fraction(
        mueller, pair=pair
    )
    return added


def linear_leak(
    *, axis_error: ArrayLike, extinction_ratio: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the fraction of light that leaks through a misaligned polarizer.

    Parameters
    ----------
    axis_error : array_like
        Angle between polarizer and the direction at right angles to the light [rad].
    extinction_ratio : array_like
        Power that passes crossed over power that passes aligned, 0 to 1 [1].

    Returns
    -------
    ndarray
        Leak over transmission of aligned light, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an extinction ratio is outside of its range.

    Notes
    -----
    :math:`\sin^2\alpha + e \cos^2\alpha`, the law of Malus and the extinction ratio;
    for a tolerance budget. Below :math:`\alpha = \sqrt e` the extinction ratio
    dominates: 1.8 degrees for 1000:1.

    Examples
    --------
    >>> leak = linear_leak(axis_error=np.radians([0.0, 1.0]), extinction_ratio=1e-4)
    >>> print(np.round(leak, 6))
    [0.0001   0.000405]
    """
    alpha = finite(axis_error, name="axis_error", unit="rad")
    e = within(extinction_ratio, 0, 1, name="extinction_ratio")
    broadcast(axis_error=alpha, extinction_ratio=e)
    leak: NDArray[np.float64] = np.sin(alpha) ** 2 + e * np.cos(alpha) ** 2
    return leak


def circular_leak(
    *, retardance_error: ArrayLike, plate_error: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the fraction of opposite circular light that passes a circular analyzer.

    Parameters
    ----------
    retardance_error : array_like
        Retardance of the plate less a quarter wave [rad].
    plate_error : array_like
        Deviation of the fast axis from 45 degrees to the polarizer [rad].

    Returns
    -------
    ndarray
        Leak over the transmission of both helicities together, of the broadcast shape
        [1].

    Notes
    -----
    :math:`\tfrac12 (1 - \cos\eta \cos 2\varepsilon)` with the retardance error
    :math:`\eta` and the plate error :math:`\varepsilon`: :math:`\sin^2(\eta/2)` and
    :math:`\sin^2\varepsilon` for one of them alone. The same formula applies to a
    generator. A plate of a given delay :math:`\eta` grows with :math:`1/\lambda`: a
    quarter-wave plate for 532 nm has :math:`\eta = 0.49` rad at 405 nm, and leaks 6 %.

    Examples
    --------
    >>> eta = np.pi / 2 * (532 / 405 - 1)
    >>> print(f"{circular_leak(retardance_error=eta, plate_error=0.0):.3f}")
    0.059
    """
    eta = finite(retardance_error, name="retardance_error", unit="rad")
    turn = finite(plate_error, name="plate_error", unit="rad")
    broadcast(retardance_error=eta, plate_error=turn)
    # Half of 1 - cos, without loss of digits for small errors.
    leak: NDArray[np.float64] = np.sin(eta / 2) ** 2 + np.cos(eta) * np.sin(turn) ** 2
    return leak


def _components(
    state: str, arm: PolarizationArm, *, side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return Mueller matrices of polarizer and quarter-wave plate, in that order."""
    stokes.state(state)  # refuses names that are none
    if state == "none":
        return np.eye(4), None
    polarizer = linear_polarizer(
        _LINEAR.get(state, 0.0)
        + finite(arm.polarizer_error, name="polarizer_error", unit="rad"),
        extinction_ratio=arm.extinction_ratio,
        transmission=arm.polarizer_transmission,
    )
    if state in _LINEAR:
        return polarizer, None
    plate = retarder(
        np.pi / 2 + finite(arm.retardance_error, name="retardance_error", unit="rad"),
        angle=side * _CIRCULAR[state]
        + finite(arm.plate_error, name="plate_error", unit="rad"),
        diattenuation=arm.plate_diattenuation,
        transmission=arm.plate_transmission,
    )
    return polarizer, plate
