"""Water retrieval: the coefficients come back, and what cannot be known is said."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from paper_form import simulate

from amulor.errors import CubeError
from amulor.optics import low_pass, small_angle_diffusion
from amulor.rejection.joint.water_fit import WaterFit, split_scattering, water_fit
from amulor.survey import Survey

# k' = a, since all scattering of the plate survey is forward: 0.255 1/m.
LOSS, SPREAD = 0.255, 0.595 * 0.06


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    listed = ", ".join(f'"{f:g} MHz"' for f in np.linspace(4, 140, 12))
    text = plate_text.replace('["39 MHz"]', f"[{listed}]")
    text = text.replace('["VV", "VH"]', '["VV"]')
    text = text.replace('signal_fluctuation = "5 %"', 'signal_fluctuation = "0.5 %"')
    return simulate(Survey.from_text(text), rng=8)


@pytest.fixture(scope="module")
def fit(samples: xr.Dataset) -> WaterFit:
    return water_fit(samples)


def test_the_coefficients_come_back_within_their_errors(fit: WaterFit) -> None:
    # One draw each: 4 standard errors.
    error = fit.reduced_attenuation - LOSS
    assert abs(error) < 4 * fit.reduced_attenuation_uncertainty
    assert abs(fit.spread - SPREAD) < 4 * fit.spread_uncertainty
    assert fit.reduced_attenuation_uncertainty < 0.05 * LOSS
    assert fit.fluctuation == pytest.approx(0.005, rel=0.3)


def test_what_follows_from_them_is_that_of_the_water(fit: WaterFit) -> None:
    water = {
        "absorption": LOSS,
        "forward_scattering": SPREAD,
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
    depth = np.linspace(0.01, 4, 4000)
    deepest = depth[np.argmax(small_angle_diffusion.overlap(depth, **water))]
    # The model has the middle of the scan, where the baseline is turned a little: 1 %.
    assert fit.cut_off == pytest.approx(corner, rel=0.01)
    assert fit.depth_of_maximum == pytest.approx(deepest, rel=0.02)
    assert fit.cut_off_uncertainty < 0.02 * corner


def test_what_the_signal_does_not_know_is_said(fit: WaterFit) -> None:
    known = dict(zip(fit.names, fit.identified, strict=True))
    # The simulated water has no unscattered light, so nothing tells b_f alone.
    assert known == {
        "strength VV": True,
        "reduced_attenuation": True,
        "spread": True,
        "forward_scattering": False,
    }
    worst = np.abs(fit.direction[:, -1])
    assert fit.names[int(np.argmax(worst))] == "forward_scattering"
    np.testing.assert_allclose(fit.direction @ fit.direction.T, np.eye(4), atol=1e-9)


def test_a_known_phase_function_splits_absorption_and_scattering(
    fit: WaterFit,
) -> None:
    found = split_scattering(fit, second_moment=0.06, forward_fraction=1.0)
    assert abs(found.scattering - 0.595) < 4 * found.scattering_uncertainty
    assert abs(found.absorption - 0.255) < 4 * found.absorption_uncertainty
    with pytest.raises(ValueError, match="forward_fraction"):
        split_scattering(fit, second_moment=0.06, forward_fraction=0.0)
    with pytest.raises(ValueError, match=r"second_moment must be above 0 rad\^2"):
        split_scattering(fit, second_moment=0.0, forward_fraction=1.0)


def test_a_scan_without_a_target_serves_as_well(plate_text: str) -> None:
    listed = ", ".join(f'"{f:g} MHz"' for f in np.linspace(4, 140, 8))
    head, rest = plate_text.split("[[targets]]")
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
