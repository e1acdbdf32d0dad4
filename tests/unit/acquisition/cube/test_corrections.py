"""Corrections of a calibration, one at a time, on given values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact_calibrations import (
    CHANNELS,
    DEGREES,
    FREQUENCIES,
    LEAKAGE,
    OUTPUTS,
    REFERENCE,
    table,
    with_temperature,
)
from exact_samples import samples
from numpy.testing import assert_allclose

from amulor.acquisition import Calibration
from amulor.acquisition.cube import calibration as corrections
from amulor.errors import FormatError
from amulor.rejection.covariance import Covariance


def test_phase_errors_are_interpolated_and_grow_beyond_the_table() -> None:
    known = Calibration(frequencies=(table(0.1, 0.3, 0.2, errors=(0.01, 0.02, 0.04)),))
    inside, beyond = corrections.phase_uncertainty(
        known,
        np.array([1e-5, 1e-3, 10**-2.5, 1e-2, 0.1, 1.0, np.nan, 0.0]),
        modulation_frequency=20e6,
    )
    assert_allclose(inside[:6], [0.01, 0.01, 0.015, 0.02, 0.04, 0.04])
    # Slopes of 0.2 and -0.1 a decade, with their errors, over two decades and one.
    below = 2 * math.hypot(0.2, math.hypot(0.01, 0.02))
    above = math.hypot(0.1, math.hypot(0.02, 0.04))
    assert_allclose(beyond, [below, 0, 0, 0, 0, above, 0, 0], atol=1e-12)


def test_one_amplitude_has_no_slope_to_go_on_with() -> None:
    one = Calibration(frequencies=(table(0.1, errors=(0.01,)),))
    amplitudes = np.array([1e-5, 1e-3, 1.0])
    inside, beyond = corrections.phase_uncertainty(
        one, amplitudes, modulation_frequency=20e6
    )
    assert_allclose(inside, 0.01)
    assert_allclose(beyond, 0)
    phase, covered = corrections.phase_correction(
        one, np.array([1e-5, 1.0, np.nan]), modulation_frequency=20e6
    )
    assert_allclose(phase[:2], 0.1)
    assert covered.tolist() == [True, True, False]
    # A table without errors has none inside, and its slope beyond.
    without = Calibration(frequencies=(table(0.1, 0.3),))
    inside, beyond = corrections.phase_uncertainty(
        without, np.array([1e-4, 1e-2]), modulation_frequency=20e6
    )
    assert_allclose(inside, 0)
    assert_allclose(beyond, [0.2, 0], atol=1e-12)


def test_both_ends_of_a_table_are_inside() -> None:
    known = Calibration(frequencies=(table(0.1, 0.3),))
    _, covered = corrections.phase_correction(
        known, np.array([1e-3, 1e-2]), modulation_frequency=20e6
    )
    assert covered.all()


def test_a_frequency_may_be_off_by_a_thousandth() -> None:
    known = Calibration(frequencies=(table(0.1), table(0.2, frequency=50e6)))
    for frequency in (20e6 * (1 + 0.9e-3), 20e6 * (1 - 0.9e-3)):
        assert corrections._nearest(known.frequencies, frequency).phases == (0.1,)
    for frequency in (20e6 * (1 + 1.1e-3), 20e6 * (1 - 1.1e-3)):
        with pytest.raises(FormatError) as caught:
            corrections._nearest(known.frequencies, frequency)
        assert str(caught.value) == (
            f"the calibration has no {frequency / 1e6:g} MHz; record the plate at the "
            "frequencies of the scan"
        )


def test_leakage_has_the_places_of_the_cube() -> None:
    known = Calibration(leakage=LEAKAGE[::-1])
    cube = samples(0.0)
    leak, error = corrections.leakage_of(known, cube, "scan")
    assert_allclose(leak, [[1 + 2j, 3 + 4j], [5 + 6j, 7 + 8j]])
    assert_allclose(error, [[0.1, 0.2], [0.4, 0.3]])
    leak, error = corrections.leakage_of(known, cube, "open_water")
    assert_allclose(leak, [[-1, -2], [-3, -4 + 1j]])
    assert_allclose(error, [[1.1, 1.2], [1.4, 1.3]])
    leak, error = corrections.leakage_of(
        Calibration(frequencies=(table(0.1),)), cube, "scan"
    )
    assert leak.tolist() == [[0]]
    assert error.tolist() == [[0]]


def test_an_entry_that_is_missing_is_named_with_what_to_do() -> None:
    for changes, text in (
        ({"modulation_frequency": 50.06e6}, "no leakage at 50 MHz in VH"),
        ({"polarization": "VP"}, "no leakage at 50 MHz in VH"),
    ):
        off = LEAKAGE[3].model_copy(update=changes)
        with pytest.raises(FormatError) as caught:
            corrections.leakage_of(
                Calibration(leakage=(*LEAKAGE[:3], off)), samples(0.0), "scan"
            )
        assert str(caught.value) == (
            f"the calibration has {text}; measure it with the shutter closed at the "
            "frequencies and channels of the scan"
        )
    near = LEAKAGE[3].model_copy(update={"modulation_frequency": 50.04e6})
    corrections.leakage_of(
        Calibration(leakage=(*LEAKAGE[:3], near)), samples(0.0), "scan"
    )


def test_the_outputs_of_a_skewed_demodulator_are_those_of_its_light() -> None:
    known = Calibration(demodulator=OUTPUTS)
    light = np.array([[3 - 2j, 1j], [2 + 1j, -1 + 0j]])[..., None]
    shown = np.empty_like(light)
    for k, entry in enumerate(OUTPUTS):
        gain, angle = 1 + entry.quadrature_gain, entry.quadrature_phase
        turned = light[k].imag * math.cos(angle) + light[k].real * math.sin(angle)
        shown[k] = light[k].real + 1j * gain * turned + complex(*entry.offset)
    ones = np.ones(light.shape)
    errors = Covariance(4 * ones, 9 * ones, 1.5 * ones)
    cube = samples(0.0)
    signal, changed = corrections.demodulated(known, cube, shown, errors)
    assert_allclose(signal, light)
    # The inverse is linear: outputs (I, Q) -> (I, s Q - t I).
    for k, entry in enumerate(OUTPUTS):
        gain, angle = 1 + entry.quadrature_gain, entry.quadrature_phase
        linear = np.array([[1, 0], [-math.tan(angle), 1 / (gain * math.cos(angle))]])
        expected = linear @ np.array([[4, 1.5], [1.5, 9]]) @ linear.T
        assert_allclose(changed.in_phase[k], expected[0, 0])
        assert_allclose(changed.quadrature[k], expected[1, 1])
        assert_allclose(changed.cross[k], expected[0, 1])
    # Leakage, or a dark output, contains the offset already.
    for other, attributes in (
        (Calibration(demodulator=OUTPUTS, leakage=LEAKAGE), {}),
        (known, {"dark_in_phase": np.array([0, 1e-9]), "dark_quadrature": [0, 0]}),
        (known, {"dark_quadrature": 1e-9}),
    ):
        with_offset, _ = corrections.demodulated(
            other, cube.assign_attrs(attributes), shown, errors
        )
        assert_allclose(with_offset.real - light.real, [[[0.5]] * 2, [[0]] * 2])
    silent = cube.assign_attrs(dark_in_phase=np.zeros(4), dark_quadrature=np.zeros(4))
    assert_allclose(corrections.demodulated(known, silent, shown, errors)[0], light)


def test_errors_of_the_demodulator_are_those_of_each_frequency() -> None:
    known = Calibration(demodulator=OUTPUTS)
    phase, offset = corrections.demodulator_uncertainty(known, samples(0.0))
    # The mean square over all phases is 1/8 of that of the gain, 3/8 of the angle.
    assert_allclose(phase, [math.sqrt(0.01**2 / 8 + 3 * 0.02**2 / 8), 0])
    assert_allclose(offset, [0.1, 0.2])
    dark = samples(0.0).assign_attrs(dark_in_phase=1e-9)
    phase, offset = corrections.demodulator_uncertainty(known, dark)
    assert_allclose(offset, 0)
    assert phase[0] > 0
    unknown = Calibration(frequencies=(table(0.1),))
    phase, offset = corrections.demodulator_uncertainty(unknown, samples(0.0))
    assert phase.tolist() == offset.tolist() == [0, 0]


def test_the_gain_falls_with_the_amplitude_up_to_the_last_filter() -> None:
    known = Calibration(
        frequencies=(table(0.1),),
        gain_change=-0.19,
        gain_change_uncertainty=0.02,
        gain_amplitude=2.0,
    )
    amplitude = np.array([0.0, 1.0, 2.0, 4.0, np.nan])
    signal = np.array([0, 0.6 + 0.8j, 2, 4j, complex(np.nan, np.nan)])
    ones = np.ones(5)
    errors = Covariance(ones, 4 * ones, 0.5 * ones)
    corrected, changed = corrections.with_constant_gain(
        known, signal, errors, amplitude=amplitude
    )
    # Half of the amplitude has the root of the gain.
    factor = np.array([1, 1 / 0.9, 1 / 0.81, 1 / 0.81])
    assert_allclose(corrected[:4], factor * signal[:4])
    assert np.isnan(corrected[4])
    more = np.array([0, 0.01, 0.02, 0.02]) * factor
    across = signal[:4].real * signal[:4].imag
    assert_allclose(changed.in_phase[:4], factor**2 + (more * signal[:4].real) ** 2)
    assert_allclose(
        changed.quadrature[:4], 4 * factor**2 + (more * signal[:4].imag) ** 2
    )
    assert_allclose(changed.cross[:4], 0.5 * factor**2 + more**2 * across)
    assert changed.in_phase[4] == 1
    for name in ("gain_change", "gain_amplitude"):
        without = known.model_copy(update={name: None})
        same, kept = corrections.with_constant_gain(
            without, signal, errors, amplitude=amplitude
        )
        assert same is signal
        assert kept is errors
    exact = known.model_copy(update={"gain_change_uncertainty": None})
    _, kept = corrections.with_constant_gain(exact, signal, errors, amplitude=amplitude)
    assert_allclose(kept.cross[:4], 0.5 * factor**2)


def test_mixed_channels_are_separated() -> None:
    known = Calibration(channels=CHANNELS)
    light = np.array([[1 + 1j, 2 - 1j], [0.5j, 3.0]])[..., None, None]
    gain = np.array([[1, 2j], [1, 0.5 - 0.5j]])[..., None, None]
    share = np.array([[0.1, -0.2], [0.3, 0.05]])[..., None, None]
    mixed = gain * (light + share * light[:, ::-1])
    ones = np.ones(light.shape)
    errors = Covariance(
        ones * [[[[1.0]], [[4.0]]]], ones * [[[[1.0]], [[4.0]]]], 0 * ones
    )
    signal, changed, attributes = corrections.separated(
        known, samples(0.0), mixed, errors
    )
    assert_allclose(signal, light)
    # Of equal errors of both outputs that of a channel is |a|^2 e + |b|^2 e'.
    for k in range(2):
        matrix = np.linalg.inv(
            np.diag(gain[k].ravel())
            @ np.array([[1, share[k, 0].item()], [share[k, 1].item(), 1]])
        )
        expected = np.abs(matrix) ** 2 @ [1.0, 4.0]
        assert_allclose(changed.in_phase[k].ravel(), expected)
        assert_allclose(changed.quadrature[k].ravel(), expected)
        assert_allclose(changed.cross[k].ravel(), 0, atol=1e-12)
    assert_allclose(attributes["channel_gain_uncertainty"], [0.03, 0.05])
    assert attributes["channel_crosstalk_uncertainty"] == 0.004
    same, kept, none = corrections.separated(
        Calibration(frequencies=(table(0.1),)), samples(0.0), mixed, errors
    )
    assert same is mixed
    assert kept is errors
    assert none == {}


@pytest.mark.parametrize(
    ("name", "names", "partner"),
    [
        ("VV", ["VV", "VH"], "VH"), ("VH", ["VV", "VH"], "VV"),
        ("PM", ["PP", "PM"], "PP"), ("PP", ["PM", "PP"], "PM"),
    ],
)  # fmt: skip
def test_the_partner_has_the_orthogonal_analyzer(name, names, partner) -> None:
    assert corrections._partner(name, names) == partner


def test_a_channel_without_a_partner_is_refused() -> None:
    for name, names, missing in (("VH", ["VH", "VP"], "VV"), ("RL", ["RL"], "R")):
        with pytest.raises(FormatError) as caught:
            corrections._partner(name, names)
        assert str(caught.value) == (
            f"the calibration has a cross-talk, but the scan has no channel {missing} "
            f"beside {name}; record both, or calibrate without the polarizer"
        )


def test_a_scan_is_turned_to_the_reference_of_the_calibration() -> None:
    known = Calibration(reference=REFERENCE)
    cube = samples(0.0).assign_attrs(
        reference_phase_rad=[0.15, 0.1, 3.0, 0.4],
        reference_phase_uncertainty_rad=np.array([0.04, 0.0]),
    )
    shift, attributes = corrections.reference_shift(known, cube)
    # From -3 to 3 the short way is 6 - 2 pi.
    assert_allclose(shift, [[0.05, -0.1], [6 - 2 * math.pi, 0]], atol=1e-12)
    assert_allclose(attributes["reference_phase_rad"], [0.1, 0.2, -3.0, 0.4])
    assert_allclose(
        attributes["reference_phase_uncertainty_rad"], [math.hypot(0.04, 0.02), 0.03]
    )
    assert attributes["reference_calibrated"] == 1
    assert_allclose(attributes["instrument_drift_uncertainty_s"], [0, 0])
    none, empty = corrections.reference_shift(
        Calibration(frequencies=(table(0.1),)), cube
    )
    assert none.tolist() == [[0]]
    assert empty == {}


@pytest.mark.parametrize(
    ("stated", "error"), [({}, 0.5), ({"instrument_temperature_uncertainty": 0.2}, 0.2)]
)
def test_a_recorded_temperature_shifts_the_phase(small, stated, error) -> None:
    cube = with_temperature(small, instrument_temperature=17.0, **stated)
    shift, attributes = corrections.temperature_shift(DEGREES, cube)
    assert_allclose(shift, [[-0.09], [0.06]])
    phase = [
        math.sqrt((slope * error) ** 2 + (of * error) ** 2 + (of * 3.0) ** 2)
        for slope, of in ((0.03, 0.001), (0.02, 0.004))
    ]
    assert_allclose(
        attributes["temperature_delay_uncertainty_s"],
        np.array(phase) / (2 * math.pi * np.array(FREQUENCIES)),
    )
    assert attributes["temperature_recorded"] == 1


@pytest.mark.parametrize("survey", [True, False])
def test_an_unknown_temperature_is_anywhere_in_that_of_the_run(small, survey) -> None:
    cube = with_temperature(small) if survey else samples(0.0)
    for reference, farthest in ((20.0, 8.0), (15.0, 8.0), (16.0, 7.0)):
        known = DEGREES.model_copy(update={"reference_temperature": reference})
        shift, attributes = corrections.temperature_shift(known, cube)
        assert_allclose(shift, [[0], [0]])
        error = farthest / math.sqrt(3)
        phase = [
            math.hypot(slope, of) * error
            for slope, of in ((0.03, 0.001), (0.02, 0.004))
        ]
        assert_allclose(
            attributes["temperature_delay_uncertainty_s"],
            np.array(phase) / (2 * math.pi * np.array(FREQUENCIES)),
        )
        assert attributes["temperature_recorded"] == 0
    none, empty = corrections.temperature_shift(
        Calibration(frequencies=(table(0.1),)), cube
    )
    assert none.tolist() == [[0]]
    assert empty == {}
