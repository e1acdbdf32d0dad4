"""Mitransient in the case of the narrow receiver, on a CPU by LLVM.

Run with the interpreter of an environment that has `mitransient`, and with
DRJIT_LIBLLVM_PATH set to LLVM 19, as README.md tells:
``python time_mitransient.py [--cpu] [--runs N]``.

Mitsuba follows light from the receiver to the source and cannot meet a pencil of light
by chance, so both are swapped, which reciprocity allows: the pencil is the sensor, the
disc an emitter of radiance 1 within the acceptance. What the sensor finds is then the
received fraction. Tried with chance hits of the disc, and with Mitsuba's own choice of
a point on the disc at each scattering, weighted against chance hits.
"""

from __future__ import annotations

import argparse

import case
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")

import mitransient  # noqa: E402, F401  (needs a variant; registers its plugins)

SAMPLES = 1 << 18


def scene(estimate: bool) -> mi.Scene:
    """Return the scene, with or without estimates at each scattering."""
    transform = mi.ScalarTransform4f
    water = {
        "type": "homogeneous",
        "sigma_t": case.ABSORPTION + case.SCATTERING,
        "albedo": case.SCATTERING / (case.ABSORPTION + case.SCATTERING),
        "sample_emitters": estimate,
        "phase": {"type": "hg", "g": case.ASYMMETRY},
    }
    film = {
        "type": "transient_hdr_film",
        "width": 1,
        "height": 1,
        "temporal_bins": 600,
        "start_opl": 0.0,
        "bin_width_opl": case.LONGEST / 600,
        "rfilter": {"type": "box"},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "transient_prbvolpath",
                "max_depth": 1000,
                "rr_depth": 1000,
            },
            # The sensor has to be outside of the water, as the integrator demands.
            "sensor": {
                "type": "radiancemeter",
                "origin": [0, 0, -0.01],
                "direction": [0, 0, 1],
                "film": film,
                "sampler": {"type": "independent"},
            },
            "water": {
                "type": "cube",
                "to_world": transform().translate([0, 0, 30]).scale([40, 40, 30]),
                "bsdf": {"type": "null"},
                "interior": water,
            },
            "disc": {
                "type": "disk",
                "to_world": transform()
                .translate([case.CENTRE, 0, -0.0005])
                .scale([case.RADIUS, case.RADIUS, 1]),
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {
                    "type": "angulararea",
                    "radiance": 1.0,
                    "cutoff_angle": float(np.degrees(case.ACCEPTANCE)),
                },
            },
        }
    )


def render(built: mi.Scene, seed: int, samples: int = SAMPLES) -> float:
    """Return the received fraction of one run."""
    steady, _ = built.integrator().render(built, seed=seed, spp=samples)
    return float(np.ravel(np.array(steady))[0])


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cpu", action="store_true", help="CPU time over two cores")
    parser.add_argument("--runs", type=int, default=16, help="runs of 262144 samples")
    options = parser.parse_args()
    print("seconds:", "CPU time over two cores" if options.cpu else "wall")
    for name, estimate in (("chance hits", False), ("estimates", True)):
        built = scene(estimate)
        render(built, 1, SAMPLES // 16)  # compiles
        start = case.clock(options.cpu)
        found = np.array([render(built, 2 + k) for k in range(options.runs)])
        seconds = case.clock(options.cpu) - start
        print(f"{options.runs * SAMPLES / seconds:.3g} histories/s, {name}")
        variance = float(found.var(ddof=1)) / options.runs
        case.report(f"mitransient, {name}", float(found.mean()), variance, seconds)


if __name__ == "__main__":
    main()
