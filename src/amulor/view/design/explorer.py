"""What the page with sliders shows: any instrument's map, fast enough to drag."""

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
    """One number that can be dragged."""

    label: str
    unit: str
    factor: float
    """From SI to what is shown."""
    span: float
    """Largest change up and down, as a factor."""
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
    """One place of the map where an accuracy is asked for."""

    distance: float
    """Slant range [m]."""
    attenuation: float
    """Attenuation coefficient of the water [1/m]."""
    accuracy: float
    """Total error that is allowed [m]."""


class Explorer:
    """An instrument whose numbers are dragged, and the map of its errors."""

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
        near, far = distances or _around([one.distance for one in asked], (0.5, 10), 2)
        clear, murky = attenuations or _around(
            [one.attenuation for one in asked] or [max(self.own.attenuation, 1e-2)],
            (0.05, 3.0),
            4,
        )
        self.distance: Floats = np.linspace(near, far, _SHAPE[0])
        self.attenuation: Floats = np.geomspace(clear, murky, _SHAPE[1])
        self._waters: dict[str, Survey] = {"own": survey}

    def describe(self) -> dict[str, Any]:
        """Return what the page begins with."""
        channels = "+".join(self.survey.instrument.polarizations)
        light = f"{self.survey.instrument.wavelength * 1e9:.0f} nm"
        return {
            "title": self.survey.name,
            "subtitle": f"{light} · {channels} · water taken out by {self.method}",
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
            "asked": [[one.distance, one.attenuation] for one in self.asked],
        }

    def map(self, settings: Mapping[str, Any], *, water: str = "own") -> dict[str, Any]:
        """Return the errors of an instrument over the map."""
        begun = time.perf_counter()
        survey, common = self._asked_of(settings, water)
        found = evaluate(
            survey, distance=self.distance, attenuation=self.attenuation, **common
        ).squeeze(drop=True)
        found = found.transpose("attenuation", "distance")
        flags = sum(
            found[name].values.astype(int) << number
            for number, (name, _, _) in enumerate(REGIONS)
        )
        error = found["total_error"].values * 1e3
        return {
            "error": [
                float(f"{value:.4g}") if math.isfinite(value) else None
                for value in error.ravel()
            ],
            "flags": np.asarray(flags).ravel().tolist(),
            "term": found["binding_term"].values.ravel().tolist(),
            "milliseconds": round((time.perf_counter() - begun) * 1e3, 1),
        }

    def as_survey(self, settings: Mapping[str, Any], *, water: str = "own") -> str:
        """Return an instrument as the text of a survey file."""
        survey, axes = self._instrument(settings, water)
        frequencies = axes.pop(
            "frequencies", [survey.instrument.modulation_frequencies]
        )
        if "baseline" in axes:
            # The receiver keeps looking at the same place of the beam.
            survey = with_receiver(
                survey, baseline=axes["baseline"], aim=aim_of(survey)
            )
        changes: dict[str, Any] = {
            "instrument.modulation_frequencies": list(frequencies[0])
        }
        if "dwell" in axes:
            own = survey.instrument.lock_in.time_constant
            changes["instrument.lock_in.time_constant"] = min(own, axes["dwell"] / 6)
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
        one, value = _SLIDERS[name], self._stated(name)
        return {
            "name": name,
            "label": one.label,
            "unit": one.unit,
            "factor": one.factor,
            "scale": "log",
            "value": value,
            "low": max(value / one.span, one.least),
            "high": min(value * one.span, one.most),
        }

    def _stated(self, name: str) -> float:
        """Return the survey's own value of a slider."""
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
        """Return the survey in a water, and the axes that sliders have moved."""
        axes: dict[str, Any] = {}
        for name, given in settings.items():
            if name not in _SLIDERS:
                raise SurveyError(f"there is no slider {str(name)[:40]!r}")
            if not isinstance(given, int | float) or not math.isfinite(given):
                raise SurveyError(f"{name} must be a number, found {str(given)[:40]!r}")
            if not math.isclose(given, self._stated(name), rel_tol=1e-6):
                axes[name] = float(given)
        if "frequency" in axes:
            own = self.survey.instrument.modulation_frequencies
            factor = axes.pop("frequency") / own[-1]
            axes["frequencies"] = [[value * factor for value in own]]
        return self._in(water), axes

    def _asked_of(
        self, settings: Mapping[str, Any], water: str
    ) -> tuple[Survey, dict[str, Any]]:
        """Return a survey, and what `evaluate` is asked besides distances."""
        survey, axes = self._instrument(settings, water)
        return survey, {"method": self.method, "interval": self._interval, **axes}

    def _in(self, name: str) -> Survey:
        """Return the survey in a water that goes by a name."""
        if name not in self._waters:
            if name not in WATERS:
                raise SurveyError(f"there is no water {name[:40]!r}")
            self._waters[name] = self.survey.with_({"water": WATERS[name][1]})
        return self._waters[name]

    def met(
        self, settings: Mapping[str, Any], *, water: str = "own"
    ) -> list[dict[str, Any]]:
        """Return whether an instrument meets what is asked for, place by place."""
        if not self.asked:
            return []
        survey, common = self._asked_of(settings, water)
        places = [(one.distance, one.attenuation) for one in self.asked]
        distance, attenuation = (
            xr.DataArray(list(values), dims="place")
            for values in zip(*places, strict=True)
        )
        found = evaluate(survey, distance=distance, attenuation=attenuation, **common)
        found = found.squeeze([dim for dim in found.dims if dim != "place"], drop=True)
        said = []
        for number, one in enumerate(self.asked):
            here = found.isel(place=number)
            error = float(here["total_error"])
            wrong = [text for name, text, _ in REGIONS if bool(here[name])]
            term = TERMS[int(here["binding_term"])].replace("_", " ")
            because = ", ".join(wrong) if wrong else f"binds: {term}"
            text = (
                f"{one.distance:.3g} m, {one.attenuation:.2g} 1/m: {error * 1e3:.3g} "
                f"of {one.accuracy * 1e3:.3g} mm; {because}"
            )
            said.append({"text": text, "met": error <= one.accuracy and not wrong})
        return said


def _around(
    values: Sequence[float], usual: tuple[float, float], factor: float
) -> tuple[float, float]:
    """Return ends of a map around what is asked for."""
    if not values:
        return usual
    return min(values) / factor, max(values) * factor
