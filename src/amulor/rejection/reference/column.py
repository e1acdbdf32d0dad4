"""Water column behind the target: the part of open water that the target hides."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from amulor._chebyshev import BoxSeries
from amulor.optics import ambiguity, detection, ranging, rays
from amulor.rejection.covariance import Covariance, along, isotropic
from amulor.rejection.observation import Observation
from amulor.rejection.reference.model import water_signal
from amulor.survey import Survey, water_properties
from amulor.survey.reach import unsettled_interval
from amulor.survey.view import medium_of, view

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
_Function = Callable[[Floats], Complex]

#: Largest error of an interpolated fraction, in parts of the open-water signal [1].
LARGEST_ERROR = 1e-4
#: Nodes along azimuth, elevation and depth of the tables that are tried in turn.
_NODES = ((5, 5, 9), (5, 5, 17), (9, 9, 33), (17, 17, 65))
#: Pixels at which a table is compared with the integral.
_CHECKS = 192
#: A table with more nodes than this fraction of the pixels would not pay [1].
_WORTH = 0.5
#: Pixels that are integrated one after the other, not by a table of their own.
_ALONE = 32
#: Largest number of values per step, which limits the memory.
_AT_ONCE = 2_000_000


class Column(Protocol):
    """Fractions of the open-water signal behind the targets of a scan."""

    def fractions(self, places: Floats) -> Complex:
        """Return the fractions at azimuths, elevations and depths, (frequency, n)."""
        ...


def fractions(
    survey: Survey,
    azimuth: Floats,
    elevation: Floats,
    depth: Floats,
    *,
    modulation_frequency: Floats,
    paper: bool = False,
) -> Complex:
    """Return the fraction of the open-water signal from behind given depths.

    Of beams of given azimuth and elevation [rad] and depth [m], shape (frequency, n),
    exact or within `LARGEST_ERROR` [1]. `paper` is as for `model.water_signal`.
    """
    places = np.stack([azimuth, elevation, depth])
    column = column_of(survey, places, modulation_frequency, paper=paper)
    return column.fractions(places)


def column_of(
    survey: Survey, places: Floats, frequency: Floats, *, paper: bool
) -> Column:
    """Return the fractions behind the targets of a scan: a table, or exact integrals.

    The quotient of the water signal of `model.water_signal` from the depth on and as a
    whole. Freed of the delay exp(2 i k z) it is smooth in direction and depth, so a
    product of Chebyshev polynomials follows it. A table counts only if, at pixels
    spread over the scan, it agrees with the integral to half of `LARGEST_ERROR`; if
    none of four does, every pixel is integrated. The table with the fewest nodes that
    is good enough is taken, if it pays.
    """
    count = places.shape[1]
    exact: Complex | None = None
    for nodes in _NODES if count else ():
        table = _Table(survey, places, nodes, frequency, paper=paper)
        if table.size > _WORTH * count:
            break
        table.fill()
        if exact is None:
            checks = places[:, _spread(places)]
            exact = integrated(survey, checks, frequency, paper=paper)
        if np.abs(table.fractions(checks) - exact).max() <= LARGEST_ERROR / 2:
            return table
    return _Listed(survey, places, frequency, paper=paper)


class _Listed:
    """Hidden fractions at all pixels of a scan, from one integration over depth.

    Separate integration would change their last digits.
    """

    def __init__(
        self, survey: Survey, places: Floats, frequency: Floats, *, paper: bool
    ) -> None:
        self._survey, self._places, self._frequency = survey, places, frequency
        self._paper = paper
        self._values = self._integrated(places)
        self._index: dict[bytes, int] | None = None

    def fractions(self, places: Floats) -> Complex:
        """Return the hidden fractions at places, shape (frequencies, n)."""
        if places is self._places:
            return self._values
        if self._index is None:
            listed = np.ascontiguousarray(self._places.T)
            self._index = {place.tobytes(): k for k, place in enumerate(listed)}
        wanted = np.ascontiguousarray(places.T)
        index = np.array(
            [self._index.get(place.tobytes(), -1) for place in wanted], dtype=int
        )
        stored = self._values[:, index] if self._values.size else None
        if stored is None or np.any(index < 0):
            new = index < 0
            result = np.empty((len(self._frequency), len(index)), dtype=complex)
            if stored is not None:
                result[:, ~new] = stored[:, ~new]
            result[:, new] = self._integrated(places[:, new])
            return result
        return stored

    def _integrated(self, places: Floats) -> Complex:
        return _in_parts(
            lambda part: integrated(
                self._survey, part, self._frequency, paper=self._paper
            ),
            places,
            self._frequency,
        )


class _Table:
    """Chebyshev series of hidden fractions over azimuth, elevation and depth."""

    def __init__(
        self,
        survey: Survey,
        places: Floats,
        nodes: tuple[int, int, int],
        frequency: Floats,
        *,
        paper: bool,
    ) -> None:
        low, high = places.min(axis=1), places.max(axis=1)
        self._low, self._high = low, high
        self._survey, self._frequency, self._paper = survey, frequency, paper
        self._phase_per_range = ranging.phase_per_range(
            frequency, group_index=water_properties(survey).group_index
        )
        self._series = BoxSeries(low, high, nodes)
        self.size = self._series.size

    def fill(self) -> None:
        """Integrate the water signal at the nodes, and compute the coefficients."""
        places = self._series.places()
        value = integrated(self._survey, places, self._frequency, paper=self._paper)
        value *= np.exp(-1j * np.outer(self._phase_per_range, places[2]))
        self._series.fill(value)

    def fractions(self, places: Floats) -> Complex:
        """Return the fractions at given places, integrated where outside the table."""
        inside = (places >= self._low[:, None]) & (places <= self._high[:, None])
        within = inside.all(axis=0)
        if within.all():
            return self.at(places)
        result = np.empty((len(self._frequency), places.shape[1]), dtype=complex)
        result[:, within] = self.at(places[:, within])
        # A few at a time: so they do not depend on each other.
        outside = np.flatnonzero(~within)
        for first in range(0, outside.size, _ALONE):
            some = outside[first : first + _ALONE]
            result[:, some] = integrated(
                self._survey, places[:, some], self._frequency, paper=self._paper
            )
        return result

    def at(self, places: Floats) -> Complex:
        """Return the fractions at places inside the table, shape (frequency, n)."""
        value = self._series.at(places)
        value *= np.exp(1j * np.outer(self._phase_per_range, places[2]))
        return value


def _spread(places: Floats) -> NDArray[np.intp]:
    """Select pixels distributed over the scan, including the extremes of each axis."""
    count = places.shape[1]
    even = np.linspace(0, count - 1, min(_CHECKS, count)).astype(int)
    extremes = np.concatenate([places.argmin(axis=1), places.argmax(axis=1)])
    return np.unique(np.concatenate([even, extremes]))


def _in_parts(function: _Function, places: Floats, frequency: Floats) -> Complex:
    """Evaluate a function in blocks of pixels, to limit memory."""
    count = places.shape[1]
    out = np.empty((len(frequency), count), dtype=complex)
    step = max(1, _AT_ONCE // len(frequency))
    for first in range(0, count, step):
        part = slice(first, first + step)
        out[:, part] = function(places[:, part])
    return out


def integrated(
    survey: Survey, places: Floats, frequency: Floats, *, paper: bool = False
) -> Complex:
    """Return the fractions by integration at each pixel, shape (frequency, n) [1]."""
    azimuth, elevation, depth = places
    # Open water does not depend on the depth: once for each direction.
    beams, beam = np.unique(places[:2], axis=1, return_inverse=True)
    form = partial(water_signal, survey, modulation_frequency=frequency, paper=paper)
    open_water = form(view(survey, *beams))[:, beam]
    behind = open_water - form(view(survey, azimuth, elevation), end=depth)
    # A receiver without water signal has no water behind the target either.
    fraction: Complex = np.divide(
        behind, open_water, out=np.zeros_like(behind), where=open_water != 0
    )
    return fraction


def hidden_fraction(
    scan: Observation,
    survey: Survey,
    depth: NDArray[np.float64],
    *,
    paper: bool = False,
    fit: Column | None = None,
) -> tuple[NDArray[np.complex128], Column]:
    """Return the fraction of open water from behind the target, and its model.

    Fraction of the open-water signal over (modulation_frequency, polarization, row,
    column), complex since it comes later [1], NaN where the depth [m] is not settled;
    and the fractions over the scan that it was taken from, `fit` if it is stated. The
    survey describes the water: what the user knew beforehand, perhaps corrected by the
    shots.

    Decision on (46) of Ricci et al. 2010, as rederived: open water is integrated to its
    end, water with a target to the target; the difference stays when open water is
    subtracted. Large scans take the fraction from a table over directions and depths,
    see `column_of`.
    """
    settled = np.isfinite(depth)
    frequency = scan.frequency
    fraction = np.full((frequency.size, *depth.shape), np.nan, dtype=complex)
    places = np.stack([scan.azimuth[settled], scan.elevation[settled], depth[settled]])
    if fit is None:
        fit = column_of(survey, places, frequency, paper=paper)
    fraction[:, settled] = fit.fractions(places)
    shape = (frequency.size, len(scan.polarizations), *depth.shape)
    return np.broadcast_to(fraction[:, None], shape), fit


def hidden_error(
    water_signal: NDArray[np.complex128],
    fraction: NDArray[np.complex128],
    steeper: NDArray[np.complex128],
    *,
    misfit: float,
) -> Covariance:
    """Return the covariance of the water signal from behind targets, added back.

    The turbidity moves the column along a known direction. A model that is off by so
    much of the whole column is off by as much of a part of it, at most by all of that
    part; compared at the lowest frequency. With several frequencies all of it may
    turn the phase; with one, whose misfit is a bound by itself, it has any direction.
    """
    hidden = np.nan_to_num(fraction)
    # Both errors belong to the model, so that frequencies share them: stated for each
    # sample as if they did not, they must be larger by what a mean would take off.
    frequencies = len(water_signal)
    by_turbidity = (np.nan_to_num(steeper) - hidden) * water_signal * frequencies**0.5
    size = np.abs(hidden * water_signal)
    # At high frequencies the whole column cancels itself and the part behind an edge
    # does not, so the lowest frequency tells how wrong the model is of that part.
    allowed = misfit * np.abs(water_signal[:1])
    relative = np.divide(
        allowed, size[:1], out=np.ones(size[:1].shape), where=size[:1] > allowed
    )
    by_model = isotropic(relative * size).scaled(
        2 * frequencies if frequencies > 1 else 1
    )
    return along(by_turbidity, 1.0) + by_model


def depth(
    scan: Observation,
    signal: NDArray[np.complex128],
    uncertainty: Covariance,
    survey: Survey,
    *,
    interval: tuple[float, float] | None,
    fit: ambiguity.Choices | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], ambiguity.Choices | None]:
    """Return water depth and optical path to the target, and ambiguity decisions.

    Both lengths over (row, column), NaN where the distance is not settled [m]; and the
    choices between frequencies that all pixels share, `fit` if it is given. The signal
    is that of the target so far, from whose phase the distance is taken [V].
    """
    shape, frequency = signal.shape[2:], scan.frequency
    if interval is None and unsettled_interval(survey, modulation_frequency=frequency):
        return np.full(shape, np.nan), np.full(shape, np.nan), fit
    surroundings = medium_of(survey)
    beam = rays.enter_water(
        survey.instrument.emitter.position,
        rays.direction(scan.azimuth, scan.elevation),
        medium=surroundings,
    )
    receiver = np.asarray(survey.instrument.receiver.position)
    # A common depth for all channels, from the sum of their target signals.
    summed = np.nansum(signal, axis=1)
    detected = (np.isfinite(signal).any(axis=1) & (summed != 0)).all(axis=0)
    sigma = detection.phase_uncertainty(
        np.where(detected, summed, 1.0),
        in_phase_variance=np.nansum(uncertainty.in_phase, axis=1),
        quadrature_variance=np.nansum(uncertainty.quadrature, axis=1),
        covariance=np.nansum(uncertainty.cross, axis=1),
    )
    shortest, longest = rays.path_limits(
        interval,
        beam,
        receiver,
        medium=surroundings,
        modulation_frequency=frequency,
    )
    arguments: dict[str, Any] = {
        "phase": np.where(detected, np.angle(np.where(detected, summed, 1.0)), 0.0),
        "uncertainty": sigma,
        "modulation_frequency": frequency,
        "shortest": shortest,
        "longest": longest,
        # What is behind the target is still in the phases: they may disagree.
        "doubt": np.inf,
    }
    if fit is None:
        path, fit = ambiguity.fit(**arguments)
    else:
        path = ambiguity.optical_path(**arguments, choices=fit)
    slant_range = rays.slant_range_of_path(
        path.length, beam, receiver, medium=surroundings
    )
    depths = np.maximum(slant_range - beam.length_before, 0.0)
    settled = detected & path.settled
    return (
        np.where(settled, depths, np.nan),
        np.where(settled, path.length, np.nan),
        fit,
    )
