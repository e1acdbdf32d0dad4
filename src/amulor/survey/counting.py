"""How well an instrument counts light: integration time, rates and counting noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import detection
from amulor.survey.survey import Survey


def integration_time(survey: Survey) -> float:
    """Return over how long one sample counts photoelectrons, in effect [s].

    Parameters
    ----------
    survey : Survey
        Its dwell and its lock-in count.

    Returns
    -------
    float
        Noise-equivalent time. Whatever the dwell leaves after settling is averaged; a
        dwell that leaves nothing still takes one reading.
    """
    return float(
        detection.settled_integration_time(
            survey.scan.dwell, time_constant=survey.instrument.lock_in.time_constant
        )
    )


def full_rate(survey: Survey) -> float:
    """Return photoelectrons per second if all launched light came back [1/s].

    Parameters
    ----------
    survey : Survey
        Its laser and its detector count.

    Returns
    -------
    float
        What received power per launched power is multiplied with.
    """
    instrument, detector = survey.instrument, survey.instrument.detector
    return float(
        detection.photoelectron_rate(
            instrument.power * detector.optical_transmission,
            wavelength=instrument.wavelength,
            quantum_efficiency=detector.quantum_efficiency,
        )
    )


def counting_variance(
    survey: Survey, *, rate: ArrayLike, integration_time: float
) -> NDArray[np.float64]:
    """Return the variance of either output by counting photoelectrons.

    Parameters
    ----------
    survey : Survey
        Its detector counts.
    rate : array_like
        Photoelectrons by light, not negative [1/s].
    integration_time : float
        Integration time of white noise, above zero [s].

    Returns
    -------
    ndarray
        Variance of the peak amplitude, of the shape of the rate [V^2].
    """
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


def photon_noise_volt(survey: Survey) -> float:
    """Return V such that an amplitude A has the counting variance V * A / m [V].

    Parameters
    ----------
    survey : Survey
        Its detector, its dwell and its lock-in count.

    Returns
    -------
    float
        `amulor.optics.detection.photon_noise` of one sample.
    """
    volt = survey.instrument.detector.volt_per_photoelectron_rate
    time = integration_time(survey)
    return float(detection.photon_noise(time, volt_per_photoelectron_rate=volt))
