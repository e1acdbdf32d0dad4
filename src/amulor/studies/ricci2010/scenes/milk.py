"""Milky tank water: water and plate signals by quadrature and photon transport."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.laguerre import laggauss
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics.phase_functions import mie
from amulor.optics.phase_functions.tables import tabulated
from amulor.optics.polarization.mueller import diagonal, particles
from amulor.optics.polarization.stokes import pair_states, state
from amulor.optics.water.molecular_scattering import (
    DEPOLARIZATION_RATIO,
    molecular_phase_function,
    molecular_scattering,
)
from amulor.studies.ricci2010.study import Study
from amulor.transport import (
    GaussianReceiver,
    Medium,
    MeshTarget,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    simulate,
)

Array = NDArray[np.float64]

#: Length of a scanned line [m], and its pixels.
LINE, PIXELS = 0.10, 80
#: Angles of the scattering matrices: half a degree, where a lobe is tens wide [rad].
ANGLES = np.linspace(0.0, np.pi, 721)
#: Temperature of the tank; 10 degrees move the scattering of water by 3 % [degC].
TEMPERATURE = 20.0
#: Index of casein at 405 nm (Frisvad et al. 2007) [1].
CASEIN_INDEX = 1.503
#: Where the walls of the tank begin, beside laser and receiver [m].
WALL_START = 0.03


@dataclass(frozen=True, eq=False)
class Milk:
    """Phase function and Mueller matrix of milk particles, at `ANGLES`."""

    value: Array
    """Phase function, shape (angles,) [1/sr]."""
    matrix: Array
    """Reduced Mueller matrix, shape (angles, 4, 4) [1]."""


@dataclass(frozen=True, eq=False)
class Bench:
    """Positions of laser, receiver and plate in the tank, as (right, down, forward)."""

    laser: Array
    """Start of the beam, shape (3,) [m]."""
    receiver: GaussianReceiver
    """Fixed receiver, aimed at the middle of the line."""
    distance: float
    """Forward coordinate of the plate [m]."""

    def beam(self, place: ArrayLike) -> Array:
        """Return beam directions to points on the scanned line, shape (..., 3)."""
        x = np.asarray(place, dtype=np.float64)
        end = np.stack([x, 0 * x, np.full_like(x, self.distance)], axis=-1)
        way = end - self.laser
        unit: Array = way / np.linalg.norm(way, axis=-1, keepdims=True)
        return unit


def bench(study: Study) -> Bench:
    """Return the positions of laser, receiver and plate in the short tank."""
    baseline, distance = study["short_baseline"], study["short_distance"]
    fraction = study["plate_normal"]
    laser = np.array([-fraction * baseline, 0.0, 0.0])
    centre = laser + np.array([baseline, 0.0, 0.0])
    receiver = GaussianReceiver(
        radius=study["receiver_radius"],
        acceptance_angle=study["acceptance"],
        position=centre,
        direction=np.array([0.0, 0.0, distance]) - centre,
    )
    return Bench(laser, receiver, distance)


def places(count: int = PIXELS) -> Array:
    """Return pixel positions on the plate, to the right of its middle [m]."""
    return np.linspace(-LINE / 2, LINE / 2, count)


def milk(study: Study) -> Milk:
    """Return phase function and Mueller matrix of milk particles."""
    share = study["casein_share"]
    main = _spheres(study, study["milk_diameter"], study["milk_index"])
    if share == 0:
        return Milk(main.value, main.mueller(ANGLES))
    casein = _spheres(study, study["casein_diameter"], CASEIN_INDEX)
    parts = ((1 - share, main), (share, casein))
    value = sum((f * spheres.value for f, spheres in parts), np.zeros(ANGLES.size))
    matrix = sum(
        (
            (f * spheres.value / value)[:, None, None] * spheres.mueller(ANGLES)
            for f, spheres in parts
        ),
        np.zeros((ANGLES.size, 4, 4)),
    )
    return Milk(value, matrix)


def _spheres(study: Study, diameter: float, index: float) -> mie.Suspension:
    """Return Mie scattering of spheres with a mean diameter, in arbitrary units."""
    spread = np.sqrt(np.log1p(study["milk_spread"] ** 2))
    step = np.linspace(-3.5, 3.5, 71)
    number = np.exp(-0.5 * step**2)
    size = np.exp(spread * step)
    size *= diameter * (number @ size**2) / (number @ size**3)
    return mie.size_distribution(
        size,
        number=number * 1e15,
        wavelength=study["wavelength"],
        particle_index=index,
        medium_index=study["index"],
        angle=ANGLES,
    )


def medium(study: Study, attenuation: float) -> Medium:
    """Return tap water with milk for a given attenuation coefficient.

    The matrix of anisotropic molecules is that of J. E. Hansen and L. D. Travis,
    Space Sci. Rev. 16, 527 (1974), eqs. (2.15) and (2.16). Milk absorbs less than a
    hundredth of what it scatters.
    """
    tap = study["attenuation_tap"]
    if not attenuation >= tap:
        raise ValueError(
            f"the attenuation must be at least that of tap water, {tap:g} 1/m, got "
            f"{attenuation:g} 1/m"
        )
    spheres = study.once(milk)
    molecules = float(
        molecular_scattering(study["wavelength"], temperature=TEMPERATURE, salinity=0.0)
    )
    added = attenuation - tap
    fraction = added / (added + molecules)
    of_water = (1 - fraction) * molecular_phase_function(ANGLES)
    of_milk = fraction * spheres.value
    value = of_water + of_milk
    matrix = (
        of_water[:, None, None] * water_matrix(ANGLES)
        + of_milk[:, None, None] * spheres.matrix
    ) / value[:, None, None]
    return Medium.homogeneous(
        absorption=tap - molecules,
        scattering=molecules + added,
        phase_function=ScatteringMatrix.tabulated(
            ANGLES,
            mueller=matrix,
            phase_function=tabulated(ANGLES, value=value, name="milk in tap water"),
        ),
        group_index=study["index"],
    )


def water_matrix(angle: ArrayLike) -> Array:
    """Return the reduced Mueller matrix of pure water, shape (..., 4, 4)."""
    cosine = np.cos(np.asarray(angle, dtype=np.float64))
    delta = DEPOLARIZATION_RATIO
    ordered = (1 - delta) / (1 + delta / 2)
    intensity = 0.75 * ordered * (1 + cosine**2) + 1 - ordered
    return particles(
        m12=-0.75 * ordered * (1 - cosine**2) / intensity,
        m22=0.75 * ordered * (1 + cosine**2) / intensity,
        m33=1.5 * ordered * cosine / intensity,
        m34=0.0,
        m44=1.5 * ordered * (1 - 2 * delta) / (1 - delta) * cosine / intensity,
    )


def walls(study: Study) -> MeshTarget:
    """Return the four side walls of the tank along the beam, as a mesh."""
    half = study["tank_width"] / 2
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    ends = (WALL_START, study["short_distance"])
    vertices = [(x, y, z) for z in ends for x, y in corners]
    sides = [(i, (i + 1) % 4) for i in range(4)]
    faces = [face for i, j in sides for face in ((i, j, j + 4), (i, j + 4, i + 4))]
    return MeshTarget(
        vertices=vertices, faces=faces, reflectance=study["wall_reflectance"]
    )


def plate(study: Study) -> Array:
    """Return the Mueller matrix of the painted plate, shape (4, 4)."""
    m22 = study["m22_target"]
    return diagonal(m22, -m22, study["m44_target"])


Complex = NDArray[np.complex128]

#: Radius of the receiver that sees what is scattered on the way to or from the plate,
#: over that of the true one, for less noise. The share of such light comes out 4 % too
#: high by that (18 % with 4 times the radius, at the turbidity of panel c), the echo by
#: some 1 %.
WIDER = 2.0


@dataclass(frozen=True, eq=False)
class LineLight:
    """Ratio of received to launched light along a line, for one polarizer pair."""

    water: Complex
    """Light scattered by water only, shape (pixels,) [1]."""
    target: Complex
    """Light reflected by the plate, shape (pixels,) [1]."""
    batches: Complex
    """Deviation of each Monte Carlo batch, shape (batches, pixels) [1]."""

    @property
    def signal(self) -> Complex:
        """Sum of water and plate light, shape (pixels,) [1]."""
        return self.water + self.target

    @property
    def phase_batches(self) -> Array:
        """Phase deviation of each Monte Carlo batch, shape (batches, pixels) [rad]."""
        deviation: Array = (self.batches / self.signal).imag
        return deviation


def scattered_more(
    study: Study, water: Medium, place: Array, *, histories: int, plate_there: bool
) -> dict[str, Complex]:
    """Simulate multiple scattering in the water by polarized Monte Carlo."""
    target = _plate(study) if plate_there else None
    return _traced(study, water, place, histories, water_parts, target=target)


def reflected_and_scattered(
    study: Study, water: Medium, place: Array, *, histories: int
) -> dict[str, Complex]:
    """Simulate light both reflected by the plate and scattered, by Monte Carlo."""
    traced = _traced(
        study, water, place, histories, plate_parts, target=_plate(study), wider=WIDER
    )
    wide = reflected_at_once(study, water, place, wider=WIDER)
    true = reflected_at_once(study, water, place)
    return {
        pair: light * (true[pair] / wide[pair])[:, None]
        for pair, light in traced.items()
    }


def returned_by_walls(
    study: Study, water: Medium, place: Array, *, histories: int
) -> dict[str, Complex]:
    """Simulate light received via the tank walls, by Monte Carlo."""
    return _traced(study, water, place, histories, plate_parts, target=walls(study))


def _plate(study: Study) -> PlaneTarget:
    """Return the plate as a target of photon transport."""
    return PlaneTarget(
        position=(0.0, 0.0, study.once(bench).distance),
        reflectance=study["plate_reflectance"],
        mueller=plate(study),
    )


def _traced(
    study: Study,
    water: Medium,
    place: Array,
    histories: int,
    parts: Callable[[str], bool],
    *,
    target: PlaneTarget | MeshTarget | None,
    wider: float = 1.0,
) -> dict[str, Complex]:
    """Return selected parts of the light by Monte Carlo, shape (position, batch)."""
    table = study.once(bench)
    result: dict[str, list[Complex]] = {pair: [] for pair in PAIRS}
    for launched in "VR":
        for direction in table.beam(place):
            tally = simulate(
                water,
                Source(
                    position=table.laser, direction=direction, polarization=launched
                ),
                widened(table.receiver, wider),
                [study["frequency"]],
                histories=histories,
                seed=study.seed,
                target=target,
            )
            chosen = [k for k, name in enumerate(tally.parts) if parts(name)]
            stokes = tally.batches[..., 0][:, chosen].sum(axis=1)
            for pair in (pair for pair in PAIRS if pair[0] == launched):
                result[pair].append(stokes @ (0.5 * state(pair_states(pair)[1])))
    return {pair: np.array(light) for pair, light in result.items()}


def water_parts(name: str) -> bool:
    """Return whether a tally part is multiply scattered water light."""
    return name.startswith("water") and name != "water, order 1"


def plate_parts(name: str) -> bool:
    """Return whether a tally part is light both reflected and scattered."""
    return name == "target, scattered"


def line_light(study: Study, attenuation: float) -> dict[str, LineLight]:
    """Return the light along a line over the plate, for all polarizer pairs.

    The Monte Carlo runs at Chebyshev's places, three of them if quick and five if not,
    and is joined by a parabola. What it adds varies slower along the line than the
    light scattered once, which is known at each pixel.
    """
    water = medium(study, attenuation)
    pixels = places()
    once = _once(study, water, until=study["short_distance"])
    direct = reflected_at_once(study, water, pixels)
    nodes, join = _nodes(study)
    histories = 8_192 if study.quick else 98_304
    if attenuation <= study["attenuation_tap"]:
        histories //= 2  # little is scattered there
    multiple = scattered_more(
        study, water, nodes, histories=histories // 4, plate_there=True
    )
    spread = reflected_and_scattered(study, water, nodes, histories=histories)
    if study["wall_reflectance"] > 0:
        sides = returned_by_walls(study, water, nodes, histories=histories // 4)
        # As many batches as of the water: both have as many paths.
        multiple = {pair: multiple[pair] + sides[pair] for pair in PAIRS}
    lines = {}
    for pair in PAIRS:
        by_batch = join @ (multiple[pair] + spread[pair])
        lines[pair] = LineLight(
            water=once[pair] + join @ multiple[pair].mean(axis=1),
            target=direct[pair] + join @ spread[pair].mean(axis=1),
            batches=(by_batch - by_batch.mean(axis=1, keepdims=True)).T,
        )
    return lines


def open_water(study: Study, attenuation: float) -> dict[str, Complex]:
    """Return the light along the line in open water, for all polarizer pairs."""
    water = medium(study, attenuation)
    nodes, join = _nodes(study)
    histories = 2_048 if study.quick else 32_768
    multiple = scattered_more(
        study, water, nodes, histories=histories, plate_there=False
    )
    # Light from beyond 40 m is below 1e-4 of the rest.
    once = _once(study, water, until=40.0)
    return {pair: once[pair] + join @ multiple[pair].mean(axis=1) for pair in PAIRS}


def _nodes(study: Study) -> tuple[Array, Array]:
    """Return the Monte Carlo positions [m], and their interpolation to all pixels."""
    nodes = chebyshev.chebpts2(3 if study.quick else 5)
    return nodes * LINE / 2, interpolation(nodes, places() / (LINE / 2), degree=2)


def _once(study: Study, water: Medium, *, until: float) -> dict[str, Complex]:
    """Return the singly scattered light at all pixels, interpolated from 11 points."""
    nodes = chebyshev.chebpts2(11)
    join = interpolation(nodes, places() / (LINE / 2), degree=10)
    light = scattered_once(study, water, nodes * LINE / 2, until=until)
    return {pair: join @ light[pair] for pair in PAIRS}


#: Launched and analysed states of figures 10 to 12.
PAIRS = ("VV", "VH", "RL", "RR")


def scattered_once(
    study: Study, water: Medium, place: Array, *, until: float
) -> dict[str, Complex]:
    """Return the light scattered once in the water, by quadrature.

    The frame is not turned on the way back: within the acceptance that changes what
    passes a crossed analyser by 1e-5 of what passes the parallel one.
    """
    node, weight = leggauss(120)
    low, high = np.log(1e-3), np.log(until)
    depth = np.exp(0.5 * (high + low) + 0.5 * (high - low) * node)
    step = 0.5 * (high - low) * weight * depth
    beam = study.once(bench).beam(place)[:, None, :]
    slant = depth[:, None] / beam[..., 2:]
    point = study.once(bench).laser + slant * beam
    back, solid_angle, way = _face(study.once(bench).receiver, point)
    cosine = np.sum(back * beam[..., None, :], axis=-1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    layer = water.layers[0]
    matrix = layer.phase_function
    assert isinstance(matrix, ScatteringMatrix)
    light = (
        layer.scattering
        * matrix.phase_function(angle)
        * solid_angle
        * _phasor(study, water, slant + way)
        * (step[:, None] / beam[..., 2:])
    )
    elements = matrix.elements_at(angle)
    m22, m44 = elements[..., 1], elements[..., 4]
    fraction = {
        "VV": (1 + m22) / 2,
        "VH": (1 - m22) / 2,
        "RL": (1 - m44) / 2,
        "RR": (1 + m44) / 2,
    }
    return {pair: np.sum(light * fraction[pair], axis=(1, 2)) for pair in PAIRS}


def reflected_at_once(
    study: Study, water: Medium, place: Array, *, wider: float = 1.0
) -> dict[str, Complex]:
    """Return the unscattered light reflected by the plate, by quadrature."""
    table = study.once(bench)
    receiver = widened(table.receiver, wider)
    point = np.stack([place, 0 * place, np.full_like(place, table.distance)], axis=-1)
    back, solid_angle, way = _face(receiver, point)
    slant = np.linalg.norm(point - table.laser, axis=-1)[:, None]
    light = np.sum(
        study["plate_reflectance"]
        / np.pi
        * -back[..., 2]
        * solid_angle
        * _phasor(study, water, slant + way),
        axis=-1,
    )
    matrix = plate(study)
    return {pair: light * _passed(matrix, pair) for pair in PAIRS}


def interpolation(nodes: Array, at: Array, *, degree: int) -> Array:
    """Return the matrix of polynomial interpolation from nodes to pixels."""
    fit = np.linalg.pinv(chebyshev.chebvander(nodes, degree))
    matrix: Array = chebyshev.chebvander(at, degree) @ fit
    return matrix


def _passed(matrix: Array, pair: str) -> float:
    """Return the fraction of reflected light transmitted by a polarizer pair."""
    launched, analysed = pair_states(pair)
    return float(0.5 * state(analysed) @ matrix @ state(launched))


def _phasor(study: Study, water: Medium, way: Array) -> Complex:
    """Return attenuation and phase delay over water paths, as a phasor."""
    wave = 2 * np.pi * study["frequency"] * water.group_index / speed_of_light
    phasor: Complex = np.exp((1j * wave - water.layers[0].attenuation) * way)
    return phasor


def _face(receiver: GaussianReceiver, point: Array) -> tuple[Array, Array, Array]:
    """Return directions, weighted solid angles and distances to parts of the receiver.

    Directions to the parts, shape (..., parts, 3), their areas over squared distance
    weighted by what the receiver takes from there [sr], and distances [m]. For each
    point the parts lie where the product of both Gaussians of the receiver is.
    """
    axis = np.asarray(receiver.direction, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    down = np.array([0.0, 1.0, 0.0])
    frame = np.stack([np.cross(down, axis), down, axis])
    right, below, depth = np.moveaxis(
        (point - np.asarray(receiver.position)) @ frame.T, -1, 0
    )
    # What is behind the face is not seen.
    before = np.where(depth > 0, depth, np.inf)
    angular = (receiver.acceptance_angle * before) ** 2
    fraction = 1 / (1 + angular / receiver.radius**2)
    fraction, angular = (np.where(depth > 0, x, 1.0) for x in (fraction, angular))
    width = np.sqrt(fraction * angular)
    square, weight = (np.repeat(x, 6) for x in laggauss(3))
    azimuth = np.tile(2 * np.pi * np.arange(6) / 6, 3)
    step = width[..., None] * np.sqrt(square)
    along = (fraction * right)[..., None] + step * np.cos(azimuth)
    across = (fraction * below)[..., None] + step * np.sin(azimuth)
    part = (
        along[..., None] * frame[0]
        + across[..., None] * frame[1]
        + np.asarray(receiver.position)
    )
    way = part - point[..., None, :]
    distance = np.linalg.norm(way, axis=-1)
    way = way / distance[..., None]
    cosine = -way @ axis
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    exponent = (
        square
        - (along**2 + across**2) / receiver.radius**2
        - (angle / receiver.acceptance_angle) ** 2
    )
    solid_angle = np.exp(exponent) * np.maximum(cosine, 0.0) / distance**2
    return way, np.pi * width[..., None] ** 2 * weight / 6 * solid_angle, distance


def widened(receiver: GaussianReceiver, factor: float) -> GaussianReceiver:
    """Return the receiver with an enlarged face."""
    return replace(receiver, radius=factor * receiver.radius)
