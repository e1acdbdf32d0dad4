"""From received light to lock-in samples: photoelectrons, noise, phase floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from amulor.optics import detection
from amulor.simulation.signal import Light
from amulor.survey import Survey, counting


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Lock-in outputs with their stated uncertainty, all of one shape."""

    signal: NDArray[np.complex128]
    """Peak amplitude of the modulation, in phase + 1j * quadrature [V]."""
    in_phase_variance: NDArray[np.float64]
    """Variance of the in-phase output [V^2]."""
    quadrature_variance: NDArray[np.float64]
    """Variance of the quadrature output [V^2]."""
    covariance: NDArray[np.float64]
    """Covariance of the two [V^2]."""
    saturated: NDArray[np.int8]
    """1 where the mean output left the linear range [1]."""


def expected_signal(survey: Survey, light: Light) -> NDArray[np.complex128]:
    """Return the noiseless lock-in output of received light.

    Parameters
    ----------
    survey : Survey
        Its instrument counts.
    light : Light
        Received power per launched power.

    Returns
    -------
    ndarray of complex
        Peak amplitude of the modulation [V].
    """
    instrument = survey.instrument
    volt = instrument.detector.volt_per_photoelectron_rate
    return (
        instrument.modulation_depth
        * volt
        * counting.full_rate(survey)
        * light.modulated
    )


class Noise(Protocol):
    """What a random generator does here; its rows can also come one after another."""

    def standard_normal(self, size: tuple[int, ...], /) -> NDArray[np.float64]:
        """Return normal numbers."""
        ...

    def gamma(
        self, shape: float, scale: float, /, size: tuple[int, ...]
    ) -> NDArray[np.float64]:
        """Return numbers of the gamma distribution."""
        ...


def draws(survey: Survey) -> list[tuple[str, int]]:
    """Return what `sample` asks of a random generator, in its order.

    Parameters
    ----------
    survey : Survey
        Its frequencies, analysers and speckle count.

    Returns
    -------
    list of tuple of str and int
        Method of the generator, and how many planes of (row, column) [1].
    """
    analysers = len(survey.instrument.polarizations)
    planes = len(survey.instrument.modulation_frequencies) * analysers
    speckled = survey.instrument.receiver.speckle_cells is not None
    return [
        ("standard_normal", planes),
        *([("gamma", analysers)] if speckled else []),
        *[("standard_normal", planes)] * 3,
    ]


def sample(
    survey: Survey,
    target: Light,
    water: Light,
    *,
    rng: Noise,
) -> Samples:
    """Draw the lock-in samples of target and water light together.

    Parameters
    ----------
    survey : Survey
        Its instrument, its dwell and the fluctuation of its water count.
    target, water : Light
        Received power per launched power, of one shape.
    rng : numpy.random.Generator or Noise
        Source of all randomness; `draws` says what is asked of it.

    Returns
    -------
    Samples
        Of the same shape. The stated variance covers what the instrument knows:
        shot and dark noise, that of daylight and the phase floor, not the fluctuation
        of the water and not the speckle of the target; and the errors of a forward
        model that states some.

    Notes
    -----
    A sample is the mean of the lock-in output over the dwell, after five time
    constants of settling. Counting noise spreads both outputs alike; the phase floor
    spreads the sample along its circle only, which is why the outputs covary.
    """
    instrument, detector = survey.instrument, survey.instrument.detector
    lock_in = instrument.lock_in
    volt = detector.volt_per_photoelectron_rate
    change = 1 + survey.water.signal_fluctuation * rng.standard_normal(
        water.modulated.shape
    )
    speckled = _speckled(survey, target, rng=rng)
    light = speckled + Light(
        water.modulated * change, water.mean * np.maximum(change, 0), water.variance
    )
    rate = counting.full_rate(survey) * light.mean + _daylight(survey, light)
    time = counting.integration_time(survey)
    # Who counts nothing does not know that there is nothing, but for one photoelectron.
    counted = np.maximum(rate, 1 / time - detector.dark_rate)
    variance = counting.counting_variance(survey, rate=counted, integration_time=time)
    noise = np.sqrt(variance) * (
        rng.standard_normal(variance.shape) + 1j * rng.standard_normal(variance.shape)
    )
    jitter = lock_in.phase_floor * rng.standard_normal(variance.shape)
    signal = expected_signal(survey, light) * np.exp(1j * jitter) + noise
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        signal, phase_floor=lock_in.phase_floor
    )
    # What the light itself is not sure of, the same in both outputs.
    one = expected_signal(survey, Light(np.ones(1, complex), np.ones(1))).real[0]
    variance = variance + one**2 * light.variance / 2
    return Samples(
        signal=signal,
        in_phase_variance=variance + in_phase,
        quadrature_variance=variance + quadrature,
        covariance=covariance,
        saturated=(volt * (rate + detector.dark_rate) > detector.saturation).astype(
            np.int8
        ),
    )


def _speckled(survey: Survey, target: Light, *, rng: Noise) -> Light:
    """Return the target's light with the speckle of each place and analyser.

    What does not move has one pattern for all modulation frequencies.
    """
    cells = survey.instrument.receiver.speckle_cells
    if cells is None:
        return target
    power = rng.gamma(cells, 1 / cells, size=target.mean.shape[1:])
    return Light(
        target.modulated * power, target.mean * power, target.variance * power**2
    )


def _daylight(survey: Survey, light: Light) -> NDArray[np.float64]:
    """Return the rate by daylight, to be broadcast against that of the light [1/s]."""
    behind = counting.background_rate(survey)
    return behind.reshape(-1, *[1] * (light.mean.ndim - 2))
