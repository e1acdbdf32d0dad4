"""The water signal from open-water shots: a smooth surface over the scan directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance, isotropic, times
from amulor.rejection.reference import interpolation
from amulor.rejection.reference.drift import Drift, drift_of
from amulor.rejection.reference.places import FEWEST_SHOTS, design_of, places_of
from amulor.rejection.reference.scatter import fluctuation
from amulor.rejection.reference.shape import Shape
from amulor.rejection.reference.surface import Surface, noise_of, surface_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels at which the polynomial is evaluated at once; this bounds the memory.
_AT_ONCE = 16_384


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Water signal at each pixel, and how well it is known."""

    signal: Complex
    """Expected water signal [V]."""
    common: Covariance
    """Error of that expectation: the pixels share it."""
    relative: NDArray[np.float64]
    """(Radial, tangential) covariance of one sample, per squared signal [1]."""
    degree: int
    """Degree of the polynomial over the scan directions."""
    drift: Drift
    """What changed from the first shot to the last."""
    surface: Surface
    """The polynomial through the shots."""
    modelled: bool = False
    """Whether a model of the water stands behind the polynomial."""


def fit(
    shots: Complex,
    instrument: Covariance,
    shot_direction: Floats,
    pixel_direction: Floats,
    *,
    shape: Shape | None = None,
    surface: Surface | None = None,
) -> Reference:
    """Fit the open-water shots of one channel and evaluate the fit at the pixels.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target [V].
    instrument : Covariance
        Their stated errors.
    shot_direction : ndarray, shape (n, 2)
        Azimuth and elevation of the shots; all equal if they are not known [rad].
    pixel_direction : ndarray, shape (m, 2)
        Azimuth and elevation of the pixels [rad].
    shape : Shape, optional
        How a model of the water varies over shots and pixels.
    surface : Surface, optional
        The polynomial through these shots, if it is known.

    Returns
    -------
    Reference
        Arrays over the m pixels.

    Raises
    ------
    ValueError
        If there are fewer than `FEWEST_SHOTS`.

    Notes
    -----
    Least squares of a polynomial, one degree above the lowest whose misfit, against
    the scatter of repeated shots, passes an F test: a misfit that the test does not
    see is as large as the error itself, and the next degree takes most of it. What
    the shots scatter beyond their stated error is a fluctuation of the water, taken as
    proportional to its signal. How far the polynomial may be off between the shots is
    told by a second one through their logarithms: the difference of the two counts as
    a standard error, see `interpolation.disagreement`.

    With a `shape` the polynomial stands for the ratio of the water to that model, which
    varies less. Where no degree passes the test, what the means of directions are off
    the surface beyond their scatter counts as an error of the reference in every
    direction (Birge ratio).
    """
    if len(shots) < FEWEST_SHOTS:
        raise ValueError(f"a reference needs {FEWEST_SHOTS} shots, got {len(shots)}")
    places = places_of(shot_direction)
    found = surface
    if found is None:
        found = surface_of(
            shots,
            instrument,
            places,
            noise=noise_of(shots, instrument, places),
            model=None if shape is None else shape.at_shots,
        )
    # One product of real matrices for all: coefficients, logarithms, covariances.
    second = found.logarithm
    along = np.zeros(len(found.powers), dtype=complex) if second is None else second[0]
    table = np.hstack(
        [
            found.coefficients.real[:, None],
            found.coefficients.imag[:, None],
            along.real[:, None],
            along.imag[:, None],
            *found.spreads,
        ]
    )
    signal = np.empty(len(pixel_direction), dtype=complex)
    common = [np.empty(len(pixel_direction)) for _ in found.spreads]
    for first in range(0, len(pixel_direction), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        design = design_of(places.scaled(pixel_direction[part]), found.powers)
        product = times(design, table)
        signal[part] = product[:, 0] + 1j * product[:, 1]
        sides = product[:, 4:].reshape(len(design), len(found.spreads), -1)
        for k, values in enumerate(common):
            values[part] = np.einsum("ij,ij->i", sides[:, k], design)
        if second is not None:
            off = interpolation.disagreement(
                signal[part], product[:, 2] + 1j * product[:, 3], second[1]
            )
            common[0][part] += off.real**2
            common[1][part] += off.imag**2
            common[2][part] += off.real * off.imag
    errors = Covariance(*common)
    if shape is not None:
        signal, errors = signal * shape.at_pixels, errors.turned(shape.at_pixels)
    if found.excess > 0:
        # By so much more than chance each direction is off by itself.
        own = isotropic(np.full(signal.shape, _typical(instrument)))
        own = own + fluctuation(found.relative, signal)
        errors = errors + own.scaled(found.excess * len(places.size) / len(shots))
    return Reference(
        signal=signal,
        common=errors,
        relative=found.relative,
        degree=int(found.powers.sum(axis=1).max()),
        drift=drift_of(shots, found.level, places.where),
        surface=found,
        modelled=shape is not None,
    )


def _typical(instrument: Covariance) -> float:
    return float(np.sqrt(np.mean(instrument.in_phase + instrument.quadrature)))
