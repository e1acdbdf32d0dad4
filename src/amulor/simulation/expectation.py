"""Expected hits, signal, water signal and overload of a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.simulation import geometry as geometry_of
from amulor.simulation import lock_in
from amulor.simulation.models import DEFAULT_MODEL, SignalModel
from amulor.survey import Survey

__all__ = ["Expectation", "expectation"]

Floats = NDArray[np.float64]

#: Most beams along each side of the scan.
_BEAMS = 25


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """Expected samples of a scan; NaN where no beam meets a target.

    Examples
    --------
    >>> from amulor import Survey, simulation
    >>> from amulor.simulation.expectation import expectation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...     }
    ... )
    >>> found = expectation(survey, model=simulation.ClosureModel())
    >>> found.hit, found.saturated
    (1.0, 0.0)
    """

    hit: float
    """Share of the beams that meet a target [1]."""
    hit_each: tuple[float, ...]
    """Share of the beams that meet each target of the survey [1]."""
    saturated: float
    """Share of the samples that overload the detector [1]."""
    signal_to_noise: Floats
    """Median echo over its standard uncertainty, (modulation_frequency, polarization)
    [1]."""
    water_to_echo: Floats
    """Median of the water in front of the target over the echo, of the same shape
    [1]."""


def expectation(survey: Survey, *, model: SignalModel = DEFAULT_MODEL) -> Expectation:
    """Estimate the samples of a scan from a few of its beams.

    Parameters
    ----------
    survey : Survey
        What is to be measured, and with what.
    model : SignalModel
        Forward model; the small-angle form with the whole phase function by default.

    Returns
    -------
    Expectation
        From at most 25 x 25 beams, spread evenly from edge to edge.

    Raises
    ------
    SurveyError
        As `amulor.simulate`.
    MissingExtraError
        If there are targets and the extra `scene` is not installed.

    Notes
    -----
    The uncertainty is that of one sample: counting, dark counts, daylight and the phase
    floor; the water's fluctuation is not noise of the instrument.

    Examples
    --------
    >>> from amulor import Survey
    >>> from amulor.simulation import ClosureModel
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...     }
    ... )
    >>> found = expectation(survey, model=ClosureModel())
    >>> found.hit, bool(found.signal_to_noise[0, 0] > 100)
    (1.0, True)
    """
    scan = survey.scan
    coarse = survey.with_(
        {
            "scan.columns": min(scan.columns, _BEAMS),
            "scan.rows": min(scan.rows, _BEAMS),
        }
    )
    setup = geometry_of.Setup(coarse)
    geometry = geometry_of.trace(setup)
    echo = lock_in.target_light(setup, geometry, model=model)
    column = lock_in.water_light(setup, geometry.view, end=geometry.depth, model=model)
    samples = lock_in.sample(setup, echo, column, rng=np.random.default_rng(0))
    noise = np.sqrt((samples.in_phase_variance + samples.quadrature_variance) / 2)
    size = np.abs(lock_in.expected_signal(setup, echo))
    behind = np.abs(lock_in.expected_signal(setup, column))
    met = geometry.target >= 0
    number = range(len(survey.targets))
    return Expectation(
        hit=float(met.mean()),
        hit_each=tuple(float((geometry.target == index).mean()) for index in number),
        saturated=float((samples.saturated != 0).mean()),
        signal_to_noise=_median(size / noise, met),
        water_to_echo=_median(
            np.divide(behind, size, out=np.full(size.shape, np.inf), where=size > 0),
            met,
        ),
    )


def _median(values: Floats, met: NDArray[np.bool_]) -> Floats:
    """Return the median over the beams that meet a target."""
    if not met.any():
        return np.full(values.shape[:2], np.nan)
    return np.asarray(np.median(values[:, :, met], axis=-1))
