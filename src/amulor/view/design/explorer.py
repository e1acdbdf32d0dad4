"""Model behind the design page: error maps of an instrument, updated by sliders."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.design.evaluate import TERMS, WATERS, evaluate
from amulor.design.geometry import aim_of, with_receiver
from amulor.errors import SurveyError
from amulor.survey import Survey, water_properties
from amulor.view.design.figures import CONTOURS, REGIONS

__all__ = ["Asked", "Explorer"]

Floats = NDArray[np.float64]

#: Places of the map along distance and attenuation.
_SHAPE = (44, 24)


@dataclass(frozen=True)
class _Slider:
    """Parameter of a survey that a slider of the design page adjusts."""

    label: str
    unit: str
    factor: float
    """Factor from SI to the displayed unit."""
    span: float
    """Largest factor by which the slider raises or lowers the value [1]."""
    least: float = 0.0
    most: float = math.inf


_SLIDERS = {
    "power": _Slider("laser power", "mW", 1e3, 30),
    "frequency": _Slider("highest frequency", "MHz", 1e-6, 10, 1e6, 2e9),
    "baseline": _Slider("baseline", "cm", 1e2, 8, 5e-3, 2.0),
    "radius": _Slider("receiver radius", "mm", 1e3, 5, 1e-3, 0.3),
    "field_of_view": _Slider("field of view, half", "deg", 180 / math.pi, 8, 1e-3, 0.4),
    "dwell": _Slider("dwell", "ms", 1e3, 30, 1e-6, 60.0),
    "reflectance": _Slider("reflectance of the target", "%", 1e2, 100, 0.005, 1.0),
}


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Required accuracy at one distance and attenuation: a point on the error map."""

    distance: float
    """Slant range [m]."""
    attenuation: float
    """Attenuation coefficient of the water [1/m]."""
    accuracy: float
    """Largest allowed total error [m]."""


class Explorer:
    """Instrument with adjustable parameters, and maps of its range errors."""

    def __init__(
        self,
        survey: Survey,
        *,
        method: str = "open-water",
        asked: Sequence[Asked] = (),
        interval: tuple[float, float] | None = None,
        distances: tuple[float, float] | None = None,
        attenuations: tuple[float, float] | None = None,
    ) -> None:
        self.survey, self.method = survey, method
        self.asked, self._interval = tuple(asked), interval
        self.own = water_properties(survey)
        near, far = distances or _around(
            [place.distance for place in asked], (0.5, 10), 2
        )
        clear, murky = attenuations or _around(
            [place.attenuation for place in asked] or [max(self.own.attenuation, 1e-2)],
            (0.05, 3.0),
            4,
        )
        self.distance: Floats = np.linspace(near, far, _SHAPE[0])
        self.attenuation: Floats = np.geomspace(clear, murky, _SHAPE[1])
        self._waters: dict[str, Survey] = {"own": survey}

    def describe(self) -> dict[str, Any]:
        """Return the initial content of the design page."""
        channels = "+".join(self.survey.instrument.polarizations)
        light = f"{self.survey.instrument.wavelength * 1e9:.0f} nm"
        return {
            "title": self.survey.name,
            "subtitle": f"{light} · {channels} · water removed by {self.method}",
            "distance": self.distance.tolist(),
            "attenuation": self.attenuation.tolist(),
            "contours": list(CONTOURS),
            "regions": [
                {"label": text, "bit": 1 << number}
                for number, (_, text, _) in enumerate(REGIONS)
            ],
            "terms": [name.replace("_", " ") for name in TERMS],
            "sliders": [self._slider(name) for name in _SLIDERS],
            "waters": [
                {"name": "own", "label": "as in the survey"},
                *({"name": name, "label": text} for name, (text, _) in WATERS.items()),
            ],
            "water": "own",
            "asked": [[place.distance, place.attenuation] for place in self.asked],
        }

    def map(self, settings: Mapping[str, Any], *, water: str = "own") -> dict[str, Any]:
        """Range errors of an instrument over distance and attenuation."""
        begun = time.perf_counter()
        survey, common = self._asked_of(settings, water)
        errors = evaluate(
            survey, distance=self.distance, attenuation=self.attenuation, **common
        ).squeeze(drop=True)
        errors = errors.transpose("attenuation", "distance")
        flags = sum(
            errors[name].values.astype(int) << number
            for number, (name, _, _) in enumerate(REGIONS)
        )
        error = errors["total_error"].values * 1e3
        return {
            "error": [
                float(f"{value:.4g}") if math.isfinite(value) else None
                for value in error.ravel()
            ],
            "flags": np.asarray(flags).ravel().tolist(),
            "term": errors["binding_term"].values.ravel().tolist(),
            "milliseconds": round((time.perf_counter() - begun) * 1e3, 1),
        }

    def as_survey(self, settings: Mapping[str, Any], *, water: str = "own") -> str:
        """Survey file, as text, of an instrument with the settings of the sliders."""
        survey, axes = self._instrument(settings, water)
        frequencies = axes.pop(
            "frequencies", [survey.instrument.modulation_frequencies]
        )
        if "baseline" in axes:
            # The receiver axis keeps its intersection with the beam.
            survey = with_receiver(
                survey, baseline=axes["baseline"], aim=aim_of(survey)
            )
        changes: dict[str, Any] = {
            "instrument.modulation_frequencies": list(frequencies[0])
        }
        if "dwell" in axes:
            time_constant = survey.instrument.lock_in.time_constant
            changes["instrument.lock_in.time_constant"] = min(
                time_constant, axes["dwell"] / 6
            )
        for name, place in (
            ("power", "instrument.power"),
            ("radius", "instrument.receiver.radius"),
            ("field_of_view", "instrument.receiver.acceptance"),
            ("dwell", "scan.dwell"),
        ):
            if name in axes:
                changes[place] = axes[name]
        if "reflectance" in axes:
            for number in range(len(survey.targets)):
                changes[f"targets.{number}.reflectance"] = axes["reflectance"]
        return survey.with_(changes).to_toml()

    def _slider(self, name: str) -> dict[str, Any]:
        slider, value = _SLIDERS[name], self._survey_value(name)
        return {
            "name": name,
            "label": slider.label,
            "unit": slider.unit,
            "factor": slider.factor,
            "scale": "log",
            "value": value,
            "low": max(value / slider.span, slider.least),
            "high": min(value * slider.span, slider.most),
        }

    def _survey_value(self, name: str) -> float:
        """Value in the survey of the parameter that a slider adjusts."""
        instrument = self.survey.instrument
        receiver = instrument.receiver
        apart = np.subtract(receiver.position, instrument.emitter.position)[:2]
        targets = self.survey.targets
        return {
            "power": instrument.power,
            "frequency": instrument.modulation_frequencies[-1],
            "baseline": max(float(np.hypot(*apart)), 0.01),
            "radius": receiver.radius,
            "field_of_view": receiver.acceptance,
            "dwell": self.survey.scan.dwell,
            "reflectance": targets[0].reflectance if targets else 0.2,
        }[name]

    def _instrument(
        self, settings: Mapping[str, Any], water: str
    ) -> tuple[Survey, dict[str, Any]]:
        """Survey with the named water, and the parameters that sliders changed."""
        axes: dict[str, Any] = {}
        for name, setting in settings.items():
            if name not in _SLIDERS:
                raise SurveyError(f"there is no slider {str(name)[:40]!r}")
            if not isinstance(setting, int | float) or not math.isfinite(setting):
                raise SurveyError(
                    f"{name} must be a number, found {str(setting)[:40]!r}"
                )
            if not math.isclose(setting, self._survey_value(name), rel_tol=1e-6):
                axes[name] = float(setting)
        if "frequency" in axes:
            frequencies = self.survey.instrument.modulation_frequencies
            factor = axes.pop("frequency") / frequencies[-1]
            axes["frequencies"] = [[value * factor for value in frequencies]]
        return self._in(water), axes

    def _asked_of(
        self, settings: Mapping[str, Any], water: str
    ) -> tuple[Survey, dict[str, Any]]:
        """Survey with the named water; arguments of `evaluate` common to all points."""
        survey, axes = self._instrument(settings, water)
        return survey, {"method": self.method, "interval": self._interval, **axes}

    def _in(self, name: str) -> Survey:
        """Survey with its water replaced by the water type of the given name."""
        if name not in self._waters:
            if name not in WATERS:
                raise SurveyError(f"there is no water {name[:40]!r}")
            self._waters[name] = self.survey.with_({"water": WATERS[name][1]})
        return self._waters[name]

    def met(
        self, settings: Mapping[str, Any], *, water: str = "own"
    ) -> list[dict[str, Any]]:
        """Verdict on each required accuracy: whether it is met, and why."""
        if not self.asked:
            return []
        survey, common = self._asked_of(settings, water)
        places = [(place.distance, place.attenuation) for place in self.asked]
        distance, attenuation = (
            xr.DataArray(list(values), dims="place")
            for values in zip(*places, strict=True)
        )
        errors = evaluate(survey, distance=distance, attenuation=attenuation, **common)
        errors = errors.squeeze(
            [dim for dim in errors.dims if dim != "place"], drop=True
        )
        verdicts = []
        for number, place in enumerate(self.asked):
            at_place = errors.isel(place=number)
            error = float(at_place["total_error"])
            wrong = [text for name, text, _ in REGIONS if bool(at_place[name])]
            term = TERMS[int(at_place["binding_term"])].replace("_", " ")
            because = ", ".join(wrong) if wrong else f"binds: {term}"
            text = (
                f"{place.distance:.3g} m, {place.attenuation:.2g} 1/m: "
                f"{error * 1e3:.3g} of {place.accuracy * 1e3:.3g} mm; {because}"
            )
            verdicts.append(
                {"text": text, "met": error <= place.accuracy and not wrong}
            )
        return verdicts


def _around(
    values: Sequence[float], usual: tuple[float, float], factor: float
) -> tuple[float, float]:
    """Limits of a map axis around required values; without these, the usual limits."""
    if not values:
        return usual
    return min(values) / factor, max(values) * factor
