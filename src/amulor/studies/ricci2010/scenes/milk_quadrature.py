"""Light of the short tank that is known without random numbers, by quadrature.

What the water scatters once and what the plate sends back without scattering in the
water are integrals over the beam and the face of the receiver.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.laguerre import laggauss
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics.polarization.stokes import pair_states, state
from amulor.studies.ricci2010.scenes.milk_tank import bench, plate
from amulor.studies.ricci2010.study import Study
from amulor.transport import GaussianReceiver, Medium, ScatteringMatrix

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Launched and analysed states of figures 10 to 12.
PAIRS = ("VV", "VH", "RL", "RR")


def scattered_once(
    study: Study, water: Medium, place: Array, *, until: float
) -> dict[str, Complex]:
    """Return the light that the water scatters once, by quadrature.

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
    back, seen, way = _face(study.once(bench).receiver, point)
    cosine = np.sum(back * beam[..., None, :], axis=-1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    layer = water.layers[0]
    matrix = layer.phase_function
    assert isinstance(matrix, ScatteringMatrix)
    light = (
        layer.scattering
        * matrix.phase_function(angle)
        * seen
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
    """Return the light that comes back from the plate unscattered, by quadrature."""
    here = study.once(bench)
    receiver = widened(here.receiver, wider)
    point = np.stack([place, 0 * place, np.full_like(place, here.distance)], axis=-1)
    back, seen, way = _face(receiver, point)
    slant = np.linalg.norm(point - here.laser, axis=-1)[:, None]
    light = np.sum(
        study["plate_reflectance"]
        / np.pi
        * -back[..., 2]
        * seen
        * _phasor(study, water, slant + way),
        axis=-1,
    )
    matrix = plate(study)
    return {pair: light * _passed(matrix, pair) for pair in PAIRS}


def interpolation(nodes: Array, at: Array, *, degree: int) -> Array:
    """Return the matrix that joins values at nodes by a polynomial."""
    fit = np.linalg.pinv(chebyshev.chebvander(nodes, degree))
    matrix: Array = chebyshev.chebvander(at, degree) @ fit
    return matrix


def _passed(matrix: Array, pair: str) -> float:
    """Return the fraction of the reflected light that passes the analyser of a pair."""
    launched, analysed = pair_states(pair)
    return float(0.5 * state(analysed) @ matrix @ state(launched))


def _phasor(study: Study, water: Medium, way: Array) -> Complex:
    """Return attenuation and delay on a way [m]."""
    wave = 2 * np.pi * study["frequency"] * water.group_index / speed_of_light
    phasor: Complex = np.exp((1j * wave - water.layers[0].attenuation) * way)
    return phasor


def _face(receiver: GaussianReceiver, point: Array) -> tuple[Array, Array, Array]:
    """Return how points see the parts of the receiver's face.

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
    seen = np.exp(exponent) * np.maximum(cosine, 0.0) / distance**2
    return way, np.pi * width[..., None] ** 2 * weight / 6 * seen, distance


def widened(receiver: GaussianReceiver, factor: float) -> GaussianReceiver:
    """Return a receiver with a larger face."""
    return replace(receiver, radius=factor * receiver.radius)
