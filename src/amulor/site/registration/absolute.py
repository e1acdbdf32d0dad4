r"""Absolute scale of a site and group index of its water, tested by scale bars.

A bar is left out of the adjustment: with its residual v, its stated variance
:math:`\sigma^2`, the derivatives J of its length by the unknowns, the inverse normal
matrix N and :math:`k = N J^T / (\sigma^2 - J N J^T)`, the unknowns change by
:math:`k v`. The covariance C of the unknowns becomes
:math:`(1 + kJ) C (1 + kJ)^T - (1 + kJ) N J^T k^T - k J N (1 + kJ)^T + \sigma^2 k k^T`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from amulor.site.registration.network import KnownDistance, Layout, State, Ties
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]

#: Smallest part of an error of a bar that appears in its residual [1].
_UNCHECKED = 1e-3
#: Smallest change of a length by the group index, as a part of that of free poses [1].
_SENSITIVE = 1e-3
_INDEX = "group_index: "


@dataclass(frozen=True, kw_only=True)
class WaterIndex:
    """Group index of a water body as stated by the survey."""

    value: float
    """Group index [1]."""
    relative_uncertainty: float
    """Standard uncertainty over the value [1]."""


@dataclass(frozen=True, kw_only=True)
class ScaleTest:
    """Scale of a site by a scale bar, which all other observations measure."""

    bar: str
    """Names of both ends."""
    length: float
    """Stated length of the bar [m]."""
    length_uncertainty: float
    """Standard uncertainty of the stated length [m]."""
    measured: float
    """Length between both ends by all other observations [m]."""
    measured_uncertainty: float
    """Standard uncertainty of that length, including the stated group index [m]."""
    scale: float
    """Measured over stated length [1]."""
    scale_uncertainty: float
    """Standard uncertainty of the scale, including the stated group index [1]."""
    score: float
    """Difference of both lengths over its standard uncertainty [1]."""
    chance: float
    """Probability of a difference at least as large, if all is as stated [1]."""
    group_index: float | None
    """Group index for which both lengths agree, as a common factor of all waters; None
    if the length does not depend on it [1]."""
    group_index_uncertainty: float | None
    """Standard uncertainty of this group index, by bar and ranges alone [1]."""
    stated_index: float | None
    """Group index of the survey [1]."""
    stated_index_uncertainty: float | None
    """Standard uncertainty of the survey's group index [1]."""

    @property
    def sentence(self) -> str:
        """Scale, group index and test in words."""
        text = (
            f"bar {self.bar}: {self.measured * 1e3:.2f} +- "
            f"{self.measured_uncertainty * 1e3:.2f} mm by the scans, "
            f"{self.length * 1e3:.2f} +- {self.length_uncertainty * 1e3:.2f} mm "
            f"stated; scale {self.scale:.6f} +- {self.scale_uncertainty:.6f}, "
            f"{self.score:+.1f} standard uncertainties off 1 (probability "
            f"{self.chance:.2g})"
        )
        if self.group_index is None or self.stated_index is None:
            return f"{text}; the length does not depend on the group index"
        return (
            f"{text}; group index by the bar {self.group_index:.5f} +- "
            f"{self.group_index_uncertainty:.5f}, stated {self.stated_index:.5f} +- "
            f"{self.stated_index_uncertainty:.5f}"
        )


def water_indices(surfaces: Mapping[str, ScanSurface]) -> dict[str, WaterIndex]:
    """Return the stated group index by the key of its shared error."""
    waters: dict[str, WaterIndex] = {}
    for surface in surfaces.values():
        for number, key in enumerate(surface.shared.keys):
            if key.startswith(_INDEX) and key not in waters:
                shape, reach = surface.shared.shapes[number], surface.distance
                relative = float(np.median((shape / reach)[surface.usable]))
                value = float(str(surface.attributes["group_index"]))
                waters[key] = WaterIndex(value=value, relative_uncertainty=relative)
    return waters


def scale_tests(
    state: State,
    covariance: Floats,
    layout: Layout,
    ties: Ties,
    waters: Mapping[str, WaterIndex],
    *,
    inverse: Floats | None = None,
) -> tuple[ScaleTest, ...]:
    """Test the scale of a site by each scale bar, left out of the adjustment.

    `inverse` is that of the normal matrix, if it is not the covariance.
    """
    inverse = covariance if inverse is None else inverse
    tests = (
        _tested(bar, state, covariance, inverse, layout, waters) for bar in ties.bars
    )
    return tuple(test for test in tests if test is not None)


def _tested(
    bar: KnownDistance,
    state: State,
    covariance: Floats,
    inverse: Floats,
    layout: Layout,
    waters: Mapping[str, WaterIndex],
) -> ScaleTest | None:
    """Return the test by one bar; None if no other observation checks its length."""
    between = state.points[bar.ends[0]] - state.points[bar.ends[1]]
    adjusted = float(np.linalg.norm(between))
    unit = between / max(adjusted, 1e-9)
    by_unknowns = np.zeros(layout.size)
    by_unknowns[layout.columns("point", bar.ends, 3)] = [*unit, *-unit]
    gain = inverse @ by_unknowns
    free = bar.sigma**2 - float(by_unknowns @ gain)
    if free < _UNCHECKED * bar.sigma**2:
        return None
    change = gain / free
    residual = adjusted - bar.length
    measured = adjusted + float(by_unknowns @ change) * residual
    # The length, and the errors by the group index of each water, without the bar.
    keys = [key for key in waters if ("error", key) in layout.at]
    at = layout.columns("error", keys, 1)
    rows = np.zeros((1 + len(keys), layout.size))
    rows[0] = by_unknowns
    rows[np.arange(len(keys)) + 1, at] = 1.0
    moved, own = rows @ change, rows @ gain
    without = rows + np.outer(moved, by_unknowns)
    of_bar = own + moved * float(by_unknowns @ gain)
    spread = without @ covariance @ without.T
    spread -= np.outer(of_bar, moved) + np.outer(moved, of_bar)
    spread += bar.sigma**2 * np.outer(moved, moved)
    sigma = float(np.sqrt(max(spread[0, 0], 0.0)))
    both = float(np.hypot(sigma, bar.sigma))
    score = (measured - bar.length) / both
    index = index_uncertainty = stated = stated_uncertainty = None
    if keys:
        relative = np.array([waters[key].relative_uncertainty for key in keys])
        stated = float(np.mean([waters[key].value for key in keys]))
        stated_uncertainty = stated * float(np.mean(relative))
        by_index = np.linalg.solve(spread[1:, 1:], spread[1:, 0])
        per_factor = float((by_index / relative).sum())
        if abs(per_factor) > _SENSITIVE * adjusted:
            errors = np.array([state.errors[key] for key in keys])
            errors = errors + moved[1:] * residual
            factor = (bar.length - measured + float(by_index @ errors)) / per_factor
            rest = max(spread[0, 0] - float(by_index @ spread[1:, 0]), 0.0)
            index = stated * (1 + factor)
            index_uncertainty = stated * float(
                np.hypot(bar.sigma, np.sqrt(rest)) / abs(per_factor)
            )
    return ScaleTest(
        bar=" ".join(bar.ends),
        length=bar.length,
        length_uncertainty=bar.sigma,
        measured=measured,
        measured_uncertainty=sigma,
        scale=measured / bar.length,
        scale_uncertainty=both / bar.length,
        score=score,
        chance=float(2 * norm.sf(abs(score))),
        group_index=index,
        group_index_uncertainty=index_uncertainty,
        stated_index=stated,
        stated_index_uncertainty=stated_uncertainty,
    )
