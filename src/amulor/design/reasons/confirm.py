"""Whether a design holds: scans simulated and worked on, and photons followed."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import _progress, imaging, rejection
from amulor.design.candidates import Parameters, survey_of
from amulor.design.evaluate import evaluate
from amulor.design.goal import Goal
from amulor.design.photons import Photons, follow_photons
from amulor.errors import SurveyError
from amulor.imaging.common import own_variance
from amulor.simulation import simulate
from amulor.survey import Survey

__all__ = ["Confirmation", "Scans", "confirm", "scans"]

Floats = NDArray[np.float64]

#: Pixels of a scan that is simulated, and the largest angle between its edges [rad].
_COLUMNS, _ROWS, _SPAN = 16, 9, 4e-3
#: Share of the pixels that must have a range.
_SEEN = 0.5
#: Achieved over predicted uncertainty within which a prediction holds [1].
HOLDS = (0.9, 1.1)
#: Relative difference of light up to which model and photons agree [1].
LIGHT = 0.1
#: What imaging takes off for late light over the uncertainty that it states for that:
#: three quarters of the delay by the phase function, over the root of 15 % of this
#: squared and half the delay, rectangular, squared; `amulor.imaging.late_light` [1].
TAKEN_OFF = 0.75 / math.hypot(0.15 * 0.75, 0.5 / math.sqrt(12))
#: Share of the accuracy asked for up to which a shift by late light does not matter.
SHIFT = 0.25


@dataclass(frozen=True, kw_only=True)
class Scans:
    """Simulated scans against what was predicted for them."""

    distance: float
    """Slant range of the target [m]."""
    predicted: float
    """Standard uncertainty of one pixel by `evaluate` [m]."""
    achieved: float
    """Scatter of the ranges about their mean [m]."""
    ratio: float
    """Achieved over predicted [1]."""
    ratio_error: float
    """Standard error of the ratio, from the scatter between scans [1]."""
    offset: float
    """Mean range less the true one [m]."""
    offset_error: float
    """Standard error of it [m]."""
    residual_bias: float
    """Bias that `evaluate` states, without late light, which scans do not have [m]."""
    ranges: int
    """Number of ranges."""

    @property
    def holds(self) -> bool:
        """Whether the ratio is within 0.9 to 1.1, give or take two standard errors."""
        low, high = HOLDS
        margin = 2 * self.ratio_error
        return low - margin <= self.ratio <= high + margin


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """What scans and photons say of one instrument."""

    name: str
    """Which instrument."""
    scans: Scans
    """Simulated scans."""
    photons: Photons | None
    """Photons; None where they cannot follow the water or the beam."""
    late: float
    """Standard uncertainty that the prediction states for late light [m]."""
    said: tuple[str, ...]
    """One line for each thing that differs by more than is stated."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, texts and lists."""
        photons = None
        if self.photons is not None:
            photons = {
                name: value.tolist() if isinstance(value, np.ndarray) else value
                for name, value in asdict(self.photons).items()
            }
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
    """Simulate scans of an instrument, work on them, and follow photons through it."""
    distance = goal.asked[-1]
    survey = _small(goal, chosen, distance)
    with _progress.part(0.0, 0.6):
        seen = scans(
            survey, chosen.method, interval=goal.limits, repeats=repeats, seed=seed
        )
    late = float(
        evaluate(survey, distance=distance, method=chosen.method, interval=goal.limits)[
            "late_light"
        ]
    )
    said: list[str] = []
    photons: Photons | None = None
    try:
        with _progress.part(0.6, 1.0):
            photons = follow_photons(
                survey, histories=histories, seed=seed, progress=_progress.tell
            )
    except SurveyError as error:
        said.append(f"{name}: photons were not followed: {error}")
    said = [*_said(name, seen, photons, late, goal.accuracy.total_error), *said]
    return Confirmation(
        name=name, scans=seen, photons=photons, late=late, said=tuple(said)
    )


def scans(
    survey: Survey,
    method: str,
    *,
    interval: tuple[float, float] | None = None,
    repeats: int = 12,
    seed: int = 1,
) -> Scans:
    """Simulate scans, take the water out, and compare ranges with their prediction."""
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
    every = np.stack(errors)
    if min(float(np.isfinite(one).mean()) for one in errors) < _SEEN:
        raise SurveyError(
            f"{survey.name!r}: fewer than half of the simulated pixels have a range; "
            "the design does not work at this distance"
        )
    # The mean of all pixels moves from scan to scan with the noise of the shots.
    offset = float(np.nanmean(every))
    squares = np.array([np.nanmean((one - offset) ** 2) for one in errors])
    achieved = math.sqrt(float(squares.mean()))
    distance = float(survey.targets[0].position[2])
    found = evaluate(
        survey, distance=distance, method=method, interval=interval, late_light=False
    )
    predicted = float(found["standard_uncertainty"])
    relative = float(np.std(squares, ddof=1)) / math.sqrt(repeats) / achieved**2
    means = np.array([np.nanmean(one) for one in errors])
    return Scans(
        distance=distance,
        predicted=predicted,
        achieved=achieved,
        ratio=achieved / predicted,
        ratio_error=achieved / predicted * relative / 2,
        offset=offset,
        offset_error=float(np.std(means, ddof=1)) / math.sqrt(repeats),
        residual_bias=float(found["residual_bias"]),
        ranges=int(np.isfinite(every).sum()),
    )


def _small(goal: Goal, chosen: Parameters, distance: float) -> Survey:
    """Return the survey of an instrument with few pixels, target at a distance."""
    survey = survey_of(goal, chosen)
    scan = survey.scan
    return survey.with_(
        {
            "scan.columns": min(scan.columns, _COLUMNS),
            "scan.rows": min(scan.rows, _ROWS),
            "scan.azimuth_span": min(scan.azimuth_span, _SPAN),
            "scan.elevation_span": min(scan.elevation_span, _SPAN * _ROWS / _COLUMNS),
            "targets.0.position": [0.0, 0.0, distance],
        }
    )


def _image(target: xr.Dataset, interval: tuple[float, float] | None) -> xr.Dataset:
    """Return the range image of the channel that is the surest."""
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
    """Return the slant range of the plate, which stands across the forward axis [m]."""
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    forward = survey.targets[0].position[2] - survey.instrument.emitter.position[2]
    if survey.instrument.window is not None:
        from amulor.simulation import geometry

        traced = geometry.trace(survey)
        return np.asarray(traced.slant_range)
    return np.asarray(forward / (np.cos(azimuth) * np.cos(elevation)))


def _said(
    name: str, seen: Scans, photons: Photons | None, late: float, accuracy: float
) -> list[str]:
    """Return what differs by more than is stated, a line each."""
    said = []
    if not seen.holds:
        said.append(
            f"{name}: {seen.ranges} simulated ranges scatter by {seen.ratio:.2f} "
            f"± {seen.ratio_error:.2f} of what is predicted, which is to be "
            f"{HOLDS[0]} to {HOLDS[1]}"
        )
    if photons is None:
        return said
    for light, ratio, error in (
        ("echo", photons.echo, photons.echo_error),
        ("water before the target", photons.water, photons.water_error),
    ):
        beyond = np.abs(ratio - 1) - 2 * error
        worst = int(np.argmax(beyond))
        if beyond[worst] > LIGHT:
            said.append(
                f"{name}: by photons the {light} is {ratio[worst]:.2f} "
                f"± {error[worst]:.2f} times that of the model at "
                f"{photons.frequency[worst] / 1e6:.4g} MHz, which is to be within "
                f"{LIGHT:.0%}"
            )
    left = photons.shift - TAKEN_OFF * late
    beyond = np.abs(left) - 2 * photons.shift_error
    worst = int(np.argmax(beyond))
    if beyond[worst] > max(2 * late, SHIFT * accuracy):
        said.append(
            f"{name}: by photons {left[worst] * 1e3:.2f} ± "
            f"{photons.shift_error[worst] * 1e3:.2f} mm of late light is left in "
            f"ranges at {photons.frequency[worst] / 1e6:.4g} MHz, with "
            f"{late * 1e3:.2f} mm stated as its uncertainty"
        )
    return said
