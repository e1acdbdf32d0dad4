"""Time of the water response against scipy.integrate.quad and a plain Gauss rule.

Run with ``python benchmarks/time_water_response.py``. All ratios come from one run,
in which the cases take turns and the shortest time of each counts, so other load on
the machine hardly moves them.
"""

from __future__ import annotations

import math
import time
import warnings

import history
import numpy as np
from scipy.constants import speed_of_light
from scipy.integrate import IntegrationWarning, quad

from amulor.optics.small_angle_diffusion import water_response

# The lower turbidity of the long tank, simple model: 200 frequencies of one sweep.
COLUMN = {
    "absorption": 0.0,
    "forward_scattering": 0.0,
    "diffuse_scattering": 0.5,
    "second_moment": 0.0,
    "backscatter_vsf": 1e-3,
    "group_index": 1.34,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}
SWEEP = np.linspace(0.5e6, 138e6, 200)
WAVENUMBER = 4 * np.pi * SWEEP * COLUMN["group_index"] / speed_of_light
FACTOR = 1e-3 * math.pi * (0.02 * 0.08) ** 2


def integrand(z):
    """Return F(z) over its constant factor, as fast as plain Python can."""
    area = 4e-4 + 6.4e-3 * z * z
    return math.exp(-z - 0.04 / area) / area


def amulor():
    """Return the response by the package."""
    return water_response(SWEEP, **COLUMN)


def quad_loop():
    """Return the response by two calls of quad for each frequency."""
    options = {"epsabs": 0.0, "epsrel": 1e-9, "limit": 500}

    def single(k):
        real = quad(lambda z: integrand(z) * math.cos(k * z), 0, 40, **options)
        imaginary = quad(lambda z: integrand(z) * math.sin(k * z), 0, 40, **options)
        return complex(real[0], imaginary[0])

    return FACTOR * np.array([single(k) for k in WAVENUMBER.tolist()])


def quad_weighted():
    """Return the response by quad with its rule for oscillating weights."""
    options = {"epsabs": 1e-13, "epsrel": 1e-9, "limit": 500}

    def single(k):
        real = quad(integrand, 0, 40, weight="cos", wvar=k, **options)
        imaginary = quad(integrand, 0, 40, weight="sin", wvar=k, **options)
        return complex(real[0], imaginary[0])

    return FACTOR * np.array([single(k) for k in WAVENUMBER.tolist()])


def gauss(order, panels=1, end=25.0):
    """Return a function that sums a Gauss-Legendre rule, vectorised."""
    node, weight = np.polynomial.legendre.leggauss(order)
    half = end / panels / 2
    z = (half * (2 * np.arange(panels)[:, None] + 1 + node)).ravel()
    weights = np.tile(half * weight, panels)

    def response():
        area = 4e-4 + 6.4e-3 * z * z
        value = weights * np.exp(-z - 0.04 / area) / area
        return FACTOR * (np.exp(1j * np.multiply.outer(WAVENUMBER, z)) @ value)

    return response


def scan():
    """Return 4000 pixels with tilts and ends of their own, at three frequencies."""
    shape = (50, 80)
    arguments = COLUMN | {
        "tilt": np.linspace(0.02, 0.09, 4000).reshape(shape),
        "cross_tilt": np.linspace(-0.02, 0.02, 80),
        "end": np.linspace(1.4, 1.6, 50)[:, None],
    }
    return water_response(np.array([1e7, 39e6, 1e8])[:, None, None], **arguments)


def design():
    """Return 100 x 100 instruments at 200 frequencies."""
    arguments = COLUMN | {
        "baseline": np.linspace(0.02, 0.4, 100)[:, None],
        "acceptance_angle": np.linspace(0.02, 0.15, 100),
    }
    return water_response(SWEEP[:, None, None], **arguments)


def one_high(frequency):
    """Return a function for 200 frequencies about a high one."""
    sweep = frequency + SWEEP
    return lambda: water_response(sweep, **COLUMN)


def shortest(cases, turns):
    """Return the shortest time of each case [s]; cases that are quick run often."""
    best = dict.fromkeys(cases, math.inf)
    for _ in range(turns):
        for name, case in cases.items():
            until = time.perf_counter() + 0.1
            while True:
                start = time.perf_counter()
                case()
                stop = time.perf_counter()
                best[name] = min(best[name], stop - start)
                if stop > until:
                    break
    return best


def main():
    """Print the table."""
    warnings.simplefilter("ignore", IntegrationWarning)
    reference = gauss(40, panels=60, end=45.0)()
    at_zero = water_response(0.0, **COLUMN).real
    first = "amulor water_response"
    peers = {
        first: amulor,
        "loop of scipy quad, 1e-9": quad_loop,
        "loop of scipy quad, oscillating weight": quad_weighted,
        "vectorised Gauss rule, 96 nodes": gauss(96),
        "vectorised Gauss rule, 128 nodes": gauss(128),
        "vectorised Gauss rule, 160 nodes": gauss(160),
    }
    others = {
        "200 frequencies from 1 GHz on": one_high(1e9),
        "1 frequency": lambda: water_response(39e6, **COLUMN),
        "scan: 4000 pixels, 3 frequencies": scan,
        "design: 100 x 100 instruments, 200 frequencies": design,
    }
    for case in others.values():
        case()  # the first call compiles or loads the kernel
    best = shortest(peers | others, 5)
    print("200 frequencies, 0.5 to 138 MHz, open water")
    print(f"{'':46}{'time':>13}{'ratio':>9}{'error/G(0)':>12}{'error/G':>10}")
    for name, case in peers.items():
        error = np.abs(case() - reference)
        relative = np.max(error / np.abs(reference))
        print(
            f"{name:46}{best[name] * 1e3:10.3f} ms{best[name] / best[first]:9.1f}"
            f"{np.max(error) / at_zero:12.0e}{relative:10.0e}"
        )
    print("other calls of amulor")
    for name in others:
        print(f"{name:46}{best[name] * 1e3:10.3f} ms{best[name] / best[first]:9.1f}")
    ratios = {f"{n}, over amulor": best[n] / best[first] for n in best if n != first}
    history.append("time_water_response", {f"{first}, s": best[first]} | ratios)


if __name__ == "__main__":
    main()
