"""Water retrieval: the coefficients come back, and what cannot be known is said."""

from __future__ import annotations

import numpy as np
import paper_form
import pytest
import xarray as xr
from scipy.integrate import quad

from amulor import simulate
from amulor.errors import CubeError
from amulor.optics import low_pass, small_angle, small_angle_diffusion
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.rejection.joint.water_fit import WaterFit, split_scattering, water_fit
from amulor.survey import Survey

# Water of Henyey and Greenstein, by integrals of their function: what goes below 90
# degrees, and its mean square angle.
ABSORPTION, SCATTERING, ASYMMETRY = 0.255, 0.595, 0.96


def below_90(power: int) -> float:
    """Return the integral of a power of the angle over the forward half."""
    g = ASYMMETRY

    def density(angle: float) -> float:
        value = (1 - g**2) / (1 + g**2 - 2 * g * np.cos(angle)) ** 1.5 / 2
        return float(value * np.sin(angle) * angle**power)

    return float(quad(density, 0, np.pi / 2, points=[0.05, 0.3])[0])


FRACTION = below_90(0)
MOMENT = below_90(2) / FRACTION
LOSS = ABSORPTION + SCATTERING * (1 - FRACTION)
SPREAD = SCATTERING * FRACTION * MOMENT
#: By the form of the paper the scattering of the survey is all forward.
PAPER_LOSS, PAPER_SPREAD = 0.255, 0.595 * 0.06


def swept(plate_text: str) -> str:
    """Return the plate survey with a sweep and one channel, in still water."""
    listed = ", ".join(f'"{f:g} MHz"' for f in np.linspace(4, 140, 12))
    text = plate_text.replace('["39 MHz"]', f"[{listed}]")
    text = text.replace('["VV", "VH"]', '["VV"]')
    return text.replace('signal_fluctuation = "5 %"', 'signal_fluctuation = "0.5 %"')


def of_one_function(text: str) -> str:
    """Return the same survey with the function above instead of moments."""
    for old, new in (
        ("forward_fraction = 1.0\n", f"asymmetry = {ASYMMETRY}\n"),
        ('second_moment = "0.06 rad^2"\n', ""),
        ('phase_function_at_180 = "0.001 1/sr"\n', ""),
    ):
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    return simulate(Survey.from_text(of_one_function(swept(plate_text))), rng=8)


@pytest.fixture(scope="module")
def paper_fit(plate_text: str) -> WaterFit:
    survey = Survey.from_text(swept(plate_text))
    return water_fit(paper_form.simulate(survey, rng=8))


@pytest.fixture(scope="module")
def fit(samples: xr.Dataset) -> WaterFit:
    return water_fit(samples)


def test_the_coefficients_come_back_within_their_errors(fit: WaterFit) -> None:
    # One draw each: 4 standard errors.
    error = fit.reduced_attenuation - LOSS
    assert abs(error) < 4 * fit.reduced_attenuation_uncertainty
    assert abs(fit.spread - SPREAD) < 4 * fit.spread_uncertainty
    off = fit.forward_scattering - SCATTERING * FRACTION
    assert abs(off) < 4 * fit.forward_scattering_uncertainty
    assert fit.reduced_attenuation_uncertainty < 0.05 * LOSS
    assert fit.fluctuation == pytest.approx(0.005, rel=0.3)


def test_what_follows_from_them_is_that_of_the_water(fit: WaterFit) -> None:
    seen = {
        "baseline": 0.07,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
        "tilt": np.tan(np.radians(2.672)),
    }
    water = seen | {
        "absorption": ABSORPTION,
        "scattering": SCATTERING,
        "phase_function": henyey_greenstein_function(asymmetry=ASYMMETRY),
        "split_angle": np.pi / 2,
    }
    corner = low_pass.cut_off(
        lambda f: small_angle.water_response(f, group_index=1.38, **water)
    )
    depth = np.linspace(0.01, 4, 4000)
    deepest = depth[np.argmax(small_angle.overlap(depth, **water))]
    # The model has the middle of the scan, where the baseline is turned a little: 1 %.
    assert fit.cut_off == pytest.approx(corner, rel=0.01)
    assert fit.depth_of_maximum == pytest.approx(deepest, rel=0.02)
    assert fit.cut_off_uncertainty < 0.02 * corner


def test_so_it_is_in_water_of_the_form_of_the_paper(paper_fit: WaterFit) -> None:
    error = paper_fit.reduced_attenuation - PAPER_LOSS
    assert abs(error) < 4 * paper_fit.reduced_attenuation_uncertainty
    assert abs(paper_fit.spread - PAPER_SPREAD) < 4 * paper_fit.spread_uncertainty
    water = {
        "absorption": PAPER_LOSS,
        "forward_scattering": PAPER_SPREAD,
        "diffuse_scattering": 0.0,
        "second_moment": 1.0,
        "baseline": 0.07,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
        "tilt": np.tan(np.radians(2.672)),
    }
    corner = low_pass.cut_off(
        lambda f: small_angle_diffusion.water_response(
            f, backscatter_vsf=1.0, group_index=1.38, **water
        )
    )
    assert paper_fit.cut_off == pytest.approx(corner, rel=0.01)


def test_what_the_signal_does_not_know_is_said(
    fit: WaterFit, paper_fit: WaterFit
) -> None:
    expected = {
        "strength VV": True,
        "reduced_attenuation": True,
        "spread": True,
        "forward_scattering": True,
    }
    assert dict(zip(fit.names, fit.identified, strict=True)) == expected
    # Water of the paper's form has no unscattered light, so nothing tells b_f alone.
    expected["forward_scattering"] = False
    assert dict(zip(paper_fit.names, paper_fit.identified, strict=True)) == expected
    worst = np.abs(paper_fit.direction[:, -1])
    assert paper_fit.names[int(np.argmax(worst))] == "forward_scattering"
    product = fit.direction @ fit.direction.T
    np.testing.assert_allclose(product, np.eye(4), atol=1e-9)


def test_a_known_phase_function_splits_absorption_and_scattering(
    fit: WaterFit,
) -> None:
    found = split_scattering(fit, second_moment=MOMENT, forward_fraction=FRACTION)
    assert abs(found.scattering - SCATTERING) < 4 * found.scattering_uncertainty
    assert abs(found.absorption - ABSORPTION) < 4 * found.absorption_uncertainty
    with pytest.raises(ValueError, match="forward_fraction"):
        split_scattering(fit, second_moment=0.06, forward_fraction=0.0)
    with pytest.raises(ValueError, match=r"second_moment must be above 0 rad\^2"):
        split_scattering(fit, second_moment=0.0, forward_fraction=1.0)


def test_a_scan_without_a_target_serves_as_well(plate_text: str) -> None:
    listed = ", ".join(f'"{f:g} MHz"' for f in np.linspace(4, 140, 8))
    head, rest = of_one_function(plate_text).split("[[targets]]")
    text = head + rest[rest.index("[instrument]") :]
    text = text.replace('["39 MHz"]', f"[{listed}]")
    text = text.split("[scan.open_water]")[0].replace('["VV", "VH"]', '["VV"]')
    cube = simulate(Survey.from_text(text), rng=2)
    found = water_fit(cube, no_target=True)
    error = found.reduced_attenuation - LOSS
    assert abs(error) < 4 * found.reduced_attenuation_uncertainty


def test_too_little_is_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="2 modulation frequencies"):
        water_fit(samples.isel(modulation_frequency=[0, 1]))
    bare = samples.drop_vars(
        [name for name in samples.data_vars if str(name).startswith("open_water_")]
    )
    with pytest.raises(CubeError, match="no open-water shots"):
        water_fit(bare)
