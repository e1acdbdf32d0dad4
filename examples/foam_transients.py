"""Shows amplitude-modulated ranging through foam on measured photon histograms.

Three measurements of one pulsed laser are turned into what instruments with modulated
light would have recorded: light through slabs (damping and delay against frequency),
a letter at two distances behind foam (range by phase, with and without the signal of
the foam), and scans of the letters S and T (frequencies that make them legible).

Data: D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), MIT license.
"""

from __future__ import annotations

import argparse
import functools
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import fft
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.io.slab_response import Slabs, mean_delay, read_slabs, slab_response
from amulor.io.transients import medium_from_minimum, read_transients
from amulor.optics import detection, low_pass, ranging
from amulor.view.style import BRIGHTNESS_MAP, DISTANCE_MAP, style

Floats = NDArray[np.float64]

DATA = Path(str(resources.files("amulor.samples").joinpath("data", "foam")))
LETTERS = {"S": "letter_s.npz", "T": "letter_t.npz"}
#: Up to here the slabs are looked at [Hz].
HIGHEST = 1e9
#: Distance between the two places of the letter U, by their labels [m].
STEP = 0.78 - 0.54
STEP_FREQUENCIES = 1e6 * np.array(
    [20, 30, 40, 50, 70, 100, 140, 200, 250, 300, 350, 400, 500, 600, 700, 800, 900,
     1000]
)  # fmt: skip
#: Band that reads the letters. Steps of 125 MHz repeat themselves after 1.2 m.
BAND = 1e6 * np.arange(1000, 3501, 125)
DEPTHS = np.arange(0.46, 0.62, 0.01)


def main() -> None:
    """Write the figures and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("foam-transients"))
    parser.add_argument("--format", default="png", choices=["png", "svg", "pdf"])
    parser.add_argument("--data", type=Path, default=DATA)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    slabs = read_slabs(arguments.data / "slab_transmission.npz")
    with style():
        for name, figure in (
            ("slab-response", draw_slabs(slabs)),
            ("range-difference", draw_steps(arguments.data)),
            ("letters", draw_letters(arguments.data, slabs)),
        ):
            figure.savefig(arguments.output / f"{name}.{arguments.format}", dpi=150)
            plt.close(figure)
    print(f"Figures are in {arguments.output}")


# Slabs: damping and delay against frequency


def cut_offs(slabs: Slabs) -> Floats:
    """Return where each slab has damped the modulation to 1 / sqrt(2) [Hz]."""

    @functools.cache
    def amplitudes(frequencies: tuple[float, ...]) -> Floats:
        return slab_response(slabs, frequencies)["amplitude"].values

    def response(frequency: Floats, number: int) -> Floats:
        # At zero frequency it is 1, by definition.
        ratio = np.ones(frequency.shape)
        ratio[frequency > 0] = amplitudes(tuple(frequency[frequency > 0]))[number]
        return ratio

    at_highest = amplitudes((HIGHEST,))[:, 0]
    return np.array(
        [
            low_pass.cut_off(
                functools.partial(response, number=number), maximum_frequency=HIGHEST
            )
            if at_highest[number] < np.sqrt(0.5)
            else np.inf
            for number in range(len(slabs.thickness))
        ]
    )


def draw_slabs(slabs: Slabs) -> Figure:
    """Draw amplitude and phase through slabs; print cut-offs and delays."""
    frequency = np.geomspace(5e6, HIGHEST, 250)
    response = slab_response(slabs, frequency)
    limits, delays = cut_offs(slabs), mean_delay(slabs)
    print("thickness   cut-off       mean delay")
    for thickness, limit, delay in zip(slabs.thickness, limits, delays, strict=True):
        print(f"{100 * thickness:6.2f} cm  {mega(limit):>10}  {1e9 * delay:8.2f} ns")
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(7, 7), sharex=True, layout="constrained"
    )
    colours = plt.colormaps["viridis"](np.linspace(0, 0.9, len(slabs.thickness)))
    for number, colour in enumerate(colours):
        one = response.isel(thickness=number)
        seen = (one["amplitude"] > 5 * one["amplitude_uncertainty"]).values
        seen = np.logical_and.accumulate(seen)
        label = f"{100 * slabs.thickness[number]:.1f} cm: {mega(limits[number])}"
        top.fill_between(
            frequency[seen] / 1e6,
            (one["amplitude"] - 2 * one["amplitude_uncertainty"])[seen],
            (one["amplitude"] + 2 * one["amplitude_uncertainty"])[seen],
            color=colour, alpha=0.3, linewidth=0,
        )  # fmt: skip
        top.plot(
            frequency[seen] / 1e6, one["amplitude"][seen], color=colour, label=label
        )
        top.plot(limits[number] / 1e6, np.sqrt(0.5), "o", color=colour, ms=5)
        bottom.plot(
            frequency[seen] / 1e6, np.degrees(np.unwrap(one["phase"]))[seen],
            color=colour,
        )  # fmt: skip
    top.axhline(np.sqrt(0.5), color="0.5", linewidth=0.8, linestyle="--")
    top.set(
        xscale="log", yscale="log", ylim=(1e-3, 1.5), ylabel="share of the modulation",
        title="measured light through slabs of foam",
    )  # fmt: skip
    top.legend(title="thickness: cut-off", loc="lower left")
    bottom.set(
        xlabel="modulation frequency [MHz]",
        ylabel="phase delay [degrees]",
        ylim=(0, None),
    )
    return figure


def mega(frequency: float) -> str:
    return f"{frequency / 1e6:.0f} MHz" if frequency < np.inf else "above 1 GHz"


# The letter U at two distances: range by phase


class Steps(NamedTuple):
    """Range difference of the two scenes at `STEP_FREQUENCIES` [m]."""

    difference: Floats
    uncertainty: Floats


def steps(data: Path) -> tuple[Steps, Steps]:
    """Return the range difference with the signal of the foam, and without it."""
    path = data / "letter_u_54_78.npz"
    medium = medium_from_minimum(path, STEP_FREQUENCIES)
    scenes = [
        cubes.attach(
            read_transients(path, STEP_FREQUENCIES, scene=scene), medium, "open_water"
        )
        for scene in (0, 1)
    ]
    before = difference(*[rejection.keep_water(scene) for scene in scenes])
    return before, difference(*[rejection.open_water(scene) for scene in scenes])


def difference(near: xr.Dataset, far: xr.Dataset) -> Steps:
    """Return by how much the whole image of a cube is farther than that of another."""
    (first, first_error), (second, second_error) = whole_image(near), whole_image(far)
    turn = np.angle(second / first)
    # Upwards in frequency, each step of the phase is the smallest that can be.
    places: dict[str, Any] = {
        "modulation_frequency": STEP_FREQUENCIES, "group_index": 1.0
    }  # fmt: skip
    wrapped = ranging.slant_range(turn, **places)
    interval = ranging.ambiguity_interval(**places)
    found = wrapped.copy()
    for i in range(1, len(found)):
        found[i] += interval[i] * np.round((found[i - 1] - wrapped[i]) / interval[i])
    return Steps(
        found,
        ranging.slant_range_uncertainty(np.hypot(first_error, second_error), **places),
    )


def whole_image(cube: xr.Dataset) -> tuple[NDArray[np.complex128], Floats]:
    """Return the sum of all pixels, and the uncertainty of its phase."""
    one = cube.isel(polarization=0)
    pixels = one.sizes["row"] * one.sizes["column"]
    names = ("in_phase_uncertainty", "quadrature_uncertainty")
    all_errors = [*(one[name] ** 2 for name in names), one.amulor.covariance]
    if "common_covariance" in one:
        shared = [*(one[f"common_{name}"] ** 2 for name in names)]
        shared.append(one["common_covariance"])
    else:
        shared = [xr.zeros_like(error) for error in all_errors]
    # The sum over errors that all pixels share grows with the number of pixels, that
    # over the others with its root.
    image = ("row", "column")
    variances = [
        ((error - common).sum(image) + pixels**2 * common.mean(image)).values
        for error, common in zip(all_errors, shared, strict=True)
    ]
    signal = one.amulor.signal.sum(("row", "column")).values
    return signal, detection.phase_uncertainty(
        signal,
        in_phase_variance=variances[0],
        quadrature_variance=variances[1],
        covariance=variances[2],
    )


def draw_steps(data: Path) -> Figure:
    """Draw and print the range difference against modulation frequency."""
    before, after = steps(data)
    print("\nletter U, 24 cm farther: difference by phase")
    print("modulation     with foam          foam subtracted")
    for frequency, *values in zip(STEP_FREQUENCIES, *before, *after, strict=True):
        raw, raw_error, clean, clean_error = (100 * value for value in values)
        print(
            f"{frequency / 1e6:6.0f} MHz  {raw:6.2f} +- {raw_error:4.2f} cm  "
            f"{clean:6.2f} +- {clean_error:4.2f} cm"
        )
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    axes.axhline(100 * STEP, color="0.3", linewidth=1, label="24 cm by the labels")
    for found, marker, label in (
        (before, "s", "with the signal of the foam"),
        (after, "o", "signal of the foam subtracted"),
    ):
        axes.errorbar(
            STEP_FREQUENCIES / 1e6, 100 * found.difference, 200 * found.uncertainty,
            marker=marker, linewidth=1, capsize=3, label=label,
        )  # fmt: skip
    axes.set(
        xscale="log", xlabel="modulation frequency [MHz]",
        ylabel="range difference [cm]",
        title="letter U behind foam, moved by 24 cm; bars: two standard errors",
    )  # fmt: skip
    axes.legend()
    return figure


# The letters S and T


def foam_twice(slabs: Slabs) -> NDArray[np.complex128]:
    """Return what an inch of foam does to light that passes it there and back."""
    response = slab_response(slabs, BAND).sel(thickness=0.0254)
    passed = response["amplitude"] * np.exp(1j * response["phase"])
    return np.asarray(passed.values**2)


def refocus(cube: xr.Dataset, response: NDArray[np.complex128]) -> Floats:
    """Return how bright each point behind the foam is, dimensions (depth, row, column).

    Every pixel of the scan sees all of the scene. The phasors that all pixels and
    frequencies would have by a point are summed against those that were measured, as
    phasor fields are (Liu et al., Nature 572, 620 (2019)).
    """
    signal = cube.amulor.signal.isel(polarization=0).values
    signal = signal / response[:, np.newaxis, np.newaxis]
    signal *= np.hanning(len(BAND) + 2)[1:-1, np.newaxis, np.newaxis]
    rows, columns = signal.shape[1:]
    x, y = cube["origin_x"].values, cube["origin_y"].values
    step_row = np.hypot(x[1, 0] - x[0, 0], y[1, 0] - y[0, 0])
    step_column = np.hypot(x[0, 1] - x[0, 0], y[0, 1] - y[0, 0])
    # Distances between a pixel and a point, cyclic so that a product of transforms
    # is the sum over pixels.
    along_rows = step_row * fft.fftfreq(2 * rows, 1 / (2 * rows))
    along_columns = step_column * fft.fftfreq(2 * columns, 1 / (2 * columns))
    aside = along_rows[:, np.newaxis] ** 2 + along_columns**2
    number = 4 * np.pi * BAND[:, np.newaxis, np.newaxis] / speed_of_light
    spectrum = fft.fft2(signal, s=aside.shape)
    found = []
    for depth in DEPTHS:
        expected = np.exp(-1j * number * np.sqrt(aside + depth**2))
        summed = (fft.fft2(expected) * spectrum).sum(axis=0)
        found.append(np.abs(fft.ifft2(summed))[:rows, :columns])
    return np.array(found)


def draw_letters(data: Path, slabs: Slabs) -> Figure:
    """Draw what one low, one high and many high frequencies show of the letters."""
    response = foam_twice(slabs)
    figure, axes = plt.subplots(
        len(LETTERS),
        4,
        figsize=(9.5, 4.6),
        layout="constrained",
        sharex="row",
        sharey="row",
    )
    for (letter, name), row in zip(LETTERS.items(), axes, strict=True):
        low = read_transients(data / name, 100e6)
        image = imaging.range_image(rejection.keep_water(low))
        cube = read_transients(data / name, BAND)
        volume = refocus(cube, response)
        brightest = volume.max(axis=0)
        distance = 100 * DEPTHS[volume.argmax(axis=0)]
        pictures = {
            "amplitude at 100 MHz": image["intensity"].values,
            "amplitude at 1 GHz": cube.amulor.amplitude.values[0, 0],
            "1 to 3.5 GHz, focused": brightest,
            "distance": np.where(brightest > 0.35 * brightest.max(), distance, np.nan),
        }
        right, down = 100 * cube["origin_x"].values, 100 * cube["origin_y"].values
        for ax, (title, values) in zip(row, pictures.items(), strict=True):
            is_distance = title.startswith("distance")
            mesh = ax.pcolormesh(
                right, down, values if is_distance else values / values.max(),
                shading="nearest", rasterized=True,
                cmap=DISTANCE_MAP if is_distance else BRIGHTNESS_MAP,
                vmin=None if is_distance else 0,
            )  # fmt: skip
            if is_distance:
                figure.colorbar(mesh, ax=ax, label="distance [cm]", shrink=0.8)
            elif "focused" in title:
                figure.colorbar(mesh, ax=ax, label="amplitude, relative", shrink=0.8)
            ax.set_aspect("equal")
            if letter == "S":
                ax.set_title(title)
        row[0].invert_yaxis()
        row[0].set_ylabel(f"letter {letter}\ndown [cm]")
    for ax in axes[-1]:
        ax.set_xlabel("right [cm]")
    return figure


if __name__ == "__main__":
    main()
