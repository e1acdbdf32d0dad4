"""Tables of the water signal against its end, for every direction of a scan."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.errors import CubeError
from amulor.optics import rays, small_angle_diffusion
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint.shape import COEFFICIENTS, Shape, hats
from amulor.rejection.joint.table import Table
from amulor.survey import Survey, water_properties
from amulor.survey.view import kernel_arguments, medium, view

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Nodes of depth within one period of the highest frequency, out and back.
_NODES_PER_PERIOD = 20
#: More would not be a scan but a mistake in the interval.
_MOST_NODES = 6000
#: What the interpolation over the scan may miss, of the largest overlap [1].
_INTERPOLATION = 1e-4
_DEGREES = (2, 4, 6, 8, 10)
#: Components of the dependence on the direction are left out below this [1].
_SMALLEST_COMPONENT = 1e-5
#: Depths behind which less than this fraction of the water signal is left [1].
_NOTHING_LEFT = 1e-7
_ORDER = 4
#: Directions of the receiver whose arguments are kept.
_KEPT = 8
#: Length of a cell behind the last target, in periods of the highest frequency [1].
_BEHIND = 0.3


class Frame:
    """How the receiver looks at a scan: what tables of the water signal need.

    Parameters
    ----------
    survey : Survey
        Receiver and scan count, and the end of the water; the optical properties of
        the water do not, but for its indices.
    azimuth, elevation : ndarray
        Directions that will be asked for, of any shape [rad].
    modulation_frequency : ndarray
        Modulation frequencies [Hz].
    """

    def __init__(
        self,
        survey: Survey,
        azimuth: Floats,
        elevation: Floats,
        *,
        modulation_frequency: Floats,
    ) -> None:
        properties = water_properties(survey)
        self.survey = survey
        self.medium = medium(survey, properties)
        #: Phase per optical path, 2 pi f / c_0 [rad/m].
        self.phase_per_path = 2 * np.pi * modulation_frequency / speed_of_light
        end = survey.water.column_end
        self.end = np.inf if end is None else end
        self._properties = properties
        self._frequency = modulation_frequency
        self._turned: dict[tuple[float, ...], dict[str, Any]] = {}
        self._box = [
            (float(np.min(values)), float(np.max(values)))
            for values in (azimuth, elevation)
        ]
        self._choose_degree()

    def _choose_degree(self) -> None:
        """Take the lowest degree over the scan that follows the overlap."""
        shape = Shape(0.3, 0.02, 0.4, np.zeros(0), np.zeros(0))
        depth = np.linspace(0.02, 12.0, 240)
        inner = np.array([-0.83, -0.31, 0.12, 0.57, 0.94])
        at = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
        test = [
            0.5 * (low + high) + 0.5 * (high - low) * at[:, axis]
            for axis, (low, high) in enumerate(self._box)
        ]
        exact = self._overlap(depth, shape, self._arguments(test[0], test[1]))
        for degree in _DEGREES:
            axes = []
            for low, high in self._box:
                count = degree + 1 if high - low > 1e-9 else 1
                node = np.cos(np.pi * (np.arange(count) + 0.5) / count)
                axes.append(0.5 * (low + high) + 0.5 * (high - low) * node)
            self._axes = axes
            both = np.meshgrid(*axes, indexing="ij")
            self._nodes = self._arguments(both[0].ravel(), both[1].ravel())
            nodes = self._overlap(depth, shape, self._nodes)
            error = self.interpolation(*test) @ nodes - exact
            if np.max(np.abs(error)) <= _INTERPOLATION * np.max(exact):
                return
        raise CubeError(
            "the water signal changes too quickly over the scan to be tabulated; "
            "split the scan into smaller ones"
        )

    def _nodes_of(self, shape: Shape) -> dict[str, Any]:
        """Return the arguments at the nodes for a receiver turned as a shape says."""
        if not np.any(shape.turn):
            return self._nodes
        turn = tuple(float(value) for value in shape.turn)
        if turn not in self._turned:
            if len(self._turned) >= _KEPT:
                self._turned.clear()
            instrument = self.survey.instrument
            receiver = instrument.receiver.model_copy(
                update={
                    "azimuth": instrument.receiver.azimuth + turn[0],
                    "elevation": instrument.receiver.elevation + turn[1],
                }
            )
            turned = self.survey.model_copy(
                update={
                    "instrument": instrument.model_copy(update={"receiver": receiver})
                }
            )
            both = np.meshgrid(*self._axes, indexing="ij")
            self._turned[turn] = self._arguments(
                both[0].ravel(), both[1].ravel(), turned
            )
        return self._turned[turn]

    def _arguments(
        self, azimuth: Floats, elevation: Floats, survey: Survey | None = None
    ) -> dict[str, Any]:
        """Return the arguments of the overlap, without those of the water."""
        survey = self.survey if survey is None else survey
        where = view(survey, azimuth, elevation, medium=self.medium)
        arguments = kernel_arguments(survey, self._properties, where)
        for name in (
            "absorption",
            "forward_scattering",
            "diffuse_scattering",
            "second_moment",
        ):
            del arguments[name]
        return arguments

    def interpolation(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return how the nodes of the scan make up given directions.

        Parameters
        ----------
        azimuth, elevation : ndarray, shape (n,)
            Directions [rad].

        Returns
        -------
        ndarray, shape (n, nodes)
            Lagrange polynomials over azimuth and elevation [1].
        """
        parts = []
        for node, place in zip(self._axes, (azimuth, elevation), strict=True):
            part = np.ones((len(place), len(node)))
            for j in range(len(node)):
                for k in range(len(node)):
                    if k != j:
                        part[:, j] *= (place - node[k]) / (node[j] - node[k])
            parts.append(part)
        product: Floats = np.einsum("ni,nj->nij", *parts).reshape(len(azimuth), -1)
        return product

    def _centre(self) -> Floats:
        """Return how the nodes of the scan make up its middle, (nodes,) [1]."""
        place = (np.array([0.5 * sum(box)]) for box in self._box)
        nodes: Floats = self.interpolation(*place)[0]
        return nodes

    def optical_offset(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return the optical path before the water, out and back [m]."""
        where = view(self.survey, azimuth, elevation, medium=self.medium)
        return np.broadcast_to(where.optical_offset, azimuth.shape)

    def beam(self, azimuth: Floats, elevation: Floats) -> rays.Beam:
        """Return the beams of given directions."""
        return rays.enter_water(
            self.survey.instrument.emitter.position,
            rays.direction(azimuth, elevation),
            medium=self.medium,
        )

    @property
    def receiver(self) -> Floats:
        """Where the light is collected [m]."""
        return np.asarray(self.survey.instrument.receiver.position, dtype=float)

    def _overlap(self, depth: Floats, shape: Shape, where: dict[str, Any]) -> Floats:
        """Return the overlap of (direction, depth), without the correction.

        (43) of Ricci et al. 2010, as rebuilt, for the light that was scattered and
        again, without spread, for the light that was not; together they have the
        spread of the model. Scattering without bounds leaves (43) itself.
        """
        straight = np.exp(-2 * shape.forward_scattering * depth)
        # The smallest number keeps the start of the water in range.
        bent = np.maximum(1 - straight, np.finfo(float).tiny)
        geometry = {name: np.asarray(v)[..., None] for name, v in where.items()}
        common = {"absorption": shape.reduced_attenuation, "diffuse_scattering": 0.0}

        def overlap(spread: Floats | float) -> Floats:
            return small_angle_diffusion.overlap(
                depth[None, :],
                forward_scattering=spread,
                second_moment=1.0,
                **common,
                **geometry,
            )

        spread = np.where(depth > 0, shape.spread / bent, 0.0)
        light: Floats = straight * overlap(0.0) + bent * overlap(spread)
        return light

    def nothing_left(self, shape: Shape) -> float:
        """Return the depth that all but a trace of the water signal comes from [m]."""
        depth = np.geomspace(1e-2, 2e3, 1500)
        light = self._overlap(depth, shape, self._nodes_of(shape)).max(axis=0)
        left = np.cumsum((light * depth)[::-1])[::-1]
        if left[0] < _SMALLEST_STRENGTH:
            raise _unseen()
        return float(depth[np.argmax(left <= _NOTHING_LEFT * left[0])])

    def quantiles(self, shape: Shape, fraction: Floats) -> Floats:
        """Return the depths in front of which given fractions of the light arise."""
        depth = np.linspace(0, min(self.nothing_left(shape), self.end), 4000)
        light = self._overlap(depth, shape, self._nodes_of(shape)).mean(axis=0)
        total = np.cumsum(light)
        return np.asarray(np.interp(fraction, total / total[-1], depth))

    def middle(self, depth: Floats, shape: Shape) -> Floats:
        """Return the overlap in the middle of the scan, with the correction [sr]."""
        centre = self.interpolation(*(np.array([0.5 * sum(box)]) for box in self._box))[
            0
        ]
        factor = np.exp(shape.correction @ hats(depth, shape.knots))
        overlap: Floats = (
            centre @ self._overlap(depth, shape, self._nodes_of(shape)) * factor
        )
        return overlap

    def table(self, shape: Shape, *, deepest: float, derivatives: bool = True) -> Table:
        """Integrate the water signal up to every depth.

        Parameters
        ----------
        shape : Shape
            Shape of the water signal.
        deepest : float
            Depth beyond which no target stands [m].
        derivatives : bool
            Whether to add those with respect to the shape.

        Returns
        -------
        Table
            The last node stands for open water.

        Notes
        -----
        (46) of Ricci et al. 2010, as rebuilt and conjugated, by Gauss's rule with
        four points between neighbouring nodes.
        """
        period = 2 * np.pi / self.phase_per_path.max() / (2 * self.medium.group_index)
        far = min(self.nothing_left(shape), self.end)
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
            more = int(np.ceil((far - edges[-1]) / (_BEHIND * period)))
            edges = np.append(edges, np.linspace(edges[-1], far, more + 1)[1:])
        point, weight = legendre.leggauss(_ORDER)
        width = np.diff(edges)
        middle = 0.5 * (edges[1:] + edges[:-1])
        z = (middle[:, None] + 0.5 * width[:, None] * point).ravel()
        measure = (0.5 * width[:, None] * weight).ravel()
        profile = self._profiles(z, shape, derivatives=derivatives)
        at_edge = self._profiles(edges, shape, derivatives=False)[0]
        component = _components(profile[0], profile[1:])
        # Phase per depth, out and back: 4 pi f n_g / c_0, as in optics.
        wavenumber = 2 * self.medium.group_index * self.phase_per_path
        phasor = np.exp(1j * wavenumber * z[:, None])
        parameters, size = len(profile), component.shape[1]
        total = np.empty((parameters, size, count + 2, wavenumber.size), dtype=complex)
        reduced = np.ascontiguousarray(component.T @ profile * measure)
        kernels.integrate(reduced, phasor, _ORDER, count, total)
        slope = np.zeros_like(total[0])
        slope[:, : count + 1] = (component.T @ at_edge)[:, : count + 1, None] * np.exp(
            1j * wavenumber * edges[: count + 1, None]
        )
        # Strength: open water at frequency 0 in the middle of the scan.
        centre = self.interpolation(*(np.array([0.5 * sum(box)]) for box in self._box))[
            0
        ]
        at_zero = (centre @ profile) @ measure
        strength = float(at_zero[0])
        if strength < _SMALLEST_STRENGTH:
            raise _unseen()
        change = total[1:] / strength - (
            total[0] * (at_zero[1:] / strength**2)[:, None, None, None]
        )
        level = component.T @ (profile[0] @ measure) / strength
        return Table(
            step=step,
            value=total[0] / strength,
            slope=slope / strength,
            change=change,
            basis=component,
            level=level,
            strength=strength,
        )

    def _profiles(self, depth: Floats, shape: Shape, *, derivatives: bool) -> Floats:
        """Return the overlap and its derivatives, (parameter, direction, depth)."""
        hat = hats(depth, shape.knots)
        factor = np.exp(shape.correction @ hat)

        def light(of: Shape) -> Floats:
            overlap: Floats = self._overlap(depth, of, self._nodes_of(of)) * factor
            # Subnormal numbers make every product below slow.
            overlap[overlap < _NEGLIGIBLE * overlap.max()] = 0.0
            return overlap

        base = light(shape)
        if not derivatives:
            return base[None]
        changes = [-2 * shape.reduced_attenuation * depth * base]
        for parameter in range(1, COEFFICIENTS + len(shape.turn)):
            step = np.zeros(shape.size)
            step[parameter] = _SMALL
            changes.append((light(shape.moved(step)) - base) / _SMALL)
        return np.stack([base, *changes, *(base * row for row in hat)])


#: A receiver that takes in less than this sees no beam [sr m].
_SMALLEST_STRENGTH = 1e-100


def _unseen() -> CubeError:
    return CubeError(
        "the receiver does not see the beam at any depth, so there is no water "
        "signal to estimate; check position and axis of the receiver in the survey of "
        "the cube, or reject nothing (keep_water)"
    )


#: Fraction of the largest overlap that counts as zero [1].
_NEGLIGIBLE = 1e-30
#: Step of the logarithm of a coefficient for a derivative: what a one-sided one errs
#: by and what rounding leaves of it are both far below what a step of the fit needs.
_SMALL = 1e-5


def _components(light: Floats, derivatives: Floats) -> Floats:
    """Return the directions in the space of the nodes that the profiles fill."""
    blocks = [light, *derivatives]
    gram = np.zeros((light.shape[0], light.shape[0]))
    for block in blocks:
        size = np.max(np.abs(block))
        if size > 0:
            part = block[:, ::_ORDER] / size
            gram += part @ part.T
    values, vectors = np.linalg.eigh(gram)
    kept = values > _SMALLEST_COMPONENT**2 * values[-1]
    components: Floats = np.ascontiguousarray(vectors[:, kept])
    return components


def frame_of(cube: xr.Dataset, azimuth: Floats, elevation: Floats) -> Frame:
    """Return the frame of a cube whose survey describes the receiver.

    Parameters
    ----------
    cube : xarray.Dataset
        With the attribute `survey`.
    azimuth, elevation : ndarray
        Directions that will be asked for [rad].

    Returns
    -------
    Frame
        What tables of the water signal need.

    Raises
    ------
    CubeError
        If the cube has no survey.
    """
    text = cube.attrs.get("survey")
    if not text:
        raise CubeError(
            "the cube has no attribute 'survey', from which the geometry of the "
            "receiver is taken; add the text of a survey file that describes the "
            "instrument, or use the open-water method"
        )
    survey = Survey.from_text(text, name="survey in the cube")
    return Frame(
        survey,
        azimuth,
        elevation,
        modulation_frequency=cube["modulation_frequency"].values,
    )
