"""Figure of a calibration, with a panel for each part that was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.acquisition import Calibration
from amulor.io.files import atomic_output
from amulor.view.style import new_figure, style

Floats = NDArray[np.float64]


def write_calibration(
    path: Path, calibration: Calibration, *, overwrite: bool = False
) -> None:
    """Write the figure of a calibration as PNG."""
    with style(), atomic_output(path, overwrite=overwrite) as temporary:
        draw(calibration).savefig(temporary, format="png", dpi=160)


def draw(calibration: Calibration) -> Figure:
    """Draw leakage and phases with their standard uncertainties."""
    panels = []
    if any(entry.outputs for entry in calibration.demodulator):
        panels.append(_demodulator)
    if calibration.leakage:
        panels.append(_leakage)
    if calibration.channels:
        panels.append(_channels)
    if calibration.reference:
        panels.append(_reference)
    if calibration.temperature:
        panels.append(_temperature)
    if calibration.frequencies:
        panels.append(_by_frequency)
        if any(len(entry.phases) > 1 for entry in calibration.frequencies):
            panels.append(_by_amplitude)
    with style():
        figure = new_figure(3.2 * len(panels), 2.6)
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for panel, axis in zip(panels, axes, strict=True):
            panel(axis, calibration)
            axis.grid(True)
    return figure


def _demodulator(axis: Axes, calibration: Calibration) -> None:
    for entry in calibration.demodulator:
        if not entry.outputs:
            continue
        x, y = np.transpose(entry.outputs)
        angle, gain = entry.quadrature_phase, 1 + entry.quadrature_gain
        straight = (y / gain - x * np.sin(angle)) / np.cos(angle)
        size = np.hypot(x, straight)
        # Relative to the mean amplitude, so that deviations of 1 % are visible.
        phase = np.degrees(np.arctan2(straight, x)) % 360
        off = 100 * (np.hypot(x, y) / size.mean() - 1)
        name = f"{entry.modulation_frequency / 1e6:g} MHz"
        turn = np.radians(np.arange(361))
        fit = np.hypot(np.cos(turn), gain * np.sin(turn + angle))
        (line,) = axis.plot(np.degrees(turn), 100 * (fit - 1), label=name)
        axis.plot(phase, off, "o", color=line.get_color(), markersize=3)
    axis.set_title("Errors of the demodulator")
    axis.set_xlabel("phase [degrees]")
    axis.set_ylabel("excess of the amplitude [%]")
    axis.set_xticks([0, 90, 180, 270, 360])
    axis.legend()


def _leakage(axis: Axes, calibration: Calibration) -> None:
    channels = list(dict.fromkeys(leak.polarization for leak in calibration.leakage))
    for channel in channels:
        leaks = [leak for leak in calibration.leakage if leak.polarization == channel]
        frequency = [1e-6 * leak.modulation_frequency for leak in leaks]
        axis.errorbar(
            frequency,
            [1e6 * np.hypot(*leak.scan) for leak in leaks],
            yerr=[1e6 * leak.scan_uncertainty for leak in leaks],
            marker="o",
            markersize=3,
            capsize=2,
            label=channel,
        )
    axis.set_title("Leakage in the scan")
    axis.set_xlabel("modulation frequency [MHz]")
    axis.set_ylabel("amplitude [uV]")
    axis.set_ylim(bottom=0)
    axis.legend()


def _channels(axis: Axes, calibration: Calibration) -> None:
    names = list(dict.fromkeys(entry.polarization for entry in calibration.channels))
    axis.axhline(0, color="0.6", linewidth=0.8)
    for name in names:
        entries = [e for e in calibration.channels if e.polarization == name]
        first = entries[0]
        axis.errorbar(
            [1e-6 * entry.modulation_frequency for entry in entries],
            [1e3 * np.angle(complex(*entry.gain)) for entry in entries],
            yerr=[
                1e3 * entry.gain_uncertainty / np.hypot(*entry.gain)
                for entry in entries
            ],
            marker="o",
            markersize=3,
            capsize=2,
            label=f"{name}, cross-talk {100 * first.crosstalk:.2f}"
            f" ± {100 * first.crosstalk_uncertainty:.2f} %",
        )
    axis.set_title("Channels behind a turned polarizer")
    axis.set_xlabel("modulation frequency [MHz]")
    axis.set_ylabel(f"phase minus that of {names[0]} [mrad]")
    axis.legend()


def _reference(axis: Axes, calibration: Calibration) -> None:
    for entry in calibration.reference:
        change, error = 1e3 * np.array(entry.changes), 1e3 * entry.uncertainty
        minutes = np.array(entry.times) / 60
        name = f"{entry.modulation_frequency / 1e6:g} MHz {entry.polarization}"
        _draw_band(axis, minutes, change, error, label=name)
    axis.set_title("Drift of the standing reference")
    axis.set_xlabel("time [min]")
    axis.set_ylabel("phase minus middle [mrad]")
    axis.legend()


def _draw_band(
    axis: Axes, x: Floats, y: Floats, error: Floats | float, *, label: str
) -> str:
    """Draw a line within a band of its error; return the line's color."""
    (line,) = axis.plot(x, y, label=label)
    color = str(line.get_color())
    axis.fill_between(x, y - error, y + error, color=color, alpha=0.2)
    return color


def _temperature(axis: Axes, calibration: Calibration) -> None:
    reference = calibration.reference_temperature
    assert reference is not None
    for entry in calibration.temperature:
        warm = np.array(entry.temperatures)
        ends = np.linspace(warm.min(), warm.max(), 50)
        line = 1e3 * entry.phase_per_degree * (ends - reference)
        error = 1e3 * entry.uncertainty * np.abs(ends - reference)
        name = f"{entry.modulation_frequency / 1e6:g} MHz"
        color = _draw_band(axis, ends, line, error, label=name)
        axis.plot(warm, 1e3 * np.array(entry.phases), "o", color=color, markersize=3)
    axis.set_title("Phase against temperature")
    axis.set_xlabel("instrument temperature [degC]")
    axis.set_ylabel("phase minus that of the mean [mrad]")
    axis.legend()


def _by_frequency(axis: Axes, calibration: Calibration) -> None:
    entries = calibration.frequencies
    frequency = np.array([entry.modulation_frequency for entry in entries])
    # Each phase is that of the strongest signal, without whole turns.
    phase = np.unwrap([entry.phases[-1] for entry in entries])
    error = [
        entry.phase_uncertainties[-1] if entry.phase_uncertainties else 0.0
        for entry in entries
    ]
    slope = float(phase @ frequency / (frequency @ frequency))
    axis.errorbar(
        1e-6 * frequency,
        1e3 * (phase - slope * frequency),
        yerr=1e3 * np.array(error),
        marker="o",
        markersize=3,
        capsize=2,
    )
    axis.set_title(f"Phase without a delay of {1e9 * slope / (2 * np.pi):.3f} ns")
    axis.set_xlabel("modulation frequency [MHz]")
    axis.set_ylabel("phase [mrad]")


def _by_amplitude(axis: Axes, calibration: Calibration) -> None:
    for entry in calibration.frequencies:
        phases = np.array(entry.phases)
        errors = np.array(entry.phase_uncertainties or np.zeros(phases.size))
        axis.errorbar(
            1e3 * np.array(entry.amplitudes),
            1e3 * (phases - phases[-1]),
            yerr=1e3 * errors,
            marker="o",
            markersize=3,
            capsize=2,
            label=f"{entry.modulation_frequency / 1e6:g} MHz",
        )
    axis.set_xscale("log")
    axis.set_title("Phase against amplitude")
    axis.set_xlabel("amplitude [mV]")
    axis.set_ylabel("phase over that of the strongest [mrad]")
    axis.legend()
