"""Numbers that follow from a survey: rates, views, tracks, and arguments of models."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.optics import detection
from amulor.optics.phase_functions.models import isotropic
from amulor.survey import Survey, course, late_light, reach, view, water_properties
from amulor.survey.counting import (
    background_rate,
    counting_variance,
    full_rate,
    integration_time,
    photon_noise_volt,
    reference_variance,
)
from amulor.survey.course import planned_track
from amulor.survey.late_light import late_echo_delay, states_asymmetry_only
from amulor.survey.waters import whole_function

#: Planck's constant times the speed of light [J m].
HC = 6.62607015e-34 * 299_792_458.0


def test_all_launched_light_makes_a_rate_of_electrons(plate: Survey) -> None:
    """Power over the energy of a photon, times transmission and efficiency."""
    survey = plate.with_(
        {
            "instrument.power": 0.02, "instrument.wavelength": 450e-9,
            "instrument.detector.optical_transmission": 0.5,
            "instrument.detector.quantum_efficiency": 0.2,
        }
    )  # fmt: skip
    expected = 0.02 * 450e-9 / HC * 0.5 * 0.2
    assert full_rate(survey) == pytest.approx(expected, rel=1e-6)


def test_daylight_is_halved_by_an_analyzer(plate: Survey) -> None:
    """Radiance, bandwidth, aperture and field of view, after a depth of water."""
    light = {
        "radiance": 2e7, "bandwidth": 1e-8, "depth": 5.0, "diffuse_attenuation": 0.2
    }  # fmt: skip
    survey = plate.with_({"daylight": light, "instrument.polarizations": ["VV", "VH"]})
    bare = plate.with_({"daylight": light, "instrument.polarizations": ["none"]})
    receiver, detector = survey.instrument.receiver, survey.instrument.detector
    power = (
        2e7 * math.exp(-5.0 * 0.2) * 1e-8
        * np.pi * receiver.radius**2 * np.pi * receiver.acceptance**2
        * detector.optical_transmission
    )  # fmt: skip
    rate = power * survey.instrument.wavelength / HC * detector.quantum_efficiency
    assert background_rate(bare) == pytest.approx([rate], rel=1e-6)
    assert background_rate(survey) == pytest.approx([rate / 2, rate / 2], rel=1e-6)
    dark = background_rate(survey.with_({"daylight": None}))
    assert dark.tolist() == [0.0, 0.0]


def test_counting_noise_is_in_volts(plate: Survey) -> None:
    """The variance of a rate times the square of volts per rate."""
    survey = plate.with_(
        {
            "instrument.detector.volt_per_photoelectron_rate": 2e-12,
            "instrument.detector.dark_rate": 5e3,
            "instrument.detector.excess_noise_factor": 1.5,
        }
    )
    rates = np.array([1e6, 4e6])
    found = counting_variance(survey, rate=rates, integration_time=0.25)
    expected = detection.quadrature_variance(
        rates, integration_time=0.25, excess_noise_factor=1.5, dark_rate=5e3
    )
    assert_allclose(found, 4e-24 * expected)
    # Twice the time has half of the variance.
    half = counting_variance(survey, rate=rates, integration_time=0.5)
    assert_allclose(half, found / 2)
    time = integration_time(survey)
    assert 0 < time < survey.scan.dwell
    volt = photon_noise_volt(survey)
    assert volt == pytest.approx(
        float(detection.photon_noise(time, volt_per_photoelectron_rate=2e-12))
    )


def test_readings_of_a_standing_reference_are_averaged(plate: Survey) -> None:
    """The rate is that of its mean light, which the modulation depth tells."""
    reference = {"azimuth": 0.2, "elevation": 0.0, "amplitude": 0.02, "readings": 3}
    survey = plate.with_({"scan.reference": reference})
    instrument = survey.instrument
    volt = instrument.detector.volt_per_photoelectron_rate
    rate = 0.02 / (instrument.modulation_depth * volt)
    expected = counting_variance(
        survey, rate=rate, integration_time=3 * integration_time(survey)
    )
    assert reference_variance(survey) == pytest.approx(float(expected))


def test_only_beams_with_a_width_have_arguments(plate: Survey) -> None:
    """Behind a window the divergence is that in the water."""
    water = water_properties(plate)
    assert view.beam_arguments(plate, water) == {}
    wide = {"instrument.emitter.beam_radius": 2e-3}
    assert view.beam_arguments(plate.with_(wide), water) == {"beam_radius": 2e-3}
    wide["instrument.emitter.beam_divergence"] = 1e-3
    both = plate.with_(wide)
    assert view.beam_arguments(both, water) == {
        "beam_radius": 2e-3, "beam_divergence": 1e-3
    }  # fmt: skip
    window = {"instrument.window": {"distance": 0.2, "thickness": 0.01}}
    behind = view.beam_arguments(both.with_(window), water)
    assert behind["beam_divergence"] == pytest.approx(1e-3 / water.refractive_index)
    # Receiver and beam together: root sums of squares.
    radius = plate.instrument.receiver.radius
    assert view.widths_together(both, water, 3e-3) == pytest.approx(
        (math.hypot(radius, 2e-3), math.hypot(3e-3, 1e-3))
    )
    assert view.widths_together(plate, water, 3e-3) == pytest.approx((radius, 3e-3))


def test_models_refuse_layers_wide_beams_and_sharp_edges(plate: Survey) -> None:
    """All parts that a model does not know are named."""
    water = water_properties(plate)
    view.refuse_layers(water, model="it")
    layered = replace(water, layers=(1,))  # type: ignore[arg-type]
    with pytest.raises(
        SurveyError, match=r"^water\.layers: it knows uniform water only"
    ):
        view.refuse_layers(layered, model="it")
    view.refuse_beam_and_edges(plate, model="it")
    parts = {
        "instrument.emitter.beam_radius": 2e-3,
        "instrument.emitter.beam_divergence": 1e-3,
        "instrument.receiver.edge": "sharp",
    }
    names = ["emitter.beam_radius", "emitter.beam_divergence",
             'receiver.edge = "sharp"']  # fmt: skip
    for (field, value), name in zip(parts.items(), names, strict=True):
        words = f"and Gaussian receivers only, found {name}; use the small-angle model"
        with pytest.raises(SurveyError, match=words):
            view.refuse_beam_and_edges(plate.with_({field: value}), model="it")
    with pytest.raises(SurveyError, match=f"found {', '.join(names)}; use"):
        view.refuse_beam_and_edges(plate.with_(parts), model="it")
    assert view.has_sharp_receiver(plate.with_(parts))
    assert not view.has_sharp_receiver(plate)


def test_a_cube_has_indices_positions_and_window(plate: Survey) -> None:
    """Without a window there is nothing of it."""
    survey = plate.with_(
        {
            "water.group_index": 1.36, "water.refractive_index": 1.34,
            "instrument.emitter.position": [0.01, 0.02, 0.03],
            "instrument.receiver.position": [0.07, 0.05, 0.06],
        }
    )  # fmt: skip
    found = view.geometry_attributes(survey)
    positions = {name: found.pop(f"{name}_position").tolist() for name in
                 ("emitter", "receiver")}  # fmt: skip
    assert positions == {"emitter": [0.01, 0.02, 0.03], "receiver": [0.07, 0.05, 0.06]}
    assert found == {"group_index": 1.36, "refractive_index": 1.34}
    window = {
        "distance": 0.2, "thickness": 0.01, "refractive_index": 1.5, "group_index": 1.6
    }  # fmt: skip
    more = view.geometry_attributes(survey.with_({"instrument.window": window}))
    assert {name: more[name] for name in more if name.startswith("window")} == {
        "window_distance": 0.2, "window_thickness": 0.01,
        "window_refractive_index": 1.5, "window_group_index": 1.6,
    }  # fmt: skip


def test_a_window_takes_light_at_both_faces_both_ways(plate: Survey) -> None:
    """Straight through, Fresnel: 4 n m / (n + m)^2 at each face."""
    window = {
        "distance": 0.2, "thickness": 0.01, "refractive_index": 1.5,
        "reflection_loss": True,
    }  # fmt: skip
    straight = plate.with_(
        {
            "instrument.window": window, "water.refractive_index": 1.34,
            "instrument.receiver.azimuth": 0.0, "instrument.receiver.elevation": 0.0,
            "scan.moves": "beam",
        }
    )  # fmt: skip
    zero = np.zeros(1)
    face = 4 * 1.5 / 2.5**2 * 4 * 1.5 * 1.34 / (1.5 + 1.34) ** 2
    assert view.view(straight, zero, zero).transmission == pytest.approx([face**2])
    slant = view.view(straight, np.array([0.5]), zero).transmission
    assert slant[0] != pytest.approx(face**2, abs=1e-6)
    none = straight.with_({"instrument.window.reflection_loss": None})
    assert view.view(none, zero, zero).transmission.tolist() == [1.0]
    assert view.view(plate, zero, zero).transmission.tolist() == [1.0]


def test_a_receiver_turns_with_the_beam_or_stays(plate: Survey) -> None:
    """If both move, the receiver turns by the angles from the middle of the scan."""
    angles = {
        "instrument.receiver.azimuth": -0.05, "instrument.receiver.elevation": 0.02,
        "scan.azimuth": 0.1, "scan.elevation": -0.03,
    }  # fmt: skip
    azimuth, elevation = np.array([0.1, 0.2]), np.array([-0.03, 0.01])

    def axis(moves: str) -> tuple[Any, Any]:
        survey = plate.with_(angles | {"scan.moves": moves})
        found = view._axis(survey, azimuth, elevation)
        return np.arctan2(found[:, 0], found[:, 2]), -np.arcsin(found[:, 1])

    assert_allclose(axis("beam")[0], [-0.05, -0.05], atol=1e-12)
    assert_allclose(axis("beam")[1], [0.02, 0.02], atol=1e-12)
    assert_allclose(axis("both")[0], [-0.05, 0.05], atol=1e-12)
    assert_allclose(axis("both")[1], [0.02, 0.06], atol=1e-12)


def moving(plate: Survey, **changes: Any) -> Survey:
    """Return a survey from a vehicle that goes north at 0.5 m/s."""
    line = {"kind": "line", "start": [1.0, 2.0, -8.0], "heading": 0.0, "speed": 0.5}
    platform = {"course": line, **changes}
    return plate.with_({"platform": platform, "scan.columns": 4, "scan.rows": 2})


def test_a_track_has_the_current(plate: Survey) -> None:
    """A current to the east at 1.2 m/s makes 1.3 m/s of 0.5 m/s to the north."""
    still = moving(plate)
    track, duration = planned_track(still)
    scan, instrument = still.scan, still.instrument
    samples = len(instrument.modulation_frequencies) * len(instrument.polarizations)
    assert duration == pytest.approx(8 * samples * scan.dwell)
    assert track == pytest.approx(0.5 * duration)
    drifting = moving(plate, disturbance={"current": [1.2, 0.0, 0.0]})
    assert planned_track(drifting)[0] == pytest.approx(1.3 * duration)


def test_axes_of_targets_are_those_of_the_pose(plate: Survey) -> None:
    """A survey that looks east from (10, 20, -8): right is south, down is down."""
    posed = plate.with_(
        {"pose": {"position": [10.0, 20.0, -8.0], "heading": np.pi / 2}}
    )
    origin, axes = course.scene_axes(posed)
    assert origin.tolist() == [10.0, 20.0, -8.0]
    assert_allclose(axes @ [0, 0, 1], [1, 0, 0], atol=1e-12)
    assert_allclose(axes @ [1, 0, 0], [0, -1, 0], atol=1e-12)
    place, turn = course.in_scene(posed, np.array([[13.0, 19.0, -9.0]]), axes[None])
    assert_allclose(place, [[1.0, 1.0, 3.0]], atol=1e-12)
    assert_allclose(turn, np.eye(3)[None], atol=1e-12)


def test_a_boresight_turns_the_instrument_about_its_own_axes(plate: Survey) -> None:
    """A turn about down by 0.1 rad makes forward go to the right."""
    turned: Any = course.Mounting(boresight=(0.0, 0.1, 0.0))
    assert_allclose(course.boresight_of(course.Mounting()), np.eye(3), atol=1e-12)
    forward = course.boresight_of(turned) @ [0, 0, 1]
    assert_allclose(forward, [np.sin(0.1), 0, np.cos(0.1)], atol=1e-12)
    # Looking straight down, the instrument's forward is the vehicle's down.
    down = course.boresight_of(course.Mounting(pitch=-np.pi / 2))
    assert_allclose(down @ [0, 0, 1], [0, 1, 0], atol=1e-12)


def test_beams_of_a_vehicle_start_along_its_course(plate: Survey) -> None:
    """Of 33 places the first is the start, and the last is the end of the scan."""
    survey = moving(plate)
    placed = list(reach._placed_beams(survey))
    assert len(placed) == 33
    _, duration = planned_track(survey)
    starts = np.array([beam.entry.reshape(-1, 3)[0] for beam in placed])
    # In the axes of the targets, which are those of a level pose at the origin.
    assert_allclose(np.linalg.norm(starts[-1] - starts[0]), 0.5 * duration, rtol=1e-6)
    steps = np.linalg.norm(np.diff(starts, axis=0), axis=1)
    assert_allclose(steps, steps[0])
    (alone,) = reach._placed_beams(plate)
    assert alone.direction.shape[-1] == 3


def test_reasons_of_ambiguous_ranges_are_named(plate: Survey, monkeypatch) -> None:
    """A reach of one interval is ambiguous, a smaller one is not."""
    survey = plate.with_({"water.group_index": 1.5})
    # c / (2 n f) is 1 m.
    frequency = 299_792_458.0 / 3.0
    asked = {"modulation_frequency": frequency}
    reason = reach.unsettled_interval
    assert reason(None, **asked) == "nothing says how far the targets are"
    monkeypatch.setattr(reach, "target_reach", lambda survey: None)
    words = "the survey does not say how far the targets are"
    assert reason(survey, **asked) == words
    for far, found in ((0.99, ""), (1.01, "x")):
        monkeypatch.setattr(reach, "target_reach", lambda survey, far=far: (0.5, far))
        text = reason(survey, **asked)
        assert bool(text) == bool(found)
    assert text == (
        "the phases repeat after 1 m, and the targets of the survey are 0.5 to 1.01 m "
        "away"
    )

    def fail(survey: Survey) -> None:
        raise SurveyError("no index")

    monkeypatch.setattr(reach, "target_reach", fail)
    assert reason(survey, **asked) == "nothing says how far the targets are (no index)"


def test_a_mean_cosine_alone_states_no_shape(plate: Survey) -> None:
    """Neither as an asymmetry, nor as a function of Henyey and Greenstein."""
    coefficients = {"absorption": 0.1, "scattering": 0.4}

    def alone(**water: Any) -> bool:
        return states_asymmetry_only(plate.with_({"water": coefficients | water}))

    assert alone(asymmetry=0.9)
    assert alone(phase_function={"kind": "henyey-greenstein", "asymmetry": 0.9})
    assert not alone(phase_function={"kind": "rayleigh"})
    assert not states_asymmetry_only(plate.with_({"water": {"kind": "pure"}}))


def test_late_light_needs_small_angles(plate: Survey) -> None:
    """An asymmetry of 0.6 is the least; delays grow with the scattering."""
    water = water_properties(plate)
    zero = np.zeros(2)
    geometry = view.view(plate, zero, zero)
    frequency, depth = np.array([2e7, 4e7]), np.array([1.0, 2.0, 3.0])
    for asymmetry, fits in ((0.59, False), (0.61, True)):
        function: Any = SimpleNamespace(asymmetry=asymmetry)
        words = (plate, frequency, depth, geometry, water, function)
        if not fits:
            with pytest.raises(
                SurveyError, match=r"of the water, 0\.59, is below 0\.6, "
            ):
                late_light._arguments(*words)
            continue
        found = late_light._arguments(*words)
        # Frequencies, two directions, and depths.
        assert found["modulation_frequency"].shape == (2, 1, 1)
        for name in ("baseline", "tilt", "cross_tilt", "standoff"):
            assert found[name].shape == (2, 1), name
        assert found["scattering"] == water.scattering
        assert found["absorption"] == water.absorption
        assert found["group_index"] == water.group_index
        assert found["receiver_radius"] == plate.instrument.receiver.radius
        assert found["acceptance_angle"] == geometry.acceptance


def test_delays_of_late_light_may_have_another_scattering(plate, monkeypatch) -> None:
    """A sharp receiver has a formula of its own."""
    calls: list[Any] = []
    for name in ("late_echo", "sharp_receiver_late_echo"):
        monkeypatch.setattr(
            late_light.late_echo,
            name,
            lambda name=name, **more: calls.append((name, more)),
        )
    water = water_properties(plate)
    zero = np.zeros(1)
    words: dict[str, Any] = {
        "depth": np.ones(1), "geometry": view.view(plate, zero, zero), "water": water,
        "phase_function": SimpleNamespace(asymmetry=0.9),
    }  # fmt: skip
    late_echo_delay(plate, np.ones(1), **words)
    sharp = plate.with_({"instrument.receiver.edge": "sharp"})
    late_echo_delay(sharp, np.ones(1), scattering=0.125, split_angle=0.5, **words)
    (first, plain), (second, stated) = calls
    assert (first, second) == ("late_echo", "sharp_receiver_late_echo")
    assert (plain["scattering"], plain["split_angle"]) == (
        water.scattering,
        math.pi / 2,
    )
    assert (stated["scattering"], stated["split_angle"]) == (0.125, 0.5)


def test_water_without_a_forward_part_loses_all_scattered_light(plate: Survey) -> None:
    """Its diffuse light counts as absorbed; a glance of zero is no scattering."""
    water = water_properties(plate)
    zero = np.zeros(1)
    geometry = view.view(plate, zero, zero)
    usual = whole_function.whole_function_arguments(plate, water, geometry)
    assert usual["scattering"] == water.scattering
    assert usual["split_angle"] == water.split_angle
    assert "second_moment" not in usual
    for changes in ({"second_moment": 0.0}, {"forward_scattering": 0.0}):
        dark = replace(water, diffuse_scattering=0.25, **changes)
        found = whole_function.whole_function_arguments(plate, dark, geometry)
        assert found["absorption"] == pytest.approx(water.absorption + 0.25)
        assert found["scattering"] == 0.0
        assert float(found["phase_function"](1.0)) == pytest.approx(1 / (4 * np.pi))


def test_a_sharp_receiver_has_a_gaussian_one_of_equal_width(plate: Survey) -> None:
    """A disc of the radius R has a mean square distance of R^2 / 2."""
    water = water_properties(plate)
    zero = np.zeros(1)
    geometry = view.view(plate, zero, zero)
    plain = whole_function.gaussian_arguments(plate, water, geometry)
    assert plain["receiver_radius"] == plate.instrument.receiver.radius
    sharp = plate.with_({"instrument.receiver.edge": "sharp"})
    found = whole_function.gaussian_arguments(sharp, water, geometry)
    for name in ("receiver_radius", "acceptance_angle"):
        assert found[name] == pytest.approx(plain[name] / math.sqrt(2))


def test_water_that_is_dark_straight_back_has_a_forward_part(plate: Survey) -> None:
    """A millionth stands for no light backwards; with a function nothing changes."""
    water = water_properties(plate)
    dark = replace(
        water, backscatter_vsf=0.0, forward_scattering=0.99 * water.scattering
    )
    function = whole_function.whole_phase_function(dark)
    assert 0 < float(function(np.pi)) < 1e-5
    stated = isotropic()
    known = replace(dark, phase_function=stated)
    assert whole_function.whole_phase_function(known) is stated
