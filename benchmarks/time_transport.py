"""Figures of merit of the photon transport beside plain loops, in one run.

Run with ``python benchmarks/time_transport.py [--cpu] [--long]``. The figure of merit
is 1 / (relative variance x seconds) of the light received at zero frequency, while all
carry 20 frequencies from 1 to 200 MHz. The cases take turns, so other load on the
machine hardly moves the ratios. With --cpu the seconds are CPU time over two cores,
which other load moves less still; with --long the plain loops run longer.

The plain loops are those of tests/oracles. A variance by chance hits is taken from the
number of histories and the fraction that this program finds: a hit counts 1, so it is
p (1 - p) a history, and this is surer than the scatter of few hits. The other variances
are those of the scores themselves. A local estimate has a heavy tail: the fewer its
histories, the more likely is a figure that is too good.
"""

from __future__ import annotations

import argparse
import os

# Idle threads of the linear algebra would spin, and count as CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import history
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))

import plain_photon_loops as plain
from numpy.typing import ArrayLike

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.polarization.mueller import rayleigh
from amulor.transport import (
    DiscReceiver,
    Layer,
    Medium,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    Tally,
    Technique,
    reflection_and_transmission,
    simulate,
)

NARROW = plain.Case()
WIDE = plain.Case(acceptance=np.pi / 2)
ANGLE = np.linspace(0, np.pi, 3601)
PEAK = henyey_greenstein_function(asymmetry=NARROW.asymmetry)
MATRIX = ScatteringMatrix.tabulated(ANGLE, mueller=rayleigh(ANGLE), phase_function=PEAK)
FIRST_USE = """
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import DiscReceiver, Medium, Source, simulate
peak = henyey_greenstein_function(asymmetry=0.95)
water = Medium.homogeneous(
    absorption=0.2, scattering=0.8, phase_function=peak, group_index=1.33
)
disc = DiscReceiver(radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0))
simulate(water, Source(), disc, [0.0], histories=1000, seed=1)
"""


@dataclass
class Clock:
    """Seconds of the wall, or CPU time over two cores."""

    cpu: bool

    def __call__(self) -> float:
        """Return a time [s]."""
        return time.process_time() / 2 if self.cpu else time.perf_counter()


@dataclass
class Entry:
    """A way to the same number: a run gives mean, its variance and histories."""

    name: str
    run: Callable[[int], tuple[float, float, int]]
    means: list[float] = field(default_factory=list)
    variances: list[float] = field(default_factory=list)
    histories: int = 0
    seconds: float = 0.0

    @property
    def mean(self) -> float:
        """Received fraction."""
        return float(np.mean(self.means))

    @property
    def variance(self) -> float:
        """Variance of the mean; NaN for hits, which are counted only."""
        return float(np.sum(self.variances)) / len(self.means) ** 2

    def merit(self, fraction: float) -> float:
        """Return the figure of merit; hits need the fraction."""
        if np.isnan(self.variance):
            return self.histories * fraction / (1 - fraction) / self.seconds
        return self.mean**2 / self.variance / self.seconds


def run_of(
    case: plain.Case,
    histories: int,
    seed: int,
    frequencies: ArrayLike,
    *,
    polarized: bool = False,
    **options: Any,
) -> Tally:
    """Return a run of this package for a case of the plain loops."""
    water = Medium.homogeneous(
        absorption=case.attenuation * (1 - case.albedo),
        scattering=case.attenuation * case.albedo,
        phase_function=MATRIX if polarized else PEAK,
        group_index=case.group_index,
    )
    receiver = DiscReceiver(
        radius=case.radius,
        acceptance_angle=case.acceptance,
        position=(case.centre, 0.0, 0.0),
    )
    return simulate(
        water,
        Source(polarization="H" if polarized else "none"),
        receiver,
        frequencies,
        histories=histories,
        seed=seed,
        **options,
    )


def product(
    case: plain.Case,
    histories: int,
    *,
    polarized: bool = False,
    technique: Technique | None = None,
) -> Callable[[int], tuple[float, float, int]]:
    """Return a run of this package."""

    def run(seed: int) -> tuple[float, float, int]:
        tally = run_of(
            case,
            histories,
            seed,
            plain.FREQUENCIES,
            polarized=polarized,
            technique=technique,
        )
        total, square, _ = tally.contribution
        mean = total / tally.groups
        variance = (square / tally.groups - mean**2) / tally.groups
        return mean, variance, tally.histories

    return run


def loop(
    function: Callable[..., plain.Tally],
    case: plain.Case,
    histories: int,
    *,
    hits: bool = False,
    **options: bool,
) -> Callable[[int], tuple[float, float, int]]:
    """Return a run of a plain loop."""

    def run(seed: int) -> tuple[float, float, int]:
        tally = function(case, histories=histories, seed=seed, **options)
        mean = float(np.ravel(tally.mean)[0])
        error = float(np.ravel(tally.standard_error)[0])
        return mean, np.nan if hits else error**2, histories

    return run


def take_turns(entries: list[Entry], clock: Clock, turns: int) -> None:
    """Run each entry as often, after a run that compiles or loads its kernel."""
    for entry in entries:
        entry.run(0)
    for seed in range(1, turns + 1):
        for entry in entries:
            start = clock()
            mean, variance, histories = entry.run(seed)
            entry.seconds += clock() - start
            entry.means.append(mean)
            entry.variances.append(variance)
            entry.histories += histories


def table(
    title: str, entries: list[Entry], goals: dict[str, float]
) -> dict[str, float]:
    """Print and return merits; the first entry is what all others are compared to."""
    first = entries[0]
    print(f"\n| {title} | fraction | histories | us each | FOM | ratio | goal |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for entry in entries:
        merit = entry.merit(first.mean)
        variance = entry.variance
        if np.isnan(variance):
            variance = first.mean / entry.histories
        goal = goals.get(entry.name)
        print(
            f"| {entry.name} | {entry.mean:.4g} +- {variance**0.5:.1g} "
            f"| {entry.histories:.2g} | {2e6 * entry.seconds / entry.histories:.3g} "
            f"| {merit:,.4g} | {first.merit(first.mean) / merit:,.3g} "
            f"| {'' if goal is None else f'{goal:,.0f}'} |"
        )
    best = first.merit(first.mean)
    figures = {
        f"{title}: amulor over {e.name}": best / e.merit(first.mean)
        for e in entries[1:]
    }
    return figures | {f"{title}: amulor, 1/s": best}


def narrow(clock: Clock, long: bool) -> dict[str, float]:
    """Print and return the case of the narrow receiver, scalar and Stokes vectors."""
    hits, guess = "plain chance hits", "plain local estimate"
    count = 2_000_000
    scalar = [
        Entry("amulor", product(NARROW, 300_000)),
        Entry(hits, loop(plain.chance_hits, NARROW, 2 * count, hits=True)),
        Entry(guess, loop(plain.local_estimate, NARROW, 14_000_000 if long else count)),
    ]
    stokes = [
        Entry("amulor", product(NARROW, 300_000, polarized=True)),
        Entry(hits, loop(plain.chance_hits_stokes, NARROW, count, hits=True)),
        Entry(
            guess,
            loop(
                plain.local_estimate_stokes, NARROW, 8_000_000 if long else count // 2
            ),
        ),
    ]
    take_turns([*scalar, *stokes], clock, 3)
    figures = table("narrow, scalar", scalar, {hits: 2000, guess: 200})
    figures |= table("narrow, Stokes vectors", stokes, {hits: 1000, guess: 100})
    each = [entry[0].seconds / entry[0].histories for entry in (scalar, stokes)]
    print(f"\nStokes vectors cost {each[1] / each[0]:.2f} times as much (goal 3)")
    return figures | {"Stokes vectors over scalar, time": each[1] / each[0]}


def wide(clock: Clock, long: bool) -> dict[str, float]:
    """Print and return the case of the receiver that takes light from any angle."""
    hits = "plain chance hits"
    count = 4_000_000 if long else 2_000_000
    entries = [
        Entry("amulor", product(WIDE, 300_000)),
        Entry(hits, loop(plain.chance_hits, WIDE, count, hits=True)),
        Entry(
            "plain local estimate, directions", loop(plain.local_estimate, WIDE, count)
        ),
        Entry(
            "plain local estimate, points",
            loop(plain.local_estimate, WIDE, count, point_on_disc=True),
        ),
    ]
    take_turns(entries, clock, 3)
    return table("any angle", entries, dict.fromkeys((e.name for e in entries[1:]), 5))


def techniques(clock: Clock) -> None:
    """Print what each choice of technique gives, narrow and at any angle."""
    choices = {
        "as it is: 8 paths, 8 partners": Technique(),
        "last way never a local estimate": Technique(direct=False),
        "last way always a local estimate": Technique(direct=True),
        "not balanced": Technique(balanced=False),
        "not stratified": Technique(stratified=False),
    }
    for n in (1, 2, 4, 16, 32):
        choices[f"{n} paths, {n} partners"] = Technique(paths=n, partners=n)
    for paths, partners in ((2, 16), (4, 16), (4, 32), (16, 4)):
        choices[f"{paths} paths, {partners} partners"] = Technique(
            paths=paths, partners=partners
        )
    kinds = [
        [
            Entry(name, product(case, 200_000, technique=choice))
            for name, choice in choices.items()
        ]
        for case in (NARROW, WIDE)
    ]
    take_turns([*kinds[0], *kinds[1]], clock, 2)
    for title, entries in zip(
        ("technique, narrow", "technique, any angle"), kinds, strict=True
    ):
        table(title, entries, {})


def echo(clock: Clock) -> dict[str, float]:
    """Print and return the FOM of a plane target's light by optical thickness."""
    figures = {}
    print("\n| attenuation lengths to the target | light | FOM | FOM at 200 MHz |")
    print("| --- | --- | --- | --- |")
    for distance in (1.5, 3.0, 5.0, 8.0, 12.0):
        target = PlaneTarget(position=(0, 0, distance), reflectance=0.3)
        start = clock()
        tally = run_of(NARROW, 500_000, 1, [0.0, 200e6], target=target)
        seconds = clock() - start
        merit = tally.relative_error_of("target") ** -2.0 / seconds
        light = abs(tally.target_signal[0])
        error = light * tally.relative_error_of("target")[0]
        print(
            f"| {distance:g} | {light:.4g} +- {error:.1g} | {merit[0]:,.3g} "
            f"| {merit[1]:,.3g} |"
        )
        figures[f"target at {distance:g} attenuation lengths, 1/s"] = merit[0]
    return figures


def thick(clock: Clock) -> dict[str, float]:
    """Print and return the FOM of the water's light by albedo and frequencies."""
    figures = {}
    print("\n| albedo | modulation frequencies | us each | FOM |")
    print("| --- | --- | --- | --- |")
    cases = [(0.8, 1, 300_000), (0.8, 20, 300_000), (0.8, 200, 300_000)]
    cases += [(0.95, 1, 100_000), (0.99, 1, 30_000), (0.999, 1, 3000)]
    for albedo, count, histories in cases:
        case = replace(NARROW, albedo=albedo)
        start = clock()
        tally = run_of(case, histories, 1, np.linspace(0.0, 200e6, count))
        seconds = clock() - start
        merit = tally.relative_error[0] ** -2.0 / seconds
        each = 2e6 * seconds / tally.histories
        print(f"| {albedo:g} | {count} | {each:.3g} | {merit:,.3g} |")
        figures[f"albedo {albedo:g}, {count} frequencies, 1/s"] = merit
    return figures


def slab(clock: Clock) -> dict[str, float]:
    """Print and return histories per second through a slab."""
    layer = Layer(
        absorption=0.1,
        scattering=0.9,
        phase_function=henyey_greenstein_function(asymmetry=0.75),
        thickness=2.0,
    )
    water = Medium.layered([layer], group_index=1.33)
    histories = 4_000_000

    def own(seed: int) -> float:
        tally = reflection_and_transmission(
            water, [0.0], histories=histories, seed=seed
        )
        return float(tally.part("reflected")[0][0, 0].real)

    def other(seed: int) -> float:
        return float(plain.slab(histories=histories, seed=seed).reflected.mean().real)

    ways = {"amulor": own, "plain loop": other}
    best = dict.fromkeys(ways, np.inf)
    found = {name: way(0) for name, way in ways.items()}
    for seed in range(1, 4):
        for name, way in ways.items():
            start = clock()
            found[name] = way(seed)
            best[name] = min(best[name], clock() - start)
    print("\n| slab, asymmetry 0.75 | reflected | million histories/s |")
    print("| --- | --- | --- |")
    for name, seconds in best.items():
        print(f"| {name} | {found[name]:.4f} | {histories / seconds / 1e6:.2f} |")
    return {f"slab: {name}, histories/s": histories / s for name, s in best.items()}


def starts(cpu: bool) -> dict[str, float]:
    """Print and return how long a new process takes, with an empty cache and later."""

    def start(folder: str) -> float:
        wall, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        subprocess.run([sys.executable, "-c", FIRST_USE], check=True, env=environment)
        wall = time.perf_counter() - wall
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
        return spent if cpu else wall

    with tempfile.TemporaryDirectory() as folder:
        first = start(folder)
        later = min(start(folder) for _ in range(3))
    print(
        f"\nnew process, 1000 histories, {'CPU' if cpu else 'wall'} seconds: "
        f"empty cache {first:.1f} s (goal 30), later {later:.2f} s (goal 2)"
    )
    return {"new process, empty cache, s": first, "new process, later, s": later}


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cpu", action="store_true", help="CPU time over two cores")
    parser.add_argument("--long", action="store_true", help="longer plain loops")
    options = parser.parse_args()
    clock = Clock(options.cpu)
    print("seconds:", "CPU time over two cores" if options.cpu else "wall time")
    print(f"{os.cpu_count()} cores; 'us each' is the time of one core for a history")
    figures = narrow(clock, options.long)
    figures |= wide(clock, options.long)
    techniques(clock)
    figures |= echo(clock)
    figures |= thick(clock)
    figures |= slab(clock)
    figures |= starts(options.cpu)
    history.append("time_transport", figures | {"cpu_time": options.cpu})


if __name__ == "__main__":
    main()
