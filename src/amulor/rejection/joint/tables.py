"""Tables of the water signal against the end depth of the water, by direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint._kernels.bundles import WaterTable
from amulor.rejection.joint.overlap import (
    COEFFICIENTS,
    SMALLEST_STRENGTH,
    Frame,
    Shape,
    hats,
    unseen_beam,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Water signal of unit strength against the depth where the water ends.

    Strength 1 is 1 V of open water at frequency 0 in the middle of the scan.
    """

    step: float
    """Spacing of the depth nodes [m]."""
    value: Complex
    """Water signal, axes (component, node, frequency) [1]."""
    slope: Complex
    """Derivative of the water signal with respect to depth [1/m]."""
    basis: Floats
    """Coefficients of the components in each direction, (direction, component) [1]."""
    level: Floats
    """Unmodulated open-water signal by component; 1 in the middle of the scan [1]."""
    strength: float
    """Ratio of received to launched power for strength 1, per backscatter [sr m]."""
    differentiated: Callable[[], Changes]
    """Function that computes the derivatives by the shape parameters."""

    @cached_property
    def changes(self) -> Changes:
        """Derivatives by the shape parameters, for steps of the fit that are taken."""
        return self.differentiated()

    @cached_property
    def arrays(self) -> WaterTable:
        """Table of the water signal as an argument of the compiled loops."""
        return WaterTable(self.step, to_pairs(self.value), to_pairs(self.slope))


@dataclass(frozen=True)
class Changes:
    """Derivatives of a table by the shape parameters."""

    value: Complex
    """Derivatives, axes (parameter, component, node, frequency) [1]."""
    basis: Floats
    """Coefficients of the components in each direction, (direction, component) [1]."""


@dataclass(frozen=True, kw_only=True)
class Integrand:
    """Water light at the quadrature points of depth, with their phases and weights."""

    frame: Frame
    """Receiver geometry."""
    shape: Shape
    """Shape of the water signal."""
    depth: Floats
    """Quadrature points of depth [m]."""
    measure: Floats
    """Quadrature weights [m]."""
    phasor: Complex
    """Phase of the modulation, out and back, (point, frequency) [1]."""
    count: int
    """Number of depth cells of the table."""
    light: Floats
    """Overlap with its correction, (direction, point) [sr]."""

    @property
    def unmodulated(self) -> Floats:
        """Unmodulated open-water signal, by direction [sr m]."""
        total: Floats = self.light @ self.measure
        return total

    def integrated(self, reduced: Floats) -> Complex:
        """Return running integrals of (parameter, component, point) over depth."""
        parameters, size = reduced.shape[:2]
        shape = parameters, size, self.count + 2, self.phasor.shape[1]
        total = np.empty(shape, dtype=complex)
        kernels.integrate(reduced, self.phasor, _ORDER, self.count, total)
        return total

    def changes(self, strength: float) -> Changes:
        """Return the derivatives of the water signal of unit strength."""
        derivatives = _light_changes(self.frame, self.depth, self.shape, self.light)
        basis = _components(self.light, derivatives)
        at_zero = (self.frame.directions.centre @ derivatives) @ self.measure
        # Light per strength, and the change of the strength: combined before the
        # integrals, whose tables are large.
        measure = self.measure / strength
        reduced = basis.T @ derivatives * measure
        reduced -= (basis.T @ self.light * measure) * (at_zero / strength)[
            :, None, None
        ]
        return Changes(self.integrated(reduced), basis)


def to_pairs(values: Complex) -> Floats:
    """Split complex numbers into real and imaginary parts, on the second-last axis."""
    return np.ascontiguousarray(np.stack([values.real, values.imag], axis=-2))


def from_pairs(values: Floats) -> Complex:
    """Combine real and imaginary parts on the second-last axis into complex numbers."""
    pairs: Complex = values[..., 0, :] + 1j * values[..., 1, :]
    return pairs


#: Nodes of depth within one period of the highest frequency, out and back.
_NODES_PER_PERIOD = 20
#: More would not be a scan but a mistake in the interval.
_MOST_NODES = 6000
#: Components of the dependence on the direction are left out below this [1].
_SMALLEST_COMPONENT = 1e-5
_ORDER = 4
#: Length of a cell behind the last target, in periods of the highest frequency [1].
_BEHIND = 0.3
#: Negligible fraction of the largest overlap [1].
_NEGLIGIBLE = 1e-30
#: Step of a log coefficient for one-sided derivatives: truncation and rounding errors
#: are both far below the precision needed for a step of the fit.
_SMALL = 1e-5


def table_of(frame: Frame, shape: Shape, *, deepest: float) -> Table:
    """Integrate the water signal up to every depth.

    (29) of Ricci et al. 2010, as rederived and conjugated, by Gauss's rule with
    four points between neighboring nodes.
    """
    period = 2 * np.pi / frame.phase_per_path.max() / (2 * frame.medium.group_index)
    far = min(frame.nothing_left(shape), frame.end)
    inner = min(deepest, far)
    step = period / _NODES_PER_PERIOD
    count = max(int(np.ceil(inner / step)), 8)
    if count > _MOST_NODES:
        raise CubeError(
            f"the water signal reaches {inner:.3g} m, which is {count} steps of "
            f"{step * 1e3:.2g} mm at the highest frequency; narrow the interval of "
            "slant ranges, or leave the highest frequencies out"
        )
    edges = np.arange(count + 1) * step
    if far > edges[-1]:
        # Behind the last target only the sum counts: longer cells.
        cells = int(np.ceil((far - edges[-1]) / (_BEHIND * period)))
        edges = np.append(edges, np.linspace(edges[-1], far, cells + 1)[1:])
    point, weight = legendre.leggauss(_ORDER)
    width = np.diff(edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    z = (middle[:, None] + 0.5 * width[:, None] * point).ravel()
    measure = (0.5 * width[:, None] * weight).ravel()
    # Phase per depth, out and back: 4 pi f n_g / c_0, as in optics.
    wavenumber = 2 * frame.medium.group_index * frame.phase_per_path
    at_edge = _light(frame, edges[: count + 1], shape)
    integrand = Integrand(
        frame=frame,
        shape=shape,
        depth=z,
        measure=measure,
        phasor=np.exp(1j * wavenumber * z[:, None]),
        count=count,
        light=_light(frame, z, shape),
    )
    # Strength: open water at frequency 0 in the middle of the scan.
    unmodulated = integrand.unmodulated
    strength = float(frame.directions.centre @ unmodulated)
    if strength < SMALLEST_STRENGTH:
        raise unseen_beam()
    basis = _components(integrand.light)
    per_strength = basis.T / strength
    slope = (per_strength @ at_edge)[..., None] * np.exp(
        1j * wavenumber * edges[: count + 1, None]
    )
    return Table(
        step=step,
        value=integrand.integrated((per_strength @ integrand.light * measure)[None])[0],
        slope=np.pad(slope, ((0, 0), (0, 1), (0, 0))),
        basis=basis,
        level=per_strength @ unmodulated,
        strength=strength,
        differentiated=partial(integrand.changes, strength),
    )


def _light(frame: Frame, depth: Floats, shape: Shape) -> Floats:
    """Return the overlap with its correction, (direction, depth) [sr]."""
    factor = np.exp(shape.correction @ hats(depth, shape.knots))
    light: Floats = frame.overlap(depth, shape) * factor
    # Subnormal numbers make every product slow.
    light[light < _NEGLIGIBLE * light.max()] = 0.0
    return light


def _light_changes(frame: Frame, depth: Floats, shape: Shape, light: Floats) -> Floats:
    """Return derivatives of the light by the shape, (parameter, direction, depth)."""
    changes = [-2 * shape.reduced_attenuation * depth * light]
    # First the terms with the same series of scattered light.
    for parameter in reversed(range(1, COEFFICIENTS + len(shape.turn))):
        step = np.zeros(shape.size)
        step[parameter] = _SMALL
        after = _light(frame, depth, shape.moved(step))
        changes.insert(1, (after - light) / _SMALL)
    return np.stack([*changes, *(light * row for row in hats(depth, shape.knots))])


def _components(light: Floats, derivatives: Floats | tuple[()] = ()) -> Floats:
    """Return the principal components of the profiles over the nodes."""
    blocks = [light, *derivatives]
    gram = np.zeros((light.shape[0], light.shape[0]))
    for block in blocks:
        size = np.max(np.abs(block))
        if size > 0:
            part = block[:, ::_ORDER] / size
            gram += part @ part.T
    values, vectors = np.linalg.eigh(gram)
    significant = values > _SMALLEST_COMPONENT**2 * values[-1]
    components: Floats = np.ascontiguousarray(vectors[:, significant])
    return components
