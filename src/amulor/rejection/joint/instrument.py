"""How well the instrument is known, and what that means for slant ranges."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import rays

Floats = NDArray[np.float64]

#: Standard uncertainty of the axis of a receiver about which nothing is said [rad].
DIRECTION = float(np.radians(1.0))
#: Standard uncertainty of what light that is scattered on its way adds to the range,
#: over what small angles at a spread that grows with the depth would add [1].
LATE_ECHO = 0.5
#: Steps of path and position [m] and of the index [1] for derivatives.
_STEP, _INDEX_STEP = 1e-5, 1e-6


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """Standard uncertainties of what the samples cannot tell about an instrument."""

    delay: float
    """Of the delay that all channels share [s]."""
    group_index: float
    """Of the group index of the water [1]."""
    position: float
    """Of the receiver to the right and down; forward it counts as delay [m]."""
    direction: float
    """Of the axis of the receiver, in azimuth and in elevation [rad]."""
    late_echo: float
    """Of the delay of scattered light, over `late_echo` [1]."""

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
        """Return uncertainties that are finite and not below zero."""
        given = {
            "delay_uncertainty": delay,
            "group_index_uncertainty": group_index,
            "receiver_position_uncertainty": position,
            "receiver_direction_uncertainty": direction,
            "late_echo_uncertainty": late_echo,
        }
        for name, value in given.items():
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
    r"""Return what scattered light adds to the range, if it all counted [m].

    Parameters
    ----------
    depth : ndarray
        Way through the water to the target [m].
    spread : float
        Growth of the mean square angle of the light that is still in view, see
        `Frame.late_spread` [rad^2/m].

    Returns
    -------
    ndarray
        Half the mean detour there and back.

    Notes
    -----
    A path that is inclined by small angles of mean square :math:`\sigma^2 z` at the
    depth z is longer by :math:`\int \theta^2 / 2 \, dz = \sigma^2 z^2 / 4`. Unscattered
    light and a receiver that accepts small angles only make the echo less late: the
    spread in view is such that half of this detour is what theory says.
    """
    late: Floats = 0.25 * spread * np.square(depth)
    return late


def range_variance(
    instrument: Instrument,
    path: Floats,
    beam: rays.Beam,
    receiver: Floats,
    medium: rays.Medium,
) -> Floats:
    r"""Return the variance of slant ranges by what is not known of the instrument.

    Parameters
    ----------
    instrument : Instrument
        Standard uncertainties.
    path : ndarray
        Optical paths, out and back [m].
    beam : Beam
        Beams of the same shape.
    receiver : ndarray, shape (3,)
        Where the light is collected [m].
    medium : Medium
        What the light crosses.

    Returns
    -------
    ndarray
        Variance, which pixels have in common [m^2].

    Notes
    -----
    To first order :math:`(c_0 u_\tau \partial r / \partial p)^2 + (u_n \partial r /
    \partial n_g)^2 + u_x^2 |\partial r / \partial x|^2` with the two coordinates x of
    the receiver across the scan, and with the path p held fixed. The phase of the
    water signal holds delay and baseline too, but only as well as the model of the
    water is right, so that it is not asked.
    """

    def to_range(
        length: Floats, place: Floats = receiver, through: rays.Medium = medium
    ) -> Floats:
        return rays.slant_range_of_path(length, beam, place, medium=through)

    here = to_range(path)
    by_path = (to_range(path + _STEP) - here) / _STEP
    other = dataclasses.replace(medium, group_index=medium.group_index + _INDEX_STEP)
    by_index = (to_range(path, through=other) - here) / _INDEX_STEP
    variance = (speed_of_light * instrument.delay * by_path) ** 2
    variance += (instrument.group_index * by_index) ** 2
    for axis in range(2):
        step = np.zeros(3)
        step[axis] = _STEP
        by_place = (to_range(path, receiver + step) - here) / _STEP
        variance += (instrument.position * by_place) ** 2
    total: Floats = variance
    return total
