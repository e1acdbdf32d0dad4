"""Light of a survey, computed once for all tests that acquire this survey."""

from __future__ import annotations

import dataclasses

from amulor import simulation
from amulor.simulation.scene_light import SceneLight
from amulor.survey import Survey

_LIGHT: dict[str, SceneLight] = {}


def scene_light(survey: Survey) -> SceneLight:
    """Return the light by the default model; its arrays cannot be written to."""
    key = survey.model_dump_json()
    if key not in _LIGHT:
        light = simulation.scene_light(survey)
        for part in (light.with_target, light.open_water):
            for field in dataclasses.fields(part):
                getattr(part, field.name).flags.writeable = False
        _LIGHT[key] = light
    return _LIGHT[key]
