"""Tables of the water signal against the end depth of the water, by direction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
    change: Complex
    """Derivatives by the shape parameters, along an additional axis [1]."""
    basis: Floats
    """Coefficients of the components in each direction, (direction, component) [1]."""
    level: Floats
    """Unmodulated open-water signal by component; 1 in the middle of the scan [1]."""
    strength: float
    """Ratio of received to launched power for strength 1, per backscatter [sr m]."""

    @cached_property
    def arrays(self) -> WaterTable:
        """Table of the water signal as an argument of the compiled loops."""
        return WaterTable(self.step, to_pairs(self.value), to_pairs(self.slope))


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


def table_of(
    frame: Frame, shape: Shape, *, deepest: float, derivatives: bool = True
) -> Table:
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
    # First the terms with the same series of scattered light.
    at_edge = _profiles(frame, edges, shape, derivatives=False)[0]
    profile = _profiles(frame, z, shape, derivatives=derivatives)
    component = _components(profile[0], profile[1:])
    # Phase per depth, out and back: 4 pi f n_g / c_0, as in optics.
    wavenumber = 2 * frame.medium.group_index * frame.phase_per_path
    phasor = np.exp(1j * wavenumber * z[:, None])
    # Strength: open water at frequency 0 in the middle of the scan.
    at_zero = (frame.directions.centre @ profile) @ measure
    strength = float(at_zero[0])
    if strength < SMALLEST_STRENGTH:
        raise unseen_beam()
    # Values over the strength, and what they change by: taken before the sums, whose
    # tables are large.
    reduced = component.T @ profile * (measure / strength)
    reduced[1:] -= reduced[0] * (at_zero[1:] / strength)[:, None, None]
    parameters, size = reduced.shape[:2]
    total = np.empty((parameters, size, count + 2, wavenumber.size), dtype=complex)
    kernels.integrate(reduced, phasor, _ORDER, count, total)
    slope = np.zeros_like(total[0])
    slope[:, : count + 1] = (component.T @ at_edge / strength)[
        :, : count + 1, None
    ] * np.exp(1j * wavenumber * edges[: count + 1, None])
    level = component.T @ (profile[0] @ measure) / strength
    return Table(
        step=step,
        value=total[0],
        slope=slope,
        change=total[1:],
        basis=component,
        level=level,
        strength=strength,
    )


def _profiles(
    frame: Frame, depth: Floats, shape: Shape, *, derivatives: bool
) -> Floats:
    """Return the overlap and its derivatives, (parameter, direction, depth)."""
    hat = hats(depth, shape.knots)
    factor = np.exp(shape.correction @ hat)

    def light(of: Shape) -> Floats:
        overlap: Floats = frame.overlap(depth, of) * factor
        # Subnormal numbers make every product below slow.
        overlap[overlap < _NEGLIGIBLE * overlap.max()] = 0.0
        return overlap

    base = light(shape)
    if not derivatives:
        return base[None]
    changes = [-2 * shape.reduced_attenuation * depth * base]
    last = COEFFICIENTS + len(shape.turn)
    # First the terms with the same series of scattered light.
    for parameter in reversed(range(1, last)):
        step = np.zeros(shape.size)
        step[parameter] = _SMALL
        changes.insert(1, (light(shape.moved(step)) - base) / _SMALL)
    return np.stack([base, *changes, *(base * row for row in hat)])


def _components(light: Floats, derivatives: Floats) -> Floats:
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
