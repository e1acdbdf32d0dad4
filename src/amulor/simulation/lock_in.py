"""Light from target and water at the detector, and its lock-in samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics import detection
from amulor.optics.polarization import mueller
from amulor.simulation.geometry import Geometry, Setup
from amulor.simulation.models import (
    DEFAULT_MODEL,
    FittedModel,
    SignalModel,
    UncertainModel,
)
from amulor.survey import Survey, counting
from amulor.survey.mueller import matrix
from amulor.survey.view import View


@dataclass(frozen=True)
class Light:
    """Ratio of received to launched power, (frequency, polarization, pixels...)."""

    modulated: NDArray[np.complex128]
    """Ratio of received to launched power at each modulation frequency, complex [1]."""
    mean: NDArray[np.float64]
    """Ratio of received to launched mean power, without modulation [1]."""
    variance: NDArray[np.float64] | float = 0.0
    """Variance of `modulated` from errors of the forward model, sum of real and
    imaginary part [1]."""

    def reading(self, frequency: int, polarization: int) -> Light:
        """Return the light of one frequency and one polarization."""
        at = frequency, polarization
        variance = self.variance
        return Light(
            self.modulated[at],
            self.mean[at],
            variance if np.ndim(variance) == 0 else np.asarray(variance)[at],
        )

    @classmethod
    def of_readings(cls, lights: Sequence[Light], plane: tuple[int, ...]) -> Light:
        """Return the light of all readings; `plane` is (frequencies, polarizations)."""

        def joined(values: list[Any]) -> NDArray[Any]:
            array = np.array(values)
            return array.reshape(*plane, *array.shape[1:])

        variance = [light.variance for light in lights]
        return cls(
            joined([light.modulated for light in lights]),
            joined([light.mean for light in lights]),
            joined(variance) if np.ndim(variance[0]) else variance[0],
        )

    def __add__(self, other: Light) -> Light:
        """Return the sum of the light from two sources."""
        return Light(
            self.modulated + other.modulated,
            self.mean + other.mean,
            self.variance + other.variance,
        )


def target_light(
    setup: Setup, geometry: Geometry, *, model: SignalModel = DEFAULT_MODEL
) -> Light:
    """Return the received light of the targets."""
    survey = setup.survey
    met = geometry.target >= 0
    reflectance = np.zeros(met.shape)
    fraction = np.zeros((len(survey.instrument.polarizations), *met.shape))
    for number, target in enumerate(survey.targets):
        pixels = geometry.target == number
        reflectance[pixels] = target.reflectance
        fraction[:, pixels] = _fractions(survey, target.mueller)[:, None]
    frequency = _frequencies(survey)
    depth = np.where(met, geometry.depth, 0.0)
    surface = {
        "depth": depth,
        "optical_path": geometry.optical_path,
        # Any possible value where there is no target.
        "return_path": np.where(met, geometry.return_path, geometry.view.baseline),
        "reflectance": reflectance,
        "cosine": geometry.cosine,
    }
    common = _model_arguments(setup, geometry.view)
    frequencies = frequency[:, None, None, None]

    def echo(surface: dict[str, Any], throughput: Any) -> Light:
        if isinstance(model, UncertainModel):
            response, error = model.echo_with_error(
                frequencies, surface=surface, **common
            )
            return _light(response * throughput, np.abs(error * throughput))
        return _light(model.echo(frequencies, surface=surface, **common) * throughput)

    transmission = geometry.view.transmission
    bright: Any = geometry.brightness
    if geometry.surroundings is not None:
        bright = bright + geometry.surroundings[:, None]
    direct = echo(surface, fraction * bright * transmission)
    if geometry.twice is None:
        return direct
    # Two reflections leave no polarization.
    unpolarized = _fractions(survey, "ideal-depolarizer").reshape(-1, *[1] * met.ndim)
    facing = {"reflectance": 1.0 * met, "cosine": np.ones(met.shape)}
    twice = geometry.twice[:, None]
    return direct + echo(surface | facing, unpolarized * transmission * twice)


def water_light(
    setup: Setup,
    view: View,
    *,
    end: NDArray[np.float64] | None = None,
    model: SignalModel = DEFAULT_MODEL,
) -> Light:
    """Return the received light backscattered by the water."""
    frequency, stop = _column_axes(setup.survey, view, end)
    # The model counts the delay from where the water begins.
    turn = np.exp(2j * np.pi * frequency * view.optical_offset / speed_of_light)
    fraction = _fractions(setup.survey, setup.water.backscatter_mueller)
    throughput = fraction.reshape(-1, *[1] * view.tilt.ndim) * view.transmission
    common = _model_arguments(setup, view)
    if isinstance(model, UncertainModel):
        response, error = model.column_with_error(frequency, end=stop, **common)
        return _light(response * turn * throughput, error * throughput)
    return _light(model.column(frequency, end=stop, **common) * turn * throughput)


def _model_arguments(setup: Setup, view: View) -> dict[str, Any]:
    """Return the common arguments of a model's methods `echo` and `column`."""
    return {"survey": setup.survey, "water": setup.water, "view": view}


def fitted(
    model: FittedModel,
    setup: Setup,
    view: View,
    *,
    end: NDArray[np.float64],
    farthest: float,
) -> SignalModel:
    """Return a forward model fitted to all water columns of a scan."""
    frequency, stop = _column_axes(setup.survey, view, end)
    return model.fit(
        frequency, end=stop, farthest=farthest, **_model_arguments(setup, view)
    )


def _column_axes(
    survey: Survey, view: View, end: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return frequencies that broadcast over beams, and end depths of columns [m]."""
    far = np.inf if survey.water.column_end is None else survey.water.column_end
    stop = np.minimum(np.inf if end is None else end, far)
    return _frequencies(survey).reshape(-1, 1, *[1] * view.tilt.ndim), stop


def _frequencies(survey: Survey) -> NDArray[np.float64]:
    """Return the modulation frequencies, with 0 Hz for the mean light first [Hz]."""
    return np.array([0.0, *survey.instrument.modulation_frequencies])


def _light(
    response: NDArray[np.complex128], error: NDArray[np.float64] | None = None
) -> Light:
    # Rounding causes negative values where no light is received.
    still = np.maximum(response[:1].real, 0.0)
    mean = np.broadcast_to(still, response[1:].shape)
    return Light(response[1:], mean, 0.0 if error is None else error[1:] ** 2)


def _fractions(survey: Survey, mueller_matrix: Any) -> NDArray[np.float64]:
    """Return the fraction of the light that passes each analyzer [1]."""
    pairs = survey.instrument.polarizations
    reduced = matrix(mueller_matrix)
    return np.array([float(mueller.detected_fraction(reduced, pair=p)) for p in pairs])


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Lock-in outputs with their stated uncertainty, all of one shape."""

    signal: NDArray[np.complex128]
    """Signal as a peak amplitude, in phase + 1j * quadrature [V]."""
    in_phase_variance: NDArray[np.float64]
    """Variance of the in-phase output [V^2]."""
    quadrature_variance: NDArray[np.float64]
    """Variance of the quadrature output [V^2]."""
    covariance: NDArray[np.float64]
    """Covariance of in-phase and quadrature output [V^2]."""
    saturated: NDArray[np.int8]
    """Whether the mean output exceeds the linear range: 1 if so, else 0 [1]."""


def expected_signal(setup: Setup, light: Light) -> NDArray[np.complex128]:
    """Return the noiseless lock-in signal of received light [V]."""
    return setup.volt_per_power * light.modulated


class Noise(Protocol):
    """Interface of random generators, for a full scan or a range of rows."""

    def standard_normal(self, size: tuple[int, ...], /) -> NDArray[np.float64]:
        """Return standard normal deviates."""
        ...

    def gamma(
        self, shape: float, scale: float, /, size: tuple[int, ...]
    ) -> NDArray[np.float64]:
        """Return deviates of the gamma distribution."""
        ...


def draws(survey: Survey) -> list[tuple[str, int]]:
    """Return each random draw of `sample`: distribution, and number of pixel arrays."""
    analysers = len(survey.instrument.polarizations)
    planes = len(survey.instrument.modulation_frequencies) * analysers
    speckled = survey.instrument.receiver.speckle_cells is not None
    return [
        ("standard_normal", planes),
        *([("gamma", analysers)] if speckled else []),
        *[("standard_normal", planes)] * 3,
    ]


def sample(
    setup: Setup,
    target: Light,
    water: Light,
    *,
    rng: Noise,
    detect: Callable[[Light], Light] | None = None,
) -> Samples:
    """Draw lock-in samples of the sum of target and water light.

    A sample is the mean of the lock-in output over the dwell, after five time
    constants of settling. Counting noise spreads both outputs alike; the phase floor
    spreads the sample along its circle only, which is why the outputs covary. `detect`
    is applied to the whole light before it is counted.
    """
    survey = setup.survey
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
    if detect is not None:
        light = detect(light)
    daylight = setup.daylight_rate.reshape(-1, *[1] * (light.mean.ndim - 2))
    rate = setup.full_rate * light.mean + daylight
    time = counting.integration_time(survey)
    # A count of zero has the uncertainty of one photoelectron.
    counted = np.maximum(rate, 1 / time - detector.dark_rate)
    variance = counting.counting_variance(survey, rate=counted, integration_time=time)
    noise = np.sqrt(variance) * (
        rng.standard_normal(variance.shape) + 1j * rng.standard_normal(variance.shape)
    )
    jitter = lock_in.phase_floor * rng.standard_normal(variance.shape)
    signal = expected_signal(setup, light) * np.exp(1j * jitter) + noise
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        signal, phase_floor=lock_in.phase_floor
    )
    # The uncertainty of the light itself, the same in both outputs.
    variance = variance + setup.volt_per_power**2 * light.variance / 2
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
    """Return the target light with speckle drawn per pixel and analyzer, if configured.

    A still scene has one pattern for all modulation frequencies.
    """
    cells = survey.instrument.receiver.speckle_cells
    if cells is None:
        return target
    power = rng.gamma(cells, 1 / cells, size=target.mean.shape[1:])
    return Light(
        target.modulated * power, target.mean * power, target.variance * power**2
    )
