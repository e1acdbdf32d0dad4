"""Exact fields of plane-parallel water by adding and doubling, for modulated light.

The slab fills 0 <= z <= thickness, light falls in along +z, cosines of directions are
taken to +z, and the azimuth turns from x to y. Modulated light needs nothing new: in
time, light of path L carries exp(+i omega L / v), so the attenuation c becomes
c (1 - i x) with x = omega / (v c), `modulation` here; the single-scattering albedo
becomes w / (1 - i x) and the optical thickness tau (1 - i x). All is done in complex
numbers with that replacement, and a later echo has the larger phase.

A Gauss rule in each hemisphere carries the integrals over cosines. The cosines of the
incidence and of the views are nodes of no weight, so no interpolation is left. The
kernels of a thin layer are a power series in its thickness, good to rounding; doubling
makes a slab or a half-space of it. Nothing is shared with the package.

What the scatterers are stands in an object with two members: `components`, 1 or 4, and
`modes(out, into, count)`, the Fourier modes 0 ... count - 1 in azimuth of the phase
matrix, (1 / 2 pi) times the integral of Z(out, into, phi) exp(-i m phi), of shape
(count, out * components, into * components). Z is 1 on average over all directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad

Array = NDArray[Any]

ORDER = 10  # of the series of the thin layer
THIN = (
    0.1  # optical thickness of that layer over the smallest cosine: 0.2^11 / 11! left
)


class Scatterers(Protocol):
    """What scatters: scalar, or with the whole Stokes vector."""

    components: int

    def modes(self, out: Array, into: Array, count: int) -> Array:
        """Return Fourier modes of the phase matrix between signed cosines."""


class LegendreSeries:
    """Scalar scattering; `moments` are the means of the Legendre polynomials."""

    components = 1

    def __init__(self, moments: ArrayLike) -> None:
        self.moments = np.atleast_1d(np.asarray(moments, dtype=float))
        self.orders = self.moments.size

    def modes(self, out: Array, into: Array, count: int) -> Array:
        return np.stack(
            [
                np.einsum(
                    "l,li,lj->ij",
                    (2 * np.arange(m, self.orders) + 1) * self.moments[m:],
                    _legendre(out, m, self.orders),
                    _legendre(into, m, self.orders),
                )
                for m in range(count)
            ]
        )


def henyey_greenstein(asymmetry: float) -> LegendreSeries:
    """Return Henyey-Greenstein scatterers, moments down to 1e-17."""
    last = 1 if asymmetry == 0 else 1 + int(np.log(1e-17) / np.log(abs(asymmetry)))
    return LegendreSeries(asymmetry ** np.arange(last))


def rayleigh() -> LegendreSeries:
    """Return Rayleigh scatterers for light whose polarization is left out."""
    return LegendreSeries([1.0, 0.0, 0.1])


class Layer(NamedTuple):
    """Diffuse kernels of a layer, and what goes straight through at each node."""

    reflection: Array  # of light from above, (out, into)
    transmission: Array
    reflection_up: Array  # of light from below
    transmission_up: Array
    direct: Array


@dataclass(frozen=True)
class Field:
    """Light that leaves a slab, per unit irradiance on a plane across the beam."""

    components: int
    incidence: float
    cosines: Array
    reflected: Array  # modes, views, components out, components in [1 / sr]
    transmitted: Array
    reflected_total: Array  # components out, components in; over the incident flux
    diffuse_total: Array
    direct: complex

    @property
    def transmitted_total(self) -> Array:
        """Return the whole transmitted flux, diffuse and direct."""
        return self.diffuse_total + self.direct * np.eye(self.components)

    def reflected_radiance(self, stokes: ArrayLike, *, azimuth: ArrayLike) -> Array:
        """Return radiance of shape (views, azimuths, components) for a state."""
        return _radiance(self.reflected, stokes, azimuth)

    def transmitted_radiance(self, stokes: ArrayLike, *, azimuth: ArrayLike) -> Array:
        """Return the diffuse radiance that leaves at the far side."""
        return _radiance(self.transmitted, stokes, azimuth)


def slab(
    scatterers: Scatterers,
    *,
    albedo: float,
    thickness: float,
    incidence: float = 1.0,
    modulation: float = 0.0,
    cosines: ArrayLike = (),
    orders: int = 1,
    ground: float = 0.0,
    nodes: int = 32,
) -> Field:
    """Return the field of a homogeneous slab, or half-space if thickness is inf.

    `incidence` is the cosine of the beam, which comes in at azimuth 0; `cosines` are
    those of the views, 0 to 1 for either side; `orders` is the count of Fourier modes
    that radiance needs (totals need one); `ground` is the reflectance of a Lambertian
    plane below. Q, U, V stand in the meridian frame: parallel grows with the polar
    angle to +z, perpendicular with the azimuth, and their product is the direction.
    """
    views = np.atleast_1d(np.asarray(cosines, dtype=float))
    gauss, gauss_weight = leggauss(nodes)
    mu = np.concatenate([(gauss + 1) / 2, [incidence], views])
    weight = np.concatenate([gauss_weight / 2, np.zeros(1 + views.size)])
    # Steady light stays real where its modes are: four times as fast.
    factor = 1 - 1j * modulation if modulation else 1.0
    size = scatterers.components
    reflected, transmitted = [], []
    blocks = [
        scatterers.modes(out, into, orders)
        for out, into in ((mu, mu), (-mu, mu), (mu, -mu), (-mu, -mu))
    ]
    for m in range(orders):
        down, upward, downward, up = (
            albedo / factor / 2 * (z[m] if z[m].imag.any() else z[m].real)
            for z in blocks
        )
        layer = homogeneous(
            (down, upward, downward, up),
            mu=np.repeat(mu, size),
            weight=np.repeat(weight, size),
            thickness=thickness,
            factor=factor,
        )
        if ground > 0:
            lambert = _lambert(mu, size, ground if m == 0 else 0.0)
            layer = add(layer, lambert, weight=np.repeat(weight, size))
        reflected.append(layer.reflection)
        transmitted.append(layer.transmission)
    shape = (orders, mu.size, size, mu.size, size)
    back = np.array(reflected).reshape(shape)[:, :, :, nodes, :]
    through = np.array(transmitted).reshape(shape)[:, :, :, nodes, :]
    total = [np.einsum("i,iab->ab", weight * mu, k[0]) for k in (back, through)]
    return Field(
        components=size,
        incidence=incidence,
        cosines=views,
        reflected=back[:, nodes + 1 :] / (2 * np.pi),
        transmitted=through[:, nodes + 1 :] / (2 * np.pi),
        reflected_total=total[0] / incidence,
        diffuse_total=total[1] / incidence,
        direct=complex(layer.direct[nodes * size]),
    )


def homogeneous(
    scattering: tuple[Array, Array, Array, Array],
    *,
    mu: Array,
    weight: Array,
    thickness: float,
    factor: complex = 1.0,
) -> Layer:
    """Return a layer of thickness times factor by doubling; inf: a half-space.

    `scattering` is albedo / 2 times a mode of the phase matrix, for light that goes
    down into down, down into up, up into down and up into up.
    """
    endless = np.isinf(thickness)
    whole = factor if endless else thickness * factor  # endless: from 1, then grown
    halvings = max(0, int(np.ceil(np.log2(abs(whole) / (THIN * mu.min())))))
    thin = whole / 2**halvings
    dd, ud, du, uu = (kernel / mu[:, None] for kernel in scattering)
    direct = np.exp(-thin / mu)
    down = _thin((uu, ud, du, dd), mu=mu, weight=weight, thickness=thin)
    up = _thin((dd, du, ud, uu), mu=mu, weight=weight, thickness=thin)
    layer = Layer(*down, *up, direct)
    for _ in range(halvings):
        layer = add(layer, layer, weight=weight)
    while endless and np.abs(layer.transmission * weight).max() > 1e-14:
        layer = add(layer, layer, weight=weight)
    return layer


def add(top: Layer, bottom: Layer, *, weight: Array) -> Layer:
    """Return two layers, one on the other, as one."""
    down = _stacked(
        (top.reflection, top.transmission, top.reflection_up, top.transmission_up),
        (bottom.reflection, bottom.transmission),
        (top.direct, bottom.direct),
        weight,
    )
    up = _stacked(
        (
            bottom.reflection_up,
            bottom.transmission_up,
            bottom.reflection,
            bottom.transmission,
        ),
        (top.reflection_up, top.transmission_up),
        (bottom.direct, top.direct),
        weight,
    )
    return Layer(*down, *up, top.direct * bottom.direct)


def _stacked(
    near: tuple[Array, Array, Array, Array],
    far: tuple[Array, Array],
    direct: tuple[Array, Array],
    weight: Array,
) -> tuple[Array, Array]:
    """Return reflection and transmission of a near layer with a far one behind."""
    reflection, transmission, reflection_back, transmission_back = near
    column = weight[:, None]
    bounce = reflection_back @ (column * far[0])
    inward = np.linalg.solve(
        np.eye(weight.size) - bounce * weight, transmission + bounce * direct[0]
    )
    outward = far[0] * direct[0] + far[0] @ (column * inward)
    return (
        reflection
        + direct[0][:, None] * outward
        + transmission_back @ (column * outward),
        direct[1][:, None] * inward + far[1] * direct[0] + far[1] @ (column * inward),
    )


def _thin(
    scattering: tuple[Array, Array, Array, Array],
    *,
    mu: Array,
    weight: Array,
    thickness: complex,
) -> tuple[Array, Array]:
    """Return reflection and transmission of a thin layer by their power series.

    The layer grows at its lit side by invariant imbedding, R' = b* - a* R - R a + R b R
    and T' = T (b R - a) as operators, with a = 1 / mu - s. `scattering` holds, over
    the cosine out, s*, b*, b and s: back into back, ahead into back, back into ahead,
    ahead into ahead, "ahead" being the way of the incident light.
    """
    back, turn, turn_back, ahead = scattering
    column, rate = weight[:, None], 1 / mu
    lossy = rate[:, None] + rate
    reflection = [np.zeros_like(turn)]
    transmission = [np.zeros_like(turn)]
    stirred: list[Array] = []  # turn_back, after each term of the reflection
    for k in range(ORDER):
        last = reflection[k]
        stirred.append(turn_back @ (column * last))
        change = back @ (column * last) + last @ (column * ahead) - lossy * last
        passed = transmission[k] @ (column * ahead) - transmission[k] * rate
        beam = (-rate) ** k / _factorial(k)  # term k of exp(-tau / mu)
        passed = passed + beam[:, None] * ahead
        for j in range(k + 1):
            change = change + reflection[j] @ (column * stirred[k - j])
            beam = (-rate) ** j / _factorial(j)
            passed = passed + beam[:, None] * stirred[k - j]
            passed = passed + transmission[j] @ (column * stirred[k - j])
        if k == 0:
            change = change + turn
        reflection.append(change / (k + 1))
        transmission.append(passed / (k + 1))
    power = thickness ** np.arange(ORDER + 1)
    return (
        np.tensordot(power, np.array(reflection), 1),
        np.tensordot(power, np.array(transmission), 1),
    )


def h_function(cosine: ArrayLike, *, albedo: complex) -> Array:
    """Return Chandrasekhar's H function of isotropic scatterers, complex albedo.

    Its closed integral, S. Chandrasekhar, Radiative Transfer (1960), chapter V:
    ln H = -(mu / pi) times the integral over 0 ... pi / 2 of
    ln(1 - w t cot t) / (cos^2 t + mu^2 sin^2 t).
    """

    def logarithm(mu: float) -> complex:
        def integrand(root: float) -> complex:
            # t = root^2 takes the sharp end at t = 0 and w = 1 away.
            t = root * root
            bend = t * t / 3 + t**4 / 45 if t < 1e-3 else 1 - t / np.tan(t)
            below = np.cos(t) ** 2 + (mu * np.sin(t)) ** 2
            return complex(2 * root * np.log(1 - albedo + albedo * bend) / below)

        end = np.sqrt(np.pi / 2)
        value, _ = quad(integrand, 0, end, complex_func=True, epsabs=1e-13, limit=400)
        return complex(-mu / np.pi * value)

    flat = np.atleast_1d(np.asarray(cosine, dtype=float))
    return np.exp([logarithm(mu) for mu in flat]).reshape(np.shape(cosine))


def half_space_albedo(incidence: ArrayLike, *, albedo: complex) -> Array:
    """Return what an isotropic half-space reflects: 1 - H(mu0) sqrt(1 - w)."""
    return 1 - h_function(incidence, albedo=albedo) * np.sqrt(1 - complex(albedo))


def _radiance(modes: Array, stokes: ArrayLike, azimuth: ArrayLike) -> Array:
    """Return the sum of Fourier modes, negative ones by the mirror in x and z."""
    size = modes.shape[-1]
    state = np.atleast_1d(np.asarray(stokes, dtype=float))[:size]
    mirror = np.array([1.0, 1.0, -1.0, -1.0])[:size]
    phi = np.atleast_1d(np.asarray(azimuth, dtype=float))
    total = np.zeros((modes.shape[1], phi.size, size), dtype=complex)
    for m, mode in enumerate(modes):
        wave = np.exp(1j * m * phi)[:, None]
        total += (mode @ state)[:, None] * wave
        if m > 0:
            total += (mirror * (mode @ (mirror * state)))[:, None] * wave.conj()
    return total


def _lambert(mu: Array, size: int, reflectance: float) -> Layer:
    """Return the layer that stands for a Lambertian plane: nothing passes."""
    kernel = np.zeros((mu.size, size, mu.size, size))
    kernel[:, 0, :, 0] = 2 * reflectance * mu
    dark = np.zeros((mu.size * size,) * 2)
    return Layer(kernel.reshape(dark.shape), dark, dark, dark, np.zeros(mu.size * size))


def _legendre(mu: Array, m: int, count: int) -> Array:
    """Return sqrt((l - m)! / (l + m)!) P_l^m for l = m ... count - 1."""
    values = np.zeros((count - m, mu.size))
    first = np.ones_like(mu)
    for k in range(1, m + 1):
        first = first * np.sqrt((2 * k - 1) / (2 * k) * (1 - mu**2))
    values[0] = first
    if count - m > 1:
        values[1] = np.sqrt(2 * m + 1) * mu * first
    for k in range(m + 2, count):
        values[k - m] = (
            (2 * k - 1) * mu * values[k - m - 1]
            - np.sqrt((k - 1) ** 2 - m**2) * values[k - m - 2]
        ) / np.sqrt(k**2 - m**2)
    return values


def _factorial(k: int) -> float:
    return float(np.prod(np.arange(1, k + 1, dtype=float)))
