"""Draws the figures of docs/theory from the models themselves."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from amulor.optics import (
    extrema,
    interference,
    low_pass,
    small_angle,
    small_angle_diffusion,
    target_echo,
)
from amulor.optics.phase_functions import mie
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.optics.polarization import mueller
from amulor.view.report import png
from amulor.view.style import COLOURS, new_figure, style

FOLDER = Path(__file__).parent / "images"
RECEIVER = {"receiver_radius": 0.02, "acceptance_angle": 0.08}
BASELINES = {0.07: "-", 0.20: "--"}
ABSORBED = 0.3  # of the attenuation
INDEX = 1.34


def waters() -> dict[str, PhaseFunction]:
    """Return the phase functions that the models are compared with."""
    return {
        "Henyey-Greenstein, g = 0.95": henyey_greenstein_function(asymmetry=0.95),
        "Petzold, harbour": petzold("NUC 2040"),
    }


def diffusion_arguments(
    phase_function: PhaseFunction, attenuation: float, split: float
) -> dict[str, Any]:
    """Return what the diffusion form needs of a water and its split angle [rad]."""
    scattering = (1 - ABSORBED) * attenuation
    share, moment = phase_function.forward_split(split)
    return {
        "absorption": ABSORBED * attenuation,
        "forward_scattering": share * scattering,
        "diffuse_scattering": (1 - share) * scattering,
        "second_moment": moment,
    }


def models(
    phase_function: PhaseFunction, attenuation: float, *, baseline: float, split: float
) -> tuple[Callable[[ArrayLike], Any], Callable[[ArrayLike], Any]]:
    """Return the water response by the diffusion and by the small-angle form."""
    scattering = (1 - ABSORBED) * attenuation
    diffusion = partial(
        small_angle_diffusion.water_response,
        **diffusion_arguments(phase_function, attenuation, split),
        **RECEIVER,
        baseline=baseline,
        backscatter_vsf=scattering * phase_function.at_180,
        group_index=INDEX,
    )
    whole = partial(
        small_angle.water_response,
        absorption=ABSORBED * attenuation,
        scattering=scattering,
        phase_function=phase_function,
        split_angle=split,
        **RECEIVER,
        baseline=baseline,
        group_index=INDEX,
    )
    return diffusion, whole


def model_ratio(attenuation: NDArray[np.float64]) -> Figure:
    """Draw the ratio of the two models against attenuation [1/m]."""
    with style():
        drawn = new_figure(6.6, 4.6)
        panels = drawn.subplots(2, 2, sharex=True, sharey="row")
        for column, (name, phase_function) in enumerate(waters().items()):
            for degrees, colour in (
                (90, COLOURS[1]),
                (30, COLOURS[4]),
                (10, COLOURS[0]),
            ):
                for baseline, dashes in BASELINES.items():
                    ratios = []
                    for k in attenuation:
                        pair = models(
                            phase_function,
                            float(k),
                            baseline=baseline,
                            split=np.radians(degrees),
                        )
                        still = [abs(model(0.0)) for model in pair]
                        corner = [
                            low_pass.cut_off(model, maximum_frequency=3e8)
                            for model in pair
                        ]
                        ratios.append((still[0] / still[1], corner[0] / corner[1]))
                    label = f"split {degrees}°, baseline {baseline:.2f} m"
                    for row, values in enumerate(np.transpose(ratios)):
                        panels[row, column].plot(
                            attenuation, values, color=colour, ls=dashes, label=label
                        )
            panels[0, column].set_title(name)
            panels[1, column].set_xlabel("attenuation k [1/m]")
        for axis in panels.flat:
            axis.set_xscale("log")
            axis.set_xticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
            axis.minorticks_off()
            axis.axhline(1, color="#777777", lw=0.6)
            axis.grid(True)
        panels[0, 0].set_ylabel("signal at 0 MHz,\ndiffusion / small-angle")
        panels[1, 0].set_ylabel("cut-off,\ndiffusion / small-angle")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        drawn.legend(handles, labels, loc="outside lower center", ncols=3)
    return drawn


def overlap(depth: NDArray[np.float64], *, attenuation: float = 0.5) -> Figure:
    """Draw what reaches the receiver from each depth [m], by both models."""
    phase_function = waters()["Henyey-Greenstein, g = 0.95"]
    scattering = (1 - ABSORBED) * attenuation
    with style():
        drawn = new_figure(6.6, 2.9)
        for axis, baseline in zip(
            drawn.subplots(1, 2, sharey=True), BASELINES, strict=True
        ):
            view = {**RECEIVER, "baseline": baseline}
            whole = small_angle.overlap(
                depth,
                absorption=ABSORBED * attenuation,
                scattering=scattering,
                phase_function=phase_function,
                split_angle=np.pi / 2,
                **view,
            )
            direct = small_angle_diffusion.overlap(
                depth,
                absorption=ABSORBED * attenuation,
                forward_scattering=0.0,
                diffuse_scattering=scattering,
                second_moment=0.0,
                **view,
            )
            axis.plot(
                depth, whole, color="black", lw=1.4, label="small-angle, split 90°"
            )
            axis.fill_between(
                depth, direct, 1e-12, color="#cccccc", lw=0, label="of it unscattered"
            )
            for degrees, colour, dashes in (
                (90, COLOURS[1], "--"),
                (10, COLOURS[0], "-."),
            ):
                values = small_angle_diffusion.overlap(
                    depth,
                    **diffusion_arguments(
                        phase_function, attenuation, np.radians(degrees)
                    ),
                    **view,
                )
                axis.plot(
                    depth,
                    values,
                    color=colour,
                    ls=dashes,
                    label=f"diffusion, split {degrees}°",
                )
            axis.set_yscale("log")
            axis.set_ylim(1e-7, 1e-3)
            axis.set_xlim(0, depth[-1])
            axis.set_xlabel("depth z [m]")
            axis.set_title(f"baseline {baseline:.2f} m")
            axis.grid(True)
            if baseline == min(BASELINES):
                axis.set_ylabel("F(z) [sr]")
                axis.legend()
    return drawn


def low_pass_curves(frequency: NDArray[np.float64]) -> Figure:
    """Draw the normalised response, its half-power point and the free fit."""
    view = {**RECEIVER, "baseline": 0.20, "group_index": INDEX, "backscatter_vsf": 1e-3}
    cases = {
        "simple, k = 0.5 1/m": (0.0, 0.0, 0.5, 0.0),
        "realistic, k = 0.5 1/m": (0.15, 0.35, 0.0, 0.05),
    }
    with style():
        drawn = new_figure(4.8, 3.2)
        axis = drawn.subplots()
        for (name, (a, b_f, b_d, moment)), colour, mark in zip(
            cases.items(), COLOURS[:2], ("o", "x"), strict=True
        ):
            response = partial(
                small_angle_diffusion.water_response,
                absorption=a,
                forward_scattering=b_f,
                diffuse_scattering=b_d,
                second_moment=moment,
                **view,
            )
            amplitude = abs(response(frequency)) / abs(response(0.0))
            sweep = np.linspace(0.5e6, 138e6, 200)
            half_power = low_pass.cut_off(response)
            fitted = low_pass.fit(sweep, abs(response(sweep)) / abs(response(0.0)))
            form = fitted.amplitude_at_zero * abs(
                low_pass.first_order_response(frequency, cut_off=fitted.cut_off)
            )
            axis.plot(frequency / 1e6, amplitude, color=colour, label=name)
            axis.plot(
                frequency / 1e6,
                form,
                color=colour,
                ls="--",
                label=f"fit of (71), {fitted.cut_off / 1e6:.1f} MHz",
            )
            axis.plot(
                half_power / 1e6,
                np.sqrt(0.5),
                mark,
                color=colour,
                ms=7,
                mfc="none",
                mew=1.4,
                ls="none",
                zorder=3,
                label=f"half power, {half_power / 1e6:.1f} MHz",
            )
        axis.axhline(np.sqrt(0.5), color="#777777", lw=0.6)
        axis.set_xlim(0, frequency[-1] / 1e6)
        axis.set_ylim(0, None)
        axis.set_xlabel("modulation frequency [MHz]")
        axis.set_ylabel("amplitude over that at 0 MHz")
        axis.grid(True)
        axis.legend()
    return drawn


def interference_sweep(frequency: NDArray[np.float64]) -> Figure:
    """Draw amplitude and contrast of two targets in turbid water."""
    view = {**RECEIVER, "baseline": 0.20}
    cases = {
        "k = 1.0 1/m, d = 3.9 m": (3.9, (0.30, 0.70, 0.06)),
        "k = 0.5 1/m, d = 5.6 m": (5.6, (0.15, 0.35, 0.05)),
    }
    with style():
        drawn = new_figure(6.6, 4.4)
        panels = drawn.subplots(2, 2, sharex=True, sharey="row")
        for column, (name, (distance, (a, b_f, moment))) in enumerate(cases.items()):
            medium = {
                "absorption": a,
                "forward_scattering": b_f,
                "diffuse_scattering": 0.0,
                "second_moment": moment,
            }
            water = small_angle_diffusion.water_response(
                frequency,
                **medium,
                **view,
                backscatter_vsf=0.003 * b_f,
                group_index=INDEX,
                end=distance,
            )
            echo = target_echo.target_response(
                frequency,
                depth=distance,
                optical_path=2 * distance * INDEX,
                reflectance=0.8,
                **medium,
                **view,
            )
            total = interference.total_signal(echo, water)
            scale = abs(echo[0])
            megahertz = frequency / 1e6
            top, bottom = panels[:, column]
            top.plot(megahertz, abs(total) / scale, color=COLOURS[0], label="together")
            top.plot(
                megahertz, abs(echo) / scale, color="black", ls="--", label="target"
            )
            top.plot(
                megahertz, abs(water) / scale, color=COLOURS[1], ls=":", label="water"
            )
            turns = extrema.find(frequency, abs(total))
            at = np.concatenate([turns.maxima, turns.minima])
            top.plot(
                at / 1e6,
                np.interp(at, frequency, abs(total) / scale),
                "o",
                color=COLOURS[0],
                ms=3.5,
            )
            top.set_title(name)
            contrast = interference.contrast(total, water)
            bottom.plot(megahertz, contrast, color=COLOURS[0], label="together")
            bottom.plot(
                megahertz,
                interference.contrast(echo, water),
                color="black",
                ls="--",
                label="target",
            )
            bottom.fill_between(
                megahertz, contrast, 0, where=contrast < 0, color="#999999", lw=0
            )
            bottom.axhline(0, color="#777777", lw=0.6)
            bottom.set_xlabel("modulation frequency [MHz]")
        panels[0, 0].set_ylabel("amplitude over that of the target")
        panels[1, 0].set_ylabel("contrast against the water [1]")
        panels[0, 0].set_xlim(0, frequency[-1] / 1e6)
        panels[0, 0].set_ylim(0, None)
        panels[0, 1].legend()
        for axis in panels.flat:
            axis.grid(True)
    return drawn


def polarization(angle: NDArray[np.float64]) -> Figure:
    """Draw the elements of the scattering matrix of molecules and of spheres."""
    sizes = np.linspace(100e-9, 900e-9, 41)
    spheres = partial(
        mie.size_distribution,
        wavelength=405e-9,
        particle_index=1.47,
        medium_index=1.343,
    )
    matrices = {
        "Rayleigh": mueller.rayleigh(angle),
        "spheres of 300 nm": spheres(300e-9, number=1e12).mueller(angle),
        "spheres of many sizes": spheres(
            sizes, number=1e12 * np.exp(-(((sizes - 300e-9) / 150e-9) ** 2))
        ).mueller(angle),
    }
    with style():
        drawn = new_figure(6.6, 2.8)
        panels = drawn.subplots(1, 3, sharey=True)
        elements = {
            "m12": ((0, 1), COLOURS[0], "-"),
            "m33 = m44": ((2, 2), COLOURS[1], "--"),
            "m34": ((2, 3), COLOURS[2], "-."),
        }
        for axis, (name, matrix) in zip(panels, matrices.items(), strict=True):
            for label, (place, colour, dashes) in elements.items():
                axis.plot(
                    np.degrees(angle),
                    matrix[(..., *place)],
                    color=colour,
                    ls=dashes,
                    label=label,
                )
            axis.set_title(name)
            axis.set_xlabel("scattering angle [degrees]")
            axis.set_xlim(0, 180)
            axis.set_xticks([0, 45, 90, 135, 180])
            axis.grid(True)
        panels[0].set_ylabel("element over m11 [1]")
        handles, labels = panels[0].get_legend_handles_labels()
        drawn.legend(handles, labels, loc="outside lower center", ncols=3)
    return drawn


FIGURES: dict[str, Callable[[], Figure]] = {
    "theory-overlap": lambda: overlap(np.linspace(1e-3, 8, 400)),
    "theory-low-pass": lambda: low_pass_curves(np.linspace(0, 138e6, 277)),
    "theory-model-ratio": lambda: model_ratio(np.geomspace(0.1, 2.0, 14)),
    "theory-interference": lambda: interference_sweep(np.linspace(0.5e6, 146e6, 1456)),
    "theory-polarization": lambda: polarization(np.radians(np.linspace(0, 180, 361))),
}


def main() -> None:
    """Draw all figures of the theory pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in FIGURES.items():
        (FOLDER / f"{name}.png").write_bytes(png(draw(), dots_per_inch=160))


if __name__ == "__main__":
    main()
