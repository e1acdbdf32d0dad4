"""Compare photon transport through slabs with measured slabs of foam: table and figure.

    python docs/make_foam_images.py            # draws the figure from the table
    python docs/make_foam_images.py --photons  # simulates the slabs that it lacks

A simulation takes up to ten minutes a slab. Its results are appended to
docs/theory/foam-slabs.csv, so an interrupted run continues.
"""

from __future__ import annotations

import csv
import sys
import textwrap
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.io import read_slabs, slab_response
from amulor.optics.phase_functions.models import isotropic
from amulor.transport import Layer, Medium, Tally, reflection_and_transmission
from amulor.view.report import png
from amulor.view.style import new_figure, style

HERE = Path(__file__).parent
DATA = HERE.parent / "src/amulor/samples/data/foam/slab_transmission.npz"
TABLE = HERE / "theory" / "foam-slabs.csv"
PICTURE = HERE / "images" / "foam" / "slab-transport.png"

#: Published fit of the foam: reduced scattering and absorption [1/m], index [1].
SCATTERING, ABSORPTION, INDEX = 262.0, 0.53, 1.12
MHZ = (10, 20, 36.7, 50, 80, 100, 138, 146, 200, 300, 400, 600, 800)
INCH = 0.0254
#: Photons of each slab, in millions, from one inch to eight.
MILLIONS = (2, 2, 4, 6, 8, 12, 16, 20)
#: Radii of the discs that give the light at a point, as fractions of the thickness.
INNER, OUTER = 0.2, 0.4
#: Lowest amplitude that is compared; below, background and noise matter.
LOWEST = 0.1


@dataclass(frozen=True, kw_only=True)
class Row:
    """Simulated response of a slab at one modulation frequency."""

    inch: int
    """Thickness [inch]."""
    mhz: float
    """Modulation frequency [MHz]."""
    amplitude: float
    """Amplitude relative to that at zero frequency [1]."""
    amplitude_error: float
    """Standard error of the amplitude [1]."""
    phase: float
    """Delay of the modulation, wrapped to -pi..pi [rad]."""
    phase_error: float
    """Standard error of the phase [rad]."""


def simulated(inch: int, histories: int, *, seed: int) -> list[Row]:
    """Simulate a slab of foam, and return its response from point to point."""
    thickness = inch * INCH
    layer = Layer(
        absorption=ABSORPTION,
        scattering=SCATTERING,
        phase_function=isotropic(),
        thickness=thickness,
    )
    tally = reflection_and_transmission(
        Medium.layered([layer], group_index=INDEX),
        [0.0, *(1e6 * f for f in MHZ)],
        histories=histories,
        seed=seed,
        index_ratio=INDEX,
        discs=[INNER * thickness, OUTER * thickness],
        threads=1,
    )
    signal, change = at_point(tally)
    weight = tally.histories_of / tally.histories
    # First order: changes of the logarithm of each batch.
    variance = [
        weight**2 @ part**2 * len(weight) / (len(weight) - 1)
        for part in (change.real, change.imag)
    ]
    amplitude = np.abs(signal)
    return [
        Row(
            inch=inch,
            mhz=MHZ[k],
            amplitude=float(amplitude[k]),
            amplitude_error=float(amplitude[k] * np.sqrt(variance[0][k])),
            phase=float(np.angle(signal[k])),
            phase_error=float(np.sqrt(variance[1][k])),
        )
        for k in range(len(MHZ))
    ]


def at_point(tally: Tally) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the response opposite of the beam, and its changes in each batch.

    The density of the light is linear in the squared distance from the axis. Disc and
    ring around it have the mean squares INNER^2 / 2 and (INNER^2 + OUTER^2) / 2.
    """
    disc, both = (
        tally.batches[:, tally.parts.index(name), 0] for name in ("disc 1", "disc 2")
    )
    density = disc / INNER**2
    ring = (both - disc) / (OUTER**2 - INNER**2)
    light = density + (density - ring) * INNER**2 / OUTER**2
    mean = tally.histories_of @ light / tally.histories
    relative = light / mean - 1
    return mean[1:] / mean[0], relative[:, 1:] - relative[:, :1]


def rows() -> list[Row]:
    """Return the rows of the table."""
    with TABLE.open(encoding="utf-8") as file:
        return [
            Row(inch=int(row.pop("inch")), **{k: float(v) for k, v in row.items()})
            for row in csv.DictReader(file)
        ]


def add_missing() -> None:
    """Simulate the slabs that the table lacks, and append each when finished."""
    present = {row.inch for row in rows()} if TABLE.exists() else set()
    for inch, millions in enumerate(MILLIONS, start=1):
        if inch in present:
            continue
        lines = simulated(inch, millions * 1_000_000, seed=inch)
        with TABLE.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(asdict(lines[0])), lineterminator="\n")
            if file.tell() == 0:
                writer.writeheader()
            for line in lines:
                writer.writerow({k: f"{v:.6g}" for k, v in asdict(line).items()})
        print(f"{inch} inch: {millions} million photons", flush=True)


def compared() -> dict[str, NDArray[np.float64]]:
    """Return measurement and simulation of the amplitudes above the lowest."""
    response = slab_response(read_slabs(DATA), [1e6 * f for f in MHZ])
    keys = ("inch", "mhz", "amplitude", "amplitude_error", "phase", "phase_error")
    table = {key: np.array([getattr(row, key) for row in rows()]) for key in keys}
    shape = response["amplitude"].shape
    for name in ("amplitude", "phase"):
        table[f"measured_{name}"] = response[name].values.ravel()
        table[f"measured_{name}_error"] = response[f"{name}_uncertainty"].values.ravel()
    if table["inch"].size != shape[0] * shape[1]:
        raise SystemExit(f"{TABLE}: slabs are missing; run with --photons")
    chosen = table["measured_amplitude"] > LOWEST
    return {key: values[chosen] for key, values in table.items()}


def deviation(table: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the relative difference of simulated from measured amplitudes [1]."""
    return np.asarray(table["amplitude"] / table["measured_amplitude"] - 1)


def delays(table: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return simulated less measured delays, less one mean for all slabs [s]."""
    omega = 2e6 * np.pi * table["mhz"]
    turned = table["phase"] - table["measured_phase"]
    # Delays at low frequencies lack no whole period.
    zero = np.mean((turned / omega)[table["mhz"] < 40])
    delay = np.angle(np.exp(1j * (turned - omega * zero))) / omega
    return np.asarray(delay - np.mean(delay))


def without_time_zeros(
    table: dict[str, NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the differences of delays less the mean of each slab [s]."""
    left = delays(table)
    for inch in np.unique(table["inch"]):
        left[table["inch"] == inch] -= np.mean(left[table["inch"] == inch])
    return left


def drawn(table: dict[str, NDArray[np.float64]]) -> Figure:
    """Draw measured and simulated amplitudes, and their difference, per slab."""
    with style():
        figure = new_figure(6.4, 5.0)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        for inch in range(1, len(MILLIONS) + 1):
            of_slab = table["inch"] == inch
            slab = {key: values[of_slab] for key, values in table.items()}
            color = f"C{(inch - 1) % 7}" if inch < 8 else "#7a7a7a"
            above.loglog(slab["mhz"], slab["amplitude"], color=color)
            above.loglog(
                slab["mhz"], slab["measured_amplitude"], "o", ms=4, mfc="none",
                color=color, label=f"{inch} in",
            )  # fmt: skip
            below.errorbar(
                slab["mhz"],
                100 * deviation(slab),
                100 * slab["amplitude_error"] / slab["measured_amplitude"],
                fmt="o-", ms=3, color=color,
            )  # fmt: skip
        above.set(ylabel="amplitude over that at 0 MHz", title=None)
        above.legend(title="circles: measured\nlines: photon transport", ncols=2)
        below.axhline(0, color="black", lw=0.6)
        below.set(xlabel="modulation frequency [MHz]", ylabel="difference [%]")
        for axis in (above, below):
            axis.grid(visible=True)
        return figure


def summary(table: dict[str, NDArray[np.float64]]) -> str:
    """Return the comparison in words, as on the page."""
    left = 100 * deviation(table)
    noise = 100 * table["amplitude_error"] / table["measured_amplitude"]

    def rms(values: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean(values**2)))

    return (
        f"{left.size} amplitudes above {LOWEST} are compared. Their rms difference is "
        f"{rms(left):.1f} %, and the median difference is {np.median(left):+.1f} %. "
        f"The noise of the simulation contributes {rms(noise):.1f} %. "
        "With one time zero for all slabs, the delays differ by "
        f"{1e12 * rms(delays(table)):.0f} ps (rms). With one for each slab, they "
        f"differ by {1e12 * rms(without_time_zeros(table)):.0f} ps."
    )


def main() -> None:
    """Simulate what is missing if asked to, print the comparison, and draw it."""
    if "--photons" in sys.argv[1:]:
        add_missing()
    table = compared()
    print(textwrap.fill(summary(table), 80))
    with style():
        PICTURE.write_bytes(png(drawn(table)))


if __name__ == "__main__":
    main()
