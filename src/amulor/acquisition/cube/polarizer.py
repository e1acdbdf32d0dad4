"""Calibration of polarization channels with a turned polarizer: gain, cross-talk."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.acquisition.cube.calibrate import applied, measured_on
from amulor.acquisition.cube.calibration import (
    MOST_CROSSTALK,
    Calibration,
    ChannelResponse,
)
from amulor.errors import CubeError

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Angles of the polarizer that determine both analyzers, with a test.
_FEWEST_ANGLES = 5
#: Largest gap between neighboring angles in half a turn [rad].
_LARGEST_GAP = math.radians(60)
#: Pairs of orthogonal linear analyzers.
_PAIRS = (("V", "H"), ("H", "V"), ("P", "M"), ("M", "P"))


def from_polarizer(
    recordings: Sequence[xr.Dataset], *, angles: Sequence[float]
) -> Calibration:
    r"""Calibrate gain, phase and cross-talk of two channels with a turned polarizer.

    Parameters
    ----------
    recordings : sequence of xarray.Dataset
        Cubes of level `samples` with two orthogonal linear analyzers, such as VV and
        VH, recorded through a polarizer in front of the receiver.
    angles : sequence of float
        Angle of the polarizer in each cube, from any zero: at least five in half a
        turn [rad].

    Returns
    -------
    Calibration
        Gain of each channel relative to the first one, as a complex number for each
        frequency, and cross-talk: the response to the orthogonal polarization, divided
        by the response to the polarization of the channel.

    Raises
    ------
    CubeError
        If a cube is of another level, the channels are not such a pair, or the angles
        are too few or leave a gap of more than 60 degrees, or if the cross-talk is not
        below 0.5, as of light that is lost in noise.
    ValueError
        If the numbers of cubes and angles differ.

    Notes
    -----
    By Malus' law the response of an analyzer at the angle :math:`\theta` is
    :math:`\cos^2(\alpha - \theta) + e \sin^2(\alpha - \theta)`, with the extinction e.
    The light behind the polarizer is unknown. The share of a channel in the sum of both
    does not depend on it. Least squares fit this share to both directions, both
    extinctions, and a complex gain at each frequency. If it scatters by more than its
    error, for example by wrong angles, the uncertainties grow. The polarization of the
    laser is not measured.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import acquisition, samples
    >>> cube = samples.cube("ladder").isel(row=[18])
    >>> def through(angle):  # the second analyzer passes 1 % of the other light
    ...     first = np.cos(angle) ** 2
    ...     factor = np.array([first, 1 - first + 0.01 * first])[:, None, None]
    ...     light = {}
    ...     for name in ("in_phase", "quadrature"):
    ...         values = cube[name].values[:, [0, 0]] * factor
    ...         light[name] = cube[name].copy(data=values)
    ...     return cube.assign(light)
    >>> angles = np.radians([0, 30, 60, 90, 120, 150])
    >>> calibration = acquisition.from_polarizer(
    ...     [through(angle) for angle in angles], angles=angles
    ... )
    >>> print(f"{calibration.channels[1].crosstalk:.3f}")
    0.010
    """
    angle = np.asarray(angles, dtype=float)
    if angle.shape != (len(recordings),):
        raise ValueError(
            f"{angle.size} angles for {len(recordings)} cubes; state one for each"
        )
    _refuse_angles(angle)
    first = recordings[0]
    names = first.amulor.polarizations
    for cube in recordings:
        cubes.check(cube, "samples", name="the cube through the polarizer")
        same = np.array_equal(
            cube["modulation_frequency"], first["modulation_frequency"]
        )
        if cube.amulor.polarizations != names or not same:
            raise CubeError(
                "the cubes through the polarizer differ in frequencies or channels; "
                "record all of them with one survey"
            )
    if len(names) != 2 or (names[0][-1], names[1][-1]) not in _PAIRS:
        raise CubeError(
            f"the cubes through the polarizer have the channels {', '.join(names)}; "
            "needed are two with orthogonal linear analyzers, such as VV and VH"
        )
    shares = [_shares(cube) for cube in recordings]
    share, sigma = (np.array([part[k] for part in shares]) for k in (0, 1))
    fit = _fit(angle, share, sigma)
    for name, found, error in zip(
        names, fit.crosstalk, fit.crosstalk_uncertainty, strict=True
    ):
        if not abs(found) < MOST_CROSSTALK:
            raise CubeError(
                f"the cubes through the polarizer give {name} a cross-talk of "
                f"{found:.2g} with an uncertainty of {error:.2g}; needed is less than "
                f"{MOST_CROSSTALK:g}: check the angles, or record stronger light"
            )
    entries = []
    for number, frequency in enumerate(first["modulation_frequency"].values):
        gains = (1.0 + 0j, 0.0), (fit.gain[number], fit.gain_uncertainty[number])
        for at, (gain, error) in enumerate(gains):
            entries.append(
                ChannelResponse(
                    modulation_frequency=float(frequency),
                    polarization=names[at],
                    gain=(float(gain.real), float(gain.imag)),
                    gain_uncertainty=float(error),
                    crosstalk=float(fit.crosstalk[at]),
                    crosstalk_uncertainty=float(fit.crosstalk_uncertainty[at]),
                )
            )
    before = applied(recordings)
    return Calibration(**{**before, "date": measured_on(first), "channels": entries})


def _refuse_angles(angle: Floats) -> None:
    half = np.unique(np.round(np.mod(angle, np.pi), 6))
    gaps = np.diff(np.append(half, half[:1] + np.pi))
    if half.size < _FEWEST_ANGLES or gaps.max() > _LARGEST_GAP + 1e-3:
        raise CubeError(
            f"the polarizer has {half.size} angles in half a turn, with gaps of up to "
            f"{np.degrees(gaps.max()) if gaps.size else 180:.0f} degrees; needed are "
            f"{_FEWEST_ANGLES} or more with gaps of at most 60, such as every 30"
        )


def _shares(cube: xr.Dataset) -> tuple[Complex, Floats]:
    """Return the share of the first channel in the sum of both, by frequency.

    With the standard error of each of its components. Both channels have the same light
    in each pixel, so that only the rest is an error. Squares of noise, which has the
    stated ratio of both channels, are no light: they are the smallest eigenvalue of the
    products of both channels.
    """
    signal = cube.amulor.signal.values
    signal = signal.reshape(*signal.shape[:2], -1)
    usable = np.isfinite(signal).all(axis=1)
    count = usable.sum(axis=1)
    if count.min() < 2:
        raise CubeError(
            "a cube through the polarizer has fewer than two pixels with both channels"
        )
    seen = np.where(usable[:, None], signal, 0)
    stated = np.hypot(
        cube["in_phase_uncertainty"].values, cube["quadrature_uncertainty"].values
    )
    square = np.where(usable[:, None], stated.reshape(signal.shape) ** 2, 0).sum(axis=2)
    known = np.all(square > 0)
    noise = np.sqrt(square / square[:, :1]) if known else np.ones(square.shape)
    products = (seen @ seen.conj().swapaxes(1, 2)) / (
        noise[:, :, None] * noise[:, None]
    )
    least = np.linalg.eigvalsh(products)[:, :1]
    products -= least[:, :, None] * np.eye(2)
    light = noise * (products @ noise[:, :, None])[:, :, 0]
    power = light.sum(axis=1)
    share = light[:, 0] / power
    rest = np.abs(seen[:, 0] - share[:, None] * seen.sum(axis=1)) ** 2
    return share, np.sqrt(rest.sum(axis=1) / (2 * (count - 1)) / power.real)


@dataclass(frozen=True, kw_only=True)
class _Fit:
    gain: Complex
    """Gain of the second channel relative to the first one, by frequency [1]."""
    gain_uncertainty: Floats
    """Standard uncertainty of each component of the gain [1]."""
    crosstalk: tuple[float, float]
    """Cross-talk of both channels [1]."""
    crosstalk_uncertainty: tuple[float, float]
    """Standard uncertainty of the cross-talk [1]."""


def _fit(angle: Floats, share: Complex, sigma: Floats) -> _Fit:
    """Fit directions, extinctions and gains to shares, shape (angle, frequency)."""
    from scipy.optimize import least_squares

    count = share.shape[1]
    sigma = np.maximum(sigma, np.finfo(float).eps)

    def rest(values: Floats) -> Floats:
        first, turn, passed, crossed = values[:4]
        gain = values[4 : 4 + count] + 1j * values[4 + count :]
        cosine, sine = np.cos(angle - first) ** 2, np.sin(angle - first - turn) ** 2
        one = cosine + passed * (1 - cosine)
        other = gain * (sine + crossed * (1 - sine))[:, None]
        off = ((share - one[:, None] / (one[:, None] + other)) / sigma).ravel()
        return np.concatenate([off.real, off.imag])

    # Of extinctions above 1 the analyzers are exchanged, with the same shares.
    limit = np.full(4 + 2 * count, np.inf)
    limit[2:4] = 1.0
    fits = [
        least_squares(
            rest,
            [start, 0.0, 0.0, 0.0, *np.ones(count), *np.zeros(count)],
            x_scale="jac",
            bounds=(-limit, limit),
        )
        for start in np.unique(np.mod(angle, np.pi))
    ]
    fit = min(fits, key=lambda result: float(result.cost))
    excess = max(2 * float(fit.cost) / (2 * share.size - fit.x.size), 1.0)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * excess
    error = np.sqrt(np.diag(covariance))
    turn, passed, crossed = fit.x[1:4]
    own = np.cos(turn) ** 2 + crossed * np.sin(turn) ** 2
    # The second analyzer sees light along the axis of the first one.
    other = np.sin(turn) ** 2 + crossed * np.cos(turn) ** 2
    slope = np.array([np.sin(2 * turn), np.cos(turn) ** 2])
    of_other = math.sqrt(slope @ covariance[1:4:2, 1:4:2] @ slope)
    gain = fit.x[4 : 4 + count] + 1j * fit.x[4 + count :]
    of_gain = np.maximum(error[4 : 4 + count], error[4 + count :])
    return _Fit(
        gain=gain * own,
        gain_uncertainty=of_gain * own,
        crosstalk=(float(passed), float(other / own)),
        crosstalk_uncertainty=(float(error[2]), of_other / float(own)),
    )
