"""Photon counting of an instrument: integration time, rates, counting noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import daylight, detection
from amulor.survey.survey import Survey
from amulor.survey.view import medium_of, seen_from_water


def integration_time(survey: Survey) -> float:
    """Return the effective integration time of one sample [s]."""
    return float(
        detection.settled_integration_time(
            survey.scan.dwell, time_constant=survey.instrument.lock_in.time_constant
        )
    )


def full_rate(survey: Survey) -> float:
    """Return the photoelectron rate if the receiver got all launched light [1/s]."""
    instrument, detector = survey.instrument, survey.instrument.detector
    return float(
        detection.photoelectron_rate(
            instrument.power * detector.optical_transmission,
            wavelength=instrument.wavelength,
            quantum_efficiency=detector.quantum_efficiency,
        )
    )


def background_rate(survey: Survey) -> NDArray[np.float64]:
    """Return the photoelectron rate of daylight behind each analyzer [1/s]."""
    instrument, light = survey.instrument, survey.daylight
    pairs = instrument.polarizations
    if light is None:
        return np.zeros(len(pairs))
    _, acceptance = seen_from_water(survey, medium_of(survey))
    rate = daylight.daylight_rate(
        daylight.daylight_radiance(
            light.radiance,
            depth=light.depth,
            diffuse_attenuation=light.diffuse_attenuation,
        ),
        wavelength=instrument.wavelength,
        bandwidth=light.bandwidth,
        receiver_area=np.pi * instrument.receiver.radius**2,
        solid_angle=np.pi * acceptance**2,
        transmission=instrument.detector.optical_transmission,
        quantum_efficiency=instrument.detector.quantum_efficiency,
    )
    transmission = np.array([1.0 if pair == "none" else 0.5 for pair in pairs])
    return np.asarray(rate * transmission)


def counting_variance(
    survey: Survey, *, rate: ArrayLike, integration_time: float
) -> NDArray[np.float64]:
    """Return the variance of either lock-in output from photon counting [V^2]."""
    detector = survey.instrument.detector
    return np.asarray(
        detector.volt_per_photoelectron_rate**2
        * detection.quadrature_variance(
            rate,
            integration_time=integration_time,
            excess_noise_factor=detector.excess_noise_factor,
            dark_rate=detector.dark_rate,
        )
    )


def reference_variance(survey: Survey) -> float:
    """Return the variance of either output at the standing reference [V^2]."""
    reference, detector = survey.scan.reference, survey.instrument.detector
    assert reference is not None
    volt = survey.instrument.modulation_depth * detector.volt_per_photoelectron_rate
    return float(
        counting_variance(
            survey,
            rate=reference.amplitude / volt,
            integration_time=reference.readings * integration_time(survey),
        )
    )


def photon_noise_volt(survey: Survey) -> float:
    """Return the constant V of the counting variance V A / m at amplitude A [V]."""
    volt = survey.instrument.detector.volt_per_photoelectron_rate
    time = integration_time(survey)
    return float(detection.photon_noise(time, volt_per_photoelectron_rate=volt))
