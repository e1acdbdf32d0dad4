"""Check of a design against simulated scans and photon transport."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _progress, imaging, rejection
from amulor.design.candidates import Parameters, survey_of
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal
from amulor.errors import SurveyError
from amulor.imaging.common import own_variance
from amulor.optics import ranging
from amulor.simulation import SmallAngleModel, geometry, simulate
from amulor.simulation.geometry import Geometry
from amulor.simulation.photons import Place, run, setting_of, way
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import beam_arguments, has_sharp_receiver, refuse_layers
from amulor.transport import Progress, Tally

__all__ = ["Confirmation", "Photons", "Scans", "confirm", "follow_photons", "scans"]


Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Photons:
    """Middle-beam signals by photon transport, relative to the small-angle model."""

    histories: int
    """Number of photon histories [1]."""
    frequency: Floats
    """Modulation frequencies, shape (frequency,) [Hz]."""
    echo: Floats
    """Ratio of echo amplitudes, photons over model, shape (frequency,) [1]."""
    echo_error: Floats
    """Standard error of the echo ratio [1]."""
    shift: Floats
    """Range difference of the echo, photons minus model [m]."""
    shift_error: Floats
    """Standard error of the range difference [m]."""
    water: Floats
    """Ratio of water-signal amplitudes before the target, photons over model [1]."""
    water_error: Floats
    """Standard error of the water-signal ratio [1]."""
    range_bound: float = math.nan
    """Cramér-Rao bound of the range of one sample, for known water and an unknown
    reflectance; NaN for a beam with a width, or air or glass before the water [m]."""
    range_bound_error: float = math.nan
    """Standard error of the bound [m]."""
    free_range_bound: float = math.nan
    """The same bound for unknown absorption and scattering; infinite if the frequencies
    do not determine them [m]."""


def follow_photons(
    survey: Survey,
    *,
    relative_error: float = 0.01,
    histories: int = 1_000_000,
    seed: int = 1,
    progress: Callable[[str, float], None] | None = None,
) -> Photons:
    r"""Compare photon transport with the small-angle model in a survey's middle beam.

    A phase :math:`\Delta\varphi` above that of the model, by light that scattering
    delays, shifts a range by :math:`v \Delta\varphi / 4 \pi f`.
    """
    middle = survey.with_(
        {
            "scan.columns": 1,
            "scan.rows": 1,
            "scan.azimuth_span": 0.0,
            "scan.elevation_span": 0.0,
        }
    )
    water = water_properties(middle)
    refuse_layers(water, model="the photon model")
    if has_sharp_receiver(survey):
        raise SurveyError(
            "photons of a design know Gaussian receivers only, found "
            'instrument.receiver.edge = "sharp"; leave it out'
        )
    traced = geometry.trace(geometry.Setup(middle))
    if not bool((traced.target >= 0).all()):
        raise SurveyError(
            f"the middle beam of {survey.name!r} meets no target, so that no photon "
            "comes back; put a target in front of it"
        )
    view = traced.view
    place = Place(
        baseline=view.baseline.item(),
        tilt=view.tilt.item(),
        cross_tilt=view.cross_tilt.item(),
        standoff=view.standoff.item(),
        depth=traced.depth.item(),
        reflectance=float(survey.targets[traced.target.item()].reflectance),
    )
    setting = setting_of(survey, water, view, **beam_arguments(middle, water))
    bounded = place.standoff == 0 and setting.beam_radius == 0
    scattering = ("scattering",) if setting.scattering > 0 else ()
    tally = run(
        setting,
        place,
        np.array([0.0, *middle.instrument.modulation_frequencies]),
        relative_error=relative_error,
        histories=histories,
        seed=seed,
        progress=_reported(progress, relative_error),
        derivatives=(*_KNOWN_WATER, "absorption", *scattering) if bounded else (),
    )
    model = _model(middle, water, traced, place)
    compared = _compared(tally, model, group_index=water.group_index)
    if not bounded:
        return compared
    noise = _noise(middle, model[0])
    known, error = _bound(tally, noise, _KNOWN_WATER)
    free, _ = _bound(tally, noise, tally.derivatives)
    return replace(
        compared, range_bound=known, range_bound_error=error, free_range_bound=free
    )


#: Parameters that are estimated if the water is known.
_KNOWN_WATER = ("range", "reflectance")


def _noise(survey: Survey, echo: Complex) -> Floats:
    """Return the noise covariance of a sample in units of the launched power.

    Of several channels it is that with the least noise of the phase.
    """
    samples = simulate(survey, rng=0)
    truth = samples.amulor.truth
    volt = (truth["target_in_phase"] + 1j * truth["target_quadrature"]).values[
        ..., 0, 0
    ]
    in_phase = samples["in_phase_uncertainty"].values ** 2
    quadrature = samples["quadrature_uncertainty"].values ** 2
    both = samples.amulor.covariance.values
    covariance = np.stack([in_phase, both, both, quadrature], axis=-1)
    covariance = covariance[:, :, 0, 0].reshape(*volt.shape, 2, 2)
    across = np.stack([-volt.imag, volt.real], axis=-1)
    across /= np.abs(volt)[..., np.newaxis] ** 2
    size = np.einsum("fpi,fpij,fpj->p", across, covariance, across)
    best = int(np.argmin(size))
    factor = echo / volt[:, best]
    turn = np.stack([factor.real, -factor.imag, factor.imag, factor.real], axis=-1)
    turn = turn.reshape(-1, 2, 2)
    noise: Floats = turn @ covariance[:, best] @ turn.swapaxes(-1, -2)
    return noise


def _bound(tally: Tally, noise: Floats, names: tuple[str, ...]) -> tuple[float, float]:
    """Return the bound of the range and its error; infinite if not determined."""
    infinite = 1e30 * np.eye(2)[np.newaxis]  # no sample at zero frequency
    try:
        bound, error = tally.bounds(np.concatenate([infinite, noise]), names)
    except ValueError:
        return math.inf, math.nan
    return float(bound[0]), float(error[0])


def _reported(
    progress: Callable[[str, float], None] | None, relative_error: float
) -> Callable[[Progress], None] | None:
    if progress is None:
        return None

    def report(state: Progress) -> None:
        share = min(1.0, (relative_error / state.relative_error) ** 2)
        progress(f"photons, {state.histories:,}", share)

    return report


def _model(
    survey: Survey, water: WaterProperties, traced: Geometry, place: Place
) -> tuple[Complex, Complex]:
    """Echo, and water signal in front of the target, by the small-angle model."""
    frequency = np.array(survey.instrument.modulation_frequencies)[:, None, None]
    common: dict[str, Any] = {"survey": survey, "water": water, "view": traced.view}
    surface = {
        "depth": traced.depth,
        # Photons are counted from where the water begins.
        "optical_path": np.full_like(traced.depth, water.group_index * way(place)),
        "return_path": np.full_like(traced.depth, way(place) - place.depth),
        "reflectance": np.full_like(traced.depth, place.reflectance),
        "cosine": traced.cosine,
    }
    model = SmallAngleModel()
    return (
        model.echo(frequency, surface=surface, **common)[:, 0, 0],
        model.column(frequency, end=traced.depth, **common)[:, 0, 0],
    )


def _compared(
    tally: Tally, expected: tuple[Complex, Complex], *, group_index: float
) -> Photons:
    frequency = tally.modulation_frequency[1:]
    echo, echo_error, turn_error = _ratio(
        tally.target_signal[1:], tally.target_covariance[1:], expected[0]
    )
    water, water_error, _ = _ratio(
        tally.water_signal[1:], tally.water_covariance[1:], expected[1]
    )
    per_phase = ranging.range_per_phase(frequency, group_index=group_index)
    return Photons(
        frequency=frequency,
        histories=tally.histories,
        echo=np.abs(echo),
        echo_error=echo_error,
        shift=per_phase * np.angle(echo),
        shift_error=per_phase * turn_error,
        water=np.abs(water),
        water_error=water_error,
    )


def _ratio(
    light: Complex, covariance: Floats, expected: Complex
) -> tuple[Complex, Floats, Floats]:
    """Ratio of simulated to predicted signal; errors of its modulus and its phase."""
    lit = (np.abs(expected) > 0) & (np.abs(light) > 0)
    along = np.where(lit, light, 1.0) / np.where(lit, np.abs(light), 1.0)
    ahead = np.stack([along.real, along.imag], axis=-1)
    across = np.stack([-along.imag, along.real], axis=-1)
    amplitude, turn = (
        np.sqrt(np.einsum("fi,fij,fj->f", way_of, covariance, way_of))
        for way_of in (ahead, across)
    )
    ratio = np.where(lit, light / np.where(lit, expected, 1.0), 1.0)
    size = np.where(lit, np.abs(expected), np.inf)
    return ratio, amplitude / size, turn / np.where(lit, np.abs(light), np.inf)


#: Pixels of a scan that is simulated, and the largest angle between its edges [rad].
_COLUMNS, _ROWS, _SPAN = 16, 9, 4e-3
#: Share of the pixels that must have a range.
_SEEN = 0.5
#: Achieved over predicted uncertainty for which a prediction is confirmed [1].
HOLDS = (0.9, 1.1)
#: Relative difference of light up to which model and photons agree [1].
LIGHT = 0.1
#: Late-light correction of imaging over its stated uncertainty: three quarters of the
#: delay by the phase function, over the root of 5 % of this squared and half the
#: delay, rectangular, squared; `amulor.imaging.late_light` [1].
TAKEN_OFF = 0.75 / math.hypot(0.05 * 0.75, 0.5 / math.sqrt(12))
#: Share of the required accuracy up to which a shift by late light is ignored.
SHIFT = 0.25


@dataclass(frozen=True, kw_only=True)
class Scans:
    """Errors in simulated scans, compared with the predicted errors."""

    distance: float
    """Slant range of the target [m]."""
    predicted: float
    """Standard uncertainty of one pixel predicted by `evaluate` [m]."""
    achieved: float
    """Standard deviation of the simulated ranges about their mean [m]."""
    ratio: float
    """Ratio of simulated to predicted standard deviation [1]."""
    ratio_error: float
    """Standard error of the ratio, from the scatter between scans [1]."""
    offset: float
    """Mean error of the simulated ranges [m]."""
    offset_error: float
    """Standard error of the mean error [m]."""
    residual_bias: float
    """Bias predicted by `evaluate`, excluding late light as in simulated scans [m]."""
    ranges: int
    """Number of simulated ranges."""

    @property
    def holds(self) -> bool:
        """Whether the error ratio lies in 0.9 to 1.1, within two standard errors."""
        low, high = HOLDS
        margin = 2 * self.ratio_error
        return low - margin <= self.ratio <= high + margin


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """Check of one instrument by simulated scans and photon transport."""

    name: str
    """Name of the instrument, such as "best"."""
    scans: Scans
    """Comparison of simulated scans with the prediction."""
    photons: Photons | None
    """Photon-transport result; None for unsupported water or beam."""
    late: float
    """Predicted standard uncertainty of the late-light correction [m]."""
    said: tuple[str, ...]
    """Message for each difference beyond its limit."""

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain numbers, texts and lists."""
        photons = None
        if self.photons is not None:
            photons = {
                name: value.tolist() if isinstance(value, np.ndarray) else value
                for name, value in asdict(self.photons).items()
            }
            for name in ("range_bound", "range_bound_error", "free_range_bound"):
                if not math.isfinite(photons[name]):
                    photons[name] = None
        return {
            "name": self.name,
            "scans": {**asdict(self.scans), "holds": self.scans.holds},
            "photons": photons,
            "late_light_uncertainty": self.late,
            "differs": list(self.said),
        }


def confirm(
    goal: Goal,
    chosen: Parameters,
    *,
    name: str = "recommended",
    repeats: int = 12,
    histories: int = 1_000_000,
    seed: int = 1,
) -> Confirmation:
    """Check an instrument by simulated scans and photon transport."""
    distance = goal.asked[-1]
    survey = _reduced_survey(goal, chosen, distance)
    with _progress.part(0.0, 0.6):
        simulated = scans(
            survey, chosen.method, interval=goal.limits, repeats=repeats, seed=seed
        )
    late = float(
        evaluate(survey, distance=distance, method=chosen.method, interval=goal.limits)[
            "late_light"
        ]
    )
    remarks: list[str] = []
    photons: Photons | None = None
    try:
        with _progress.part(0.6, 1.0):
            photons = follow_photons(
                survey, histories=histories, seed=seed, progress=_progress.tell
            )
    except SurveyError as error:
        remarks.append(f"{name}: photons were not followed: {error}")
    remarks = [
        *_differences(name, simulated, photons, late, goal.accuracy.total_error),
        *remarks,
    ]
    return Confirmation(
        name=name, scans=simulated, photons=photons, late=late, said=tuple(remarks)
    )


def scans(
    survey: Survey,
    method: str,
    *,
    interval: tuple[float, float] | None = None,
    repeats: int = 12,
    seed: int = 1,
) -> Scans:
    """Simulate scans, reject the water signal, and compare errors with predictions."""
    if repeats < 3:
        raise ValueError(f"at least 3 scans are needed, got {repeats}")
    errors: list[Floats] = []
    for number in range(repeats):
        _progress.tell(f"scan {number + 1} of {repeats}", number / repeats)
        samples = simulate(survey, rng=np.random.default_rng([seed, number]))
        image = _image(
            rejection.reject(samples, method=method, interval=interval), interval
        )
        errors.append(image["slant_range"].values - _truth(survey, image))
    all_errors = np.stack(errors)
    if min(float(np.isfinite(scan_errors).mean()) for scan_errors in errors) < _SEEN:
        raise SurveyError(
            f"{survey.name!r}: fewer than half of the simulated pixels have a range; "
            "the design does not work at this distance"
        )
    # The mean of all pixels moves from scan to scan with the noise of the shots.
    offset = float(np.nanmean(all_errors))
    squares = np.array(
        [np.nanmean((scan_errors - offset) ** 2) for scan_errors in errors]
    )
    achieved = math.sqrt(float(squares.mean()))
    distance = float(survey.targets[0].position[2])
    prediction = evaluate(
        survey, distance=distance, method=method, interval=interval, late_light=False
    )
    predicted = float(prediction["standard_uncertainty"])
    relative = float(np.std(squares, ddof=1)) / math.sqrt(repeats) / achieved**2
    means = np.array([np.nanmean(scan_errors) for scan_errors in errors])
    return Scans(
        distance=distance,
        predicted=predicted,
        achieved=achieved,
        ratio=achieved / predicted,
        ratio_error=achieved / predicted * relative / 2,
        offset=offset,
        offset_error=float(np.std(means, ddof=1)) / math.sqrt(repeats),
        residual_bias=float(prediction["residual_bias"]),
        ranges=int(np.isfinite(all_errors).sum()),
    )


def _reduced_survey(goal: Goal, chosen: Parameters, distance: float) -> Survey:
    """Survey of an instrument, reduced to few pixels and a plate at one distance."""
    survey = survey_of(goal, chosen)
    scan = survey.scan
    return survey.with_(
        {
            # Its noise is that at rest.
            "platform": None,
            "pose": None,
            "scan.columns": min(scan.columns, _COLUMNS),
            "scan.rows": min(scan.rows, _ROWS),
            "scan.azimuth_span": min(scan.azimuth_span, _SPAN),
            "scan.elevation_span": min(scan.elevation_span, _SPAN * _ROWS / _COLUMNS),
            "targets.0.position": [0.0, 0.0, distance],
        }
    )


def _image(target: xr.Dataset, interval: tuple[float, float] | None) -> xr.Dataset:
    """Range image of the target channel with the smallest range uncertainty."""
    channels = [str(value) for value in target["polarization"].values]
    if "joint_slant_range" in target:
        channels = channels[:1]
    images = [
        imaging.range_image(target, polarization=channel, interval=interval)
        for channel in channels
    ]

    def unsure(image: xr.Dataset) -> float:
        sigma = image["slant_range_uncertainty"].values
        # With the water in them, ranges have their noise alone to be compared by.
        sigma = np.where(np.isnan(sigma), np.sqrt(own_variance(image)), sigma)
        return float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else math.inf

    return min(images, key=unsure)


def _truth(survey: Survey, image: xr.Dataset) -> Floats:
    """Return the true slant range of the plate at each pixel [m]."""
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    forward = survey.targets[0].position[2] - survey.instrument.emitter.position[2]
    if survey.instrument.window is not None:
        from amulor.simulation import geometry

        traced = geometry.trace(geometry.Setup(survey))
        return np.asarray(traced.slant_range)
    return np.asarray(forward / (np.cos(azimuth) * np.cos(elevation)))


def _differences(
    name: str, simulated: Scans, photons: Photons | None, late: float, accuracy: float
) -> list[str]:
    """Return a message for each difference from the prediction beyond its limit."""
    differences = []
    if not simulated.holds:
        differences.append(
            f"{name}: {simulated.ranges} simulated ranges scatter by "
            f"{simulated.ratio:.2f} ± {simulated.ratio_error:.2f} of what is "
            f"predicted, which is to be {HOLDS[0]} to {HOLDS[1]}"
        )
    if photons is None:
        return differences
    for light, ratio, error in (
        ("echo", photons.echo, photons.echo_error),
        ("water before the target", photons.water, photons.water_error),
    ):
        beyond = np.abs(ratio - 1) - 2 * error
        worst = int(np.argmax(beyond))
        if beyond[worst] > LIGHT:
            differences.append(
                f"{name}: by photons the {light} is {ratio[worst]:.2f} "
                f"± {error[worst]:.2f} times that of the model at "
                f"{photons.frequency[worst] / 1e6:.4g} MHz, which is to be within "
                f"{LIGHT:.0%}"
            )
    residual = photons.shift - TAKEN_OFF * late
    beyond = np.abs(residual) - 2 * photons.shift_error
    worst = int(np.argmax(beyond))
    if beyond[worst] > max(2 * late, SHIFT * accuracy):
        differences.append(
            f"{name}: by photons {residual[worst] * 1e3:.2f} ± "
            f"{photons.shift_error[worst] * 1e3:.2f} mm of late light is left in "
            f"ranges at {photons.frequency[worst] / 1e6:.4g} MHz, with "
            f"{late * 1e3:.2f} mm stated as its uncertainty"
        )
    return differences
