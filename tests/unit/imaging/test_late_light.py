"""Light scattered on its way is taken off the ranges where the water is described."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.optics import ranging
from amulor.optics.late_echo import late_echo
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.optics.phase_functions.tables import petzold
from amulor.simulation import simulate
from amulor.survey import Survey, water_properties
from amulor.survey.view import view


def measured(text: str) -> xr.Dataset:
    """Return a target signal as a measurement would be: nothing says "simulated"."""
    cube = rejection.open_water(simulate(Survey.from_text(text), rng=2))
    assert cube.attrs.pop("late_echo") == "absent"
    return cube.assign_attrs(simulated=np.int32(0))


@pytest.fixture(scope="module")
def haze(plate_text: str) -> str:
    """Return a survey whose water is a Henyey-Greenstein function."""
    old = 'forward_fraction = 1.0\nsecond_moment = "0.06 rad^2"\n'
    assert old in plate_text
    return plate_text.replace(old, "asymmetry = 0.95\n")


def seen(
    text: str, depth: np.ndarray, function: PhaseFunction | float, frequency: float
) -> np.ndarray:
    """Return the delay of each pixel, worked out without a table."""
    if isinstance(function, float):
        function = henyey_greenstein_function(asymmetry=function)
    made = Survey.from_text(text)
    water = water_properties(made)
    cube = simulate(made, rng=1)
    look = view(
        made,
        cube["azimuth"].values,
        cube["elevation"].values,
    )
    return late_echo(
        frequency,
        depth=depth,
        scattering=made.water.scattering,
        phase_function=function,
        group_index=water.group_index,
        baseline=look.baseline,
        receiver_radius=made.instrument.receiver.radius,
        acceptance_angle=look.acceptance,
        tilt=look.tilt,
        cross_tilt=look.cross_tilt,
    )


def test_the_delay_is_taken_off_and_its_uncertainty_is_a_term(haze: str) -> None:
    cube = measured(haze)
    plain = imaging.range_image(
        cube.assign_attrs(late_echo="absent"), polarization="VH"
    )
    image = imaging.range_image(cube, polarization="VH")
    assert image.attrs["late_echo_correction"] == "taken off"
    taken = (plain["slant_range"] - image["slant_range"]).values
    usable = np.isfinite(taken)
    assert usable.sum() > 50
    late = seen(haze, plain["slant_range"].fillna(1.5).values, 0.95, 39e6)
    # The table of a few directions is good for a hundredth.
    # Between that of the Henyey-Greenstein function and half of it.
    assert_allclose(taken[usable], 0.75 * late[usable], rtol=1e-2)
    assert_allclose(image["slant_range_late_echo"].values[usable], taken[usable])
    # 5 % of the formula, and half of the delay as a rectangle.
    wide = 0.5 / 0.75 / np.sqrt(12)
    term = image["slant_range_uncertainty_late_echo"].values
    assert_allclose(term[usable], np.hypot(0.05, wide) * taken[usable], rtol=1e-6)
    surer = haze + '[calibration]\nscattering_uncertainty = "40 %"\n'
    cube = cube.assign_attrs(survey=Survey.from_text(surer).to_toml())
    wider = imaging.range_image(cube, polarization="VH")
    assert_allclose(
        wider["slant_range_uncertainty_late_echo"].values[usable],
        np.sqrt(0.05**2 + wide**2 + 0.4**2) * taken[usable],
        rtol=1e-6,
    )
    # Spots of a window may be glossy: as uncertain as that scattering coefficient.
    cube = measured(haze).assign_attrs(phasor_line_window=np.int32(5))
    windows = imaging.range_image(cube, polarization="VH")
    term = windows["slant_range_uncertainty_late_echo"].values
    assert_allclose(
        term[usable], np.sqrt(0.05**2 + wide**2 + 0.4**2) * taken[usable], rtol=1e-6
    )


def test_a_stated_phase_function_has_one_delay(haze: str) -> None:
    text = haze.replace(
        "asymmetry = 0.95\n",
        'phase_function = { kind = "petzold", station = "NUC 2040" }\n',
    )
    image = imaging.range_image(measured(text), polarization="VH")
    usable = image["slant_range"].notnull().values
    depth = image["slant_range"].fillna(1.5).values
    late = seen(text, depth, petzold("NUC 2040"), 39e6)[usable]
    taken = image["slant_range_late_echo"].values[usable]
    assert_allclose(taken, late, rtol=0.01)
    term = image["slant_range_uncertainty_late_echo"].values[usable]
    assert_allclose(term, 0.05 * taken, rtol=1e-6)


def test_moments_alone_leave_a_rectangle_between_natural_waters(
    plate_text: str,
) -> None:
    image = imaging.range_image(measured(plate_text), polarization="VH")
    usable = image["slant_range"].notnull().values
    depth = image["slant_range"].fillna(1.5).values
    ends = [seen(plate_text, depth, g, 39e6)[usable] for g in (0.90, 0.98)]
    taken = image["slant_range_late_echo"].values[usable]
    term = image["slant_range_uncertainty_late_echo"].values[usable]
    # The moment of 0.06 rad^2 is that of an asymmetry between the two.
    assert_allclose(taken, (ends[0] + ends[1]) / 2, rtol=0.02)
    width = np.abs(ends[0] - ends[1]) / np.sqrt(12)
    assert_allclose(term, np.hypot(0.05 * taken, width), rtol=0.02)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("asymmetry = 0.95", "asymmetry = 0.3", "small angles do not describe"),
        ('radius = "2 cm"', 'azimuth = "70 deg"\nradius = "2 cm"', "off a beam"),
    ],
)
def test_what_the_theory_cannot_say_is_not_known(haze, old, new, why) -> None:
    cube = measured(haze)
    if "azimuth" in new:
        old, new = 'azimuth = "-2.672 deg"', 'azimuth = "70 deg"'
    assert old in haze
    text = Survey.from_text(haze.replace(old, new)).to_toml()
    image = imaging.range_image(cube.assign_attrs(survey=text), polarization="VH")
    assert image.attrs["uncertainty_unknown"].startswith("late_echo ")
    assert why in image.attrs["late_echo_correction"]
    assert "slant_range_late_echo" not in image
    plain = imaging.range_image(
        cube.assign_attrs(late_echo="absent"), polarization="VH"
    )
    assert_allclose(image["slant_range"], plain["slant_range"])


def test_late_light_put_into_a_cube_is_found_again(haze: str) -> None:
    """Turns the phases by the theory's own delay: the table must take it off again."""
    cube = measured(haze)
    truth = cube["truth_slant_range"].fillna(1.5).values
    late = 0.75 * seen(haze, truth, 0.95, 39e6)
    turn = np.exp(1j * late / ranging.range_per_phase(39e6, group_index=1.38))
    signal = cube.amulor.signal.values * turn
    delayed = cube.assign(
        in_phase=cube["in_phase"].copy(data=signal.real),
        quadrature=cube["quadrature"].copy(data=signal.imag),
    )
    plain = imaging.range_image(
        cube.assign_attrs(late_echo="absent"), polarization="VH"
    )
    image = imaging.range_image(delayed, polarization="VH")
    off = (image["slant_range"] - plain["slant_range"]).values
    usable = np.isfinite(off)
    # The way back to a receiver aside makes half a percent of the delay.
    assert np.abs(off[usable]).max() < 0.02 * late[usable].max()
