"""Photon transport beside measured slabs of foam: table, page and figure."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import matplotlib
import numpy as np
import pytest
import scripts
from scipy.constants import speed_of_light
from scipy.special import j1

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return scripts.script("docs/make_foam_images.py")


def test_transport_is_within_four_percent_of_the_measured_slabs(
    script: ModuleType,
) -> None:
    table = script.compared()
    deviation = script.deviation(table)
    assert deviation.size == 82
    assert np.sqrt(np.mean(deviation**2)) < 0.04
    # Photons that are too few would confirm everything.
    noise = table["amplitude_error"] / table["measured_amplitude"]
    assert np.sqrt(np.mean(noise**2)) < 0.025
    page = (DOCS / "how-to" / "import-transients.md").read_text(encoding="utf-8")
    assert script.summary(table) in " ".join(page.split())


def test_simulated_slabs_follow_diffusion_from_point_to_point(
    script: ModuleType,
) -> None:
    """A source one free path deep, between planes where the diffuse light vanishes.

    The authors' extrapolation length for the index 1.12 is 3.6 mm.
    """
    scattering, absorption, index, beyond = 262.0, 0.53, 1.12, 3.6e-3
    diffusion = 1 / (3 * (scattering + absorption))

    def light(thickness: float, frequency: float, radius: float = 0.0) -> complex:
        modulation = 2j * np.pi * frequency * index / speed_of_light
        wave = np.linspace(0, 60 / thickness, 6001)[1:]
        decay = np.sqrt(wave**2 + (absorption + modulation) / diffusion)
        passed = np.sinh(decay * (beyond + 1 / scattering)) * np.cosh(decay * beyond)
        passed = passed / np.sinh(decay * (thickness + 2 * beyond))
        disc = 1.0 if radius == 0 else 2 * j1(wave * radius) / (wave * radius)
        return complex(np.trapezoid(passed * wave * disc, wave))

    thick = [row for row in script.rows() if row.inch >= 3 and row.amplitude > 0.1]
    ratios, errors = [], []
    for row in thick:
        thickness = row.inch * 0.0254
        expected = light(thickness, 1e6 * row.mhz) / light(thickness, 0.0)
        ratios.append(row.amplitude / abs(expected) - 1)
        errors.append(row.amplitude_error / abs(expected))
    # Diffusion is good to a few percent; each difference has the noise of photons.
    assert np.all(np.abs(ratios) < 0.03 + 4 * np.array(errors))
    assert abs(np.median(ratios)) < 0.01

    def extrapolated(thickness: float, frequency: float) -> complex:
        inner, outer = script.INNER, script.OUTER
        near, whole = (
            light(thickness, frequency, share * thickness) for share in (inner, outer)
        )
        ring = (whole * outer**2 - near * inner**2) / (outer**2 - inner**2)
        return near + (near - ring) * inner**2 / outer**2

    for row in thick:
        thickness = row.inch * 0.0254
        point, estimate = (
            abs(form(thickness, 1e6 * row.mhz) / form(thickness, 0.0))
            for form in (light, extrapolated)
        )
        assert abs(estimate / point - 1) < 0.01


@pytest.mark.slow
def test_a_slab_of_the_table_comes_out_again(script: ModuleType) -> None:
    again = script.simulated(2, 200_000, seed=900)
    table = [row for row in script.rows() if row.inch == 2]
    for new, old in zip(again, table, strict=True):
        for name in ("amplitude", "phase"):
            error = np.hypot(
                getattr(new, f"{name}_error"), getattr(old, f"{name}_error")
            )
            assert abs(getattr(new, name) - getattr(old, name)) < 4 * error
    assert again[-1].amplitude_error < 0.05


def test_the_figure_shows_all_compared_amplitudes(script: ModuleType) -> None:
    matplotlib.use("agg")
    table = script.compared()
    above, _ = script.drawn(table).axes
    circles = [line for line in above.get_lines() if line.get_marker() == "o"]
    shown = np.concatenate([line.get_ydata() for line in circles])
    np.testing.assert_allclose(np.sort(shown), np.sort(table["measured_amplitude"]))
