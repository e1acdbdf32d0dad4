"""Time of the small-angle form against the diffusion form, in one run.

Run with ``python benchmarks/time_small_angle.py``. The cases take turns and the
shortest time of each counts, so other load on the machine hardly moves the ratios.
"""

from __future__ import annotations

import math
import time

import history
import numpy as np

from amulor.optics import small_angle, small_angle_diffusion
from amulor.optics.phase_functions import forward_split, henyey_greenstein
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.small_angle import sharp_receiver as small_angle_sharp_receiver

SPLIT = np.pi / 2
SWEEP = np.linspace(0.5e6, 138e6, 200)
INSTRUMENT = {
    "backscatter_vsf": 1e-3,
    "group_index": 1.34,
    "baseline": 0.2,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}


def peaked(angle):
    """Return a sum of two peaks, sharp and broad as those of natural waters are."""
    sharp = henyey_greenstein(angle, asymmetry=0.99)
    return 0.7 * sharp + 0.3 * henyey_greenstein(angle, asymmetry=0.75)


COASTAL = petzold("HAOCE 11")


def exact(phase_function=peaked, form=small_angle, **beam):
    """Return the response in small-angle form at 200 frequencies."""
    return form.water_response(
        SWEEP,
        absorption=0.15,
        scattering=0.35,
        phase_function=phase_function,
        split_angle=SPLIT,
        **INSTRUMENT,
        **beam,
    )


def measured():
    """Return the same for a table of Petzold."""
    return exact(COASTAL)


def sharp():
    """Return the response of a receiver with sharp edges, for a thin beam."""
    return exact(form=small_angle_sharp_receiver)


def sharp_wide_beam():
    """Return the same for a beam of 2 mm."""
    return exact(form=small_angle_sharp_receiver, beam_radius=2e-3)


def first_call():
    """Return the same for a phase function that was not met before."""
    return exact(lambda angle: peaked(angle))


def diffusion():
    """Return the response in diffusion form at the same frequencies."""
    return small_angle_diffusion.water_response(
        SWEEP,
        absorption=0.15,
        forward_scattering=0.35 * SHARE,
        diffuse_scattering=0.35 * (1 - SHARE),
        second_moment=MOMENT,
        **INSTRUMENT,
    )


SHARE, MOMENT = forward_split(peaked, split_angle=SPLIT)


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
    cases = {
        "diffusion form, eq. (46)": diffusion,
        "small-angle form, eq. (29)": exact,
        "the same, Petzold's coastal water": measured,
        "the same, sharp receiver": sharp,
        "the same, and a beam of 2 mm": sharp_wide_beam,
        "first form, new phase function": first_call,
    }
    for case in cases.values():
        case()  # the first call compiles or loads the kernel
    best = shortest(cases, 8)
    reference = best["diffusion form, eq. (46)"]
    print("200 frequencies, 0.5 to 138 MHz, open water")
    print(f"{'':36}{'time':>13}{'ratio':>9}")
    for name, seconds in best.items():
        print(f"{name:36}{seconds * 1e3:10.3f} ms{seconds / reference:9.1f}")
    ratios = {f"{name}, over diffusion": best[name] / reference for name in best}
    history.append("time_small_angle", ratios | {"diffusion form, s": reference})


if __name__ == "__main__":
    main()
