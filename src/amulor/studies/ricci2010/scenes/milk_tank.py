"""The short tank along a scanned line: where things stand, water with milk, plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics.phase_functions import mie
from amulor.optics.phase_functions.tables import tabulated
from amulor.optics.polarization.mueller import diagonal, particles
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
    ScatteringMatrix,
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
    """What the particles of milk scatter, at `ANGLES`."""

    value: Array
    """Phase function, shape (angles,) [1/sr]."""
    matrix: Array
    """Reduced Mueller matrix, shape (angles, 4, 4) [1]."""


@dataclass(frozen=True, eq=False)
class Bench:
    """Where laser, receiver and plate of the short tank stand: right, down, forward."""

    laser: Array
    """Where the beam starts, shape (3,) [m]."""
    receiver: GaussianReceiver
    """Receiver, aimed at the middle of the line; it stands still."""
    distance: float
    """Plane of the plate, forward [m]."""

    def beam(self, place: ArrayLike) -> Array:
        """Return the direction of the beam to places on the line, shape (..., 3)."""
        x = np.asarray(place, dtype=np.float64)
        end = np.stack([x, 0 * x, np.full_like(x, self.distance)], axis=-1)
        way = end - self.laser
        unit: Array = way / np.linalg.norm(way, axis=-1, keepdims=True)
        return unit


def bench(study: Study) -> Bench:
    """Return the places of the short tank."""
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
    """Return the places of pixels on the plate, to the right of its middle [m]."""
    return np.linspace(-LINE / 2, LINE / 2, count)


def milk(study: Study) -> Milk:
    """Return what the particles of milk scatter."""
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
    """Return spheres of a volume-to-surface diameter; only ratios mean anything."""
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
    """Return tap water with as much milk as an attenuation needs.

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
    own = (1 - fraction) * molecular_phase_function(ANGLES)
    other = fraction * spheres.value
    value = own + other
    matrix = (
        own[:, None, None] * water_matrix(ANGLES)
        + other[:, None, None] * spheres.matrix
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
    """Return the reduced matrix of pure water, shape of `angle` and (4, 4)."""
    cosine = np.cos(np.asarray(angle, dtype=np.float64))
    delta = DEPOLARIZATION_RATIO
    ordered = (1 - delta) / (1 + delta / 2)
    whole = 0.75 * ordered * (1 + cosine**2) + 1 - ordered
    return particles(
        m12=-0.75 * ordered * (1 - cosine**2) / whole,
        m22=0.75 * ordered * (1 + cosine**2) / whole,
        m33=1.5 * ordered * cosine / whole,
        m34=0.0,
        m44=1.5 * ordered * (1 - 2 * delta) / (1 - delta) * cosine / whole,
    )


def walls(study: Study) -> MeshTarget:
    """Four walls of the tank along the beam, from the window to the plate."""
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
