"""Forward model of water whose concentration changes with the distance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.simulation.models import SignalModel
from amulor.survey import Survey, WaterProperties
from amulor.survey.instrument_errors import Gradient
from amulor.survey.view import View

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Limits of the slices of water [m]; the light from beyond is that of the last slice.
_LIMITS = np.geomspace(0.05, 30.0, 40)


@dataclass(frozen=True)
class GradientModel:
    """A forward model in water that is stronger or weaker in proportion to distance."""

    model: SignalModel
    """Forward model of uniform water."""
    gradient: Gradient
    """Change of the water with the distance."""

    @property
    def title(self) -> str:
        """Name of the model for cube attributes."""
        change = self.gradient.change_per_meter
        return f"{self.model.title}, water {change:+.3g} per meter"

    @property
    def late_echo(self) -> str:
        """Late light as in the model of uniform water."""
        return self.model.late_echo

    def echo(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        surface: dict[str, Any],
    ) -> Complex:
        """Return target echo power over launched power; see `SignalModel`."""
        echo = self.model.echo(
            modulation_frequency,
            survey=survey,
            water=water,
            view=view,
            surface=surface,
        )
        return echo * self._passed(np.asarray(surface["depth"]), water)

    def column(
        self,
        modulation_frequency: Floats,
        *,
        survey: Survey,
        water: WaterProperties,
        view: View,
        end: Any,
    ) -> Complex:
        """Return water backscatter power over launched power; see `SignalModel`.

        Each slice of the uniform water counts by its concentration, and by the loss on
        the way to it.
        """

        def uniform(end: Any) -> Complex:
            return self.model.column(
                modulation_frequency, survey=survey, water=water, view=view, end=end
            )

        ends = np.asarray(end, dtype=float)
        before = uniform(np.minimum(_LIMITS[0], ends))
        total = before * self._strength(0.5 * _LIMITS[0], water)
        for near, far in pairwise(_LIMITS):
            if near >= np.max(ends):
                return total
            column = uniform(np.minimum(far, ends))
            middle = 0.5 * (near + np.minimum(far, ends))
            total = total + (column - before) * self._strength(middle, water)
            before = column
        return total + (uniform(ends) - before) * self._strength(_LIMITS[-1], water)

    def _strength(self, depth: Floats | float, water: WaterProperties) -> Floats:
        """Return light from a depth, over that of uniform water [1]."""
        concentration = 1 + self.gradient.change_per_meter * np.asarray(depth)
        return np.maximum(concentration, 0.0) * self._passed(depth, water)

    def _passed(self, depth: Floats | float, water: WaterProperties) -> Floats:
        """Return the transmission there and back, over that of uniform water [1]."""
        change = self.gradient.change_per_meter
        reached = np.asarray(depth, dtype=float)
        if change < 0:
            # Without particles, the water does not get clearer.
            reached = np.minimum(reached, -1 / change)
        more = change * reached**2 / 2
        if change < 0:
            more = more - (np.asarray(depth) - reached)
        return np.asarray(np.exp(-2 * water.reduced_attenuation * more))


def with_gradient(model: SignalModel, survey: Survey) -> SignalModel:
    """Return the model with the gradient of a survey, if the survey states one."""
    errors = survey.instrument.errors
    if errors is None or errors.gradient is None:
        return model
    return GradientModel(model, errors.gradient)
