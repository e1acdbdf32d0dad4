"""Figures of a calibration and of a patch test: numbers as in the files."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from amulor.acquisition import Calibration
from amulor.imaging.patch_test import PatchTest, Undetermined
from amulor.platform import Mounting
from amulor.view import calibration as calibration_figure
from amulor.view import patch_test as patch_test_figure

CHANGES = np.array([-0.002, 0.0, 0.003])
PHASE = np.radians(np.arange(0, 360, 45))
GAIN, ANGLE = 0.04, 0.03
#: The phase at which the amplitude is 1 % larger.
LARGER = np.arange(8) == 2


def _outputs() -> list[tuple[float, float]]:
    """Outputs of a demodulator with errors, 1 % above the mean at one phase [V]."""
    size = 0.2 * np.where(LARGER, 1.01, 1.0)
    x, q = size * np.cos(PHASE), size * np.sin(PHASE)
    y = (1 + GAIN) * (q * np.cos(ANGLE) + x * np.sin(ANGLE))
    return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]


@pytest.fixture(scope="module")
def panels() -> dict[str, Axes]:
    """Panels of a calibration with all parts, by title."""
    calibration = Calibration.model_validate(
        {
            "demodulator": [
                {
                    "modulation_frequency": 40e6, "offset": (0.0, 0.0),
                    "offset_uncertainty": 1e-6, "quadrature_gain": GAIN,
                    "quadrature_phase": ANGLE, "outputs": _outputs(),
                },
                {
                    "modulation_frequency": 50e6, "offset": (0.0, 0.0),
                    "offset_uncertainty": 1e-6,
                },
            ],
            "leakage": [
                {
                    "modulation_frequency": 1e6 * frequency, "polarization": channel,
                    "scan": (3e-6 * size, 4e-6 * size), "scan_uncertainty": 2e-7 * size,
                    "open_water": (0.0, 0.0), "open_water_uncertainty": 0.0,
                }
                for channel, frequency, size in
                (("VV", 40, 1), ("VV", 60, 2), ("VH", 40, 3))
            ],
            "channels": [
                {
                    "modulation_frequency": 1e6 * frequency, "polarization": channel,
                    "gain": (size * np.cos(phase), size * np.sin(phase)),
                    "gain_uncertainty": 0.01, "crosstalk": 0.02,
                    "crosstalk_uncertainty": 0.003,
                }
                for channel, frequency, size, phase in
                (("VV", 40, 1, 0.0), ("VH", 40, 2, 0.05), ("VH", 60, 4, -0.02))
            ],
            "reference": [
                {
                    "modulation_frequency": 40e6, "polarization": "VV", "phase": 0.5,
                    "uncertainty": 1e-3, "times": (0.0, 60.0, 300.0),
                    "changes": tuple(CHANGES),
                }
            ],
            "temperature": [
                {
                    "modulation_frequency": 40e6, "phase_per_degree": 0.002,
                    "uncertainty": 1e-4, "temperatures": (15.0, 20.0, 35.0),
                    "phases": (-0.011, 0.0, 0.029),
                }
            ],
            "reference_temperature": 20.0,
            "frequencies": [
                {
                    "modulation_frequency": 40e6, "amplitudes": (1e-3, 1e-2),
                    "phases": (0.41, 0.4), "phase_uncertainties": (0.002, 0.001),
                },
                {
                    "modulation_frequency": 60e6, "amplitudes": (1e-3, 1e-2),
                    "phases": (0.63, 0.62), "phase_uncertainties": (0.004, 0.003),
                },
            ],
        }
    )  # fmt: skip
    axes = calibration_figure.draw(calibration).axes
    return {axis.get_title("left").partition(" of ")[0]: axis for axis in axes}


def _bars(axis: Axes) -> dict[str, np.ndarray]:
    """Return x, y and error of each series with error bars, by label."""
    series = {}
    for container in axis.containers:
        line, _, (bars,) = container
        low, high = np.array([part[:, 1] for part in bars.get_segments()]).T
        x, y = line.get_xydata().T
        series[container.get_label()] = np.array([x, y, (high - low) / 2])
    return series


def test_each_panel_has_units_and_a_legend_of_its_series(panels) -> None:
    assert list(panels) == [
        "Errors", "Leakage in the scan", "Channels behind a turned polarizer",
        "Drift", "Phase against temperature", "Phase without a delay",
        "Phase against amplitude",
    ]  # fmt: skip
    for axis in panels.values():
        for label in (axis.get_xlabel(), axis.get_ylabel()):
            assert re.fullmatch(r"[a-z ,/]+(VV)? ?\[(%|degrees|[numk]?\w+)\]", label)
        shown = axis.get_legend()
        labels = [text.get_text() for text in shown.texts] if shown else []
        assert labels == axis.get_legend_handles_labels()[1]
        assert any(line.get_visible() for line in axis.get_xgridlines())


def test_leakage_is_drawn_in_microvolts(panels) -> None:
    # 3 and 4 uV have a sum of squares of 25.
    series = _bars(panels["Leakage in the scan"])
    assert_allclose(series["VV"], [[40, 60], [5, 10], [0.2, 0.4]])
    assert_allclose(series["VH"], [[40], [15], [0.6]])
    assert panels["Leakage in the scan"].get_ylim()[0] == 0


def test_channels_are_drawn_by_phase_with_their_cross_talk(panels) -> None:
    axis = panels["Channels behind a turned polarizer"]
    series = _bars(axis)
    name = "{}, cross-talk 2.00 ± 0.30 %"
    assert_allclose(series[name.format("VV")], [[40], [0], [10]], atol=1e-9)
    assert_allclose(series[name.format("VH")], [[40, 60], [50, -20], [5, 2.5]])
    assert axis.get_ylabel() == "phase minus that of VV [mrad]"


def test_the_reference_is_drawn_over_minutes_with_its_error(panels) -> None:
    axis = panels["Drift"]
    (line,) = axis.lines
    assert line.get_label() == "40 MHz VV"
    assert_allclose(line.get_xydata().T, [[0, 1, 5], 1e3 * CHANGES])
    (band,) = axis.collections
    ends = band.get_paths()[0].vertices
    assert_allclose([ends[:, 1].min(), ends[:, 1].max()], [-3, 4])


def test_phases_are_drawn_against_temperature(panels) -> None:
    axis = panels["Phase against temperature"]
    fit, points = axis.lines
    assert_allclose(points.get_xydata().T, [[15, 20, 35], [-11, 0, 29]])
    x, y = fit.get_data()
    assert_allclose([x[0], x[-1]], [15, 35])
    assert_allclose(y, 2 * (x - 20), atol=1e-9)
    (band,) = axis.collections
    ends = band.get_paths()[0].vertices
    # 0.1 mrad a degree beside 2 mrad, 5 degrees below and 15 above.
    assert_allclose([ends[:, 1].min(), ends[:, 1].max()], [-10.5, 31.5])


def test_phases_are_drawn_without_their_mean_delay(panels) -> None:
    axis = panels["Phase without a delay"]
    ((_, (x, y, error)),) = _bars(axis).items()
    # Least squares through 0: (0.4 * 40 + 0.62 * 60) / (40^2 + 60^2) rad a MHz.
    slope = (0.4 * 40 + 0.62 * 60) / 5200
    assert_allclose(x, [40, 60])
    assert_allclose(y, [400 - 4e4 * slope, 620 - 6e4 * slope])
    assert_allclose(error, [1, 3])
    nanoseconds = 1e3 * slope / (2 * np.pi)
    assert axis.get_title("left") == f"Phase without a delay of {nanoseconds:.3f} ns"


def test_phases_are_drawn_against_amplitude(panels) -> None:
    axis = panels["Phase against amplitude"]
    series = _bars(axis)
    assert_allclose(series["40 MHz"], [[1, 10], [10, 0], [2, 1]], atol=1e-9)
    assert_allclose(series["60 MHz"], [[1, 10], [10, 0], [4, 3]], atol=1e-9)
    assert axis.get_xscale() == "log"


def test_outputs_of_a_demodulator_are_drawn_beside_its_ellipse(panels) -> None:
    axis = panels["Errors"]
    fit, points = axis.lines
    assert fit.get_label() == "40 MHz"
    mean = (7 + 1.01) / 8
    size = np.where(LARGER, 1.01, 1.0) / mean
    x, q = size * np.cos(PHASE), size * np.sin(PHASE)
    y = (1 + GAIN) * (q * np.cos(ANGLE) + x * np.sin(ANGLE))
    degrees, excess = points.get_data()
    assert_allclose(degrees, np.degrees(PHASE), atol=1e-9)
    assert_allclose(excess, 100 * (np.hypot(x, y) - 1), atol=1e-9)
    degrees, excess = fit.get_data()
    assert_allclose(degrees, np.arange(361))
    turn = np.radians(degrees)
    ellipse = np.hypot(np.cos(turn), (1 + GAIN) * np.sin(turn + ANGLE))
    assert_allclose(excess, 100 * (ellipse - 1), atol=1e-9)
    assert list(axis.get_xticks()) == [0, 90, 180, 270, 360]


@pytest.fixture(scope="module")
def patches() -> Figure:
    """Figure of a patch test without an error of the clock drift before."""
    place = np.array([[0.0, 1.0, -5.0], [2.0, 3.0, -5.0], [4.0, 5.0, -6.0]])
    before = np.array([0.5, 0.5, 0.5, 0.1, 0.2, 0.4, 0.01, 0.0])
    share = np.array([0.1, 0.2, 0.5, 0.01, 0.05, 0.4, 0.9, 0.0])
    loose = Undetermined(
        quantity="clock offset", uncertainty=0.009, start_uncertainty=0.01, line="",
        with_line=0.009,
    )  # fmt: skip
    result = PatchTest(
        mounting=Mounting(), start=Mounting(), change=np.zeros(8),
        covariance=np.diag((share * before) ** 2), start_uncertainty=before,
        undetermined=(loose,),
        points=100, misfit=1.0, position_walk=0.0, attitude_walk=0.0,
        before=(place, np.array([1e-3, 2e-3, 5e-3])),
        after=(place, np.array([1e-4, 3e-4, 4e-4])),
    )  # fmt: skip
    return patch_test_figure.draw(result)


def test_distances_of_lines_are_drawn_in_plan(patches: Figure) -> None:
    before, after = patches.axes[:2]
    assert before.get_title("left") == "Before: median 2 mm"
    assert after.get_title("left") == "After: median 0.3 mm"
    for axis, expected in ((before, [1, 2, 5]), (after, [0.1, 0.3, 0.4])):
        (points,) = axis.collections
        assert_allclose(points.get_offsets(), [[0, 1], [2, 3], [4, 5]])
        assert_allclose(points.get_array(), expected)
        # Between the second and the third: numpy's quantile is linear.
        high = expected[1] + 0.9 * (expected[2] - expected[1])
        assert_allclose(points.get_clim(), [0, high])
        assert axis.get_xlabel() == "east [m]"
        assert axis.get_aspect() == 1
    assert before.get_ylabel() == "north [m]"
    labels = [axis.get_ylabel() + axis.get_xlabel() for axis in patches.axes]
    assert labels.count("rms distance of lines [mm]") == 2


def test_uncertainties_are_drawn_as_shares_of_those_before(patches: Figure) -> None:
    (axis,) = [each for each in patches.axes if each.get_title("left") == "Mounting"]
    bars = {
        text.get_text(): bar
        for text, bar in zip(
            axis.get_yticklabels(), axis.patches, strict=True
        )
    }  # fmt: skip
    assert {name: round(bar.get_width(), 9) for name, bar in bars.items()} == {
        "lever arm right": 10, "lever arm down": 20, "lever arm forward": 50,
        "about right": 1, "about down": 5, "about forward": 40, "clock offset": 90,
    }  # fmt: skip
    heights = [bar.get_y() for bar in bars.values()]
    assert heights == sorted(heights, reverse=True)
    # Of another color: the one that the lines do not determine.
    colors = {name: bar.get_facecolor() for name, bar in bars.items()}
    other = colors.pop("clock offset")
    assert len(set(colors.values())) == 1
    assert other not in colors.values()
    (half,) = axis.lines
    assert_allclose(half.get_xdata(), 50)
    assert_allclose(axis.get_xlim(), [0.7, 120])
    assert (axis.get_xscale(), axis.get_xlabel()) == ("log", "uncertainty / before [%]")
    lines = axis.get_xgridlines(), axis.get_ygridlines()
    assert [lines[0][0].get_visible(), lines[1][0].get_visible()] == [True, False]
