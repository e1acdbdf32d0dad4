"""The open-water shots of a cube: their fit at its pixels, and what it refuses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.tiles import Span, span_of
from amulor.errors import CubeError
from amulor.rejection.covariance import (
    Covariance,
    common_covariance_of,
    covariance_of,
    stacked,
)
from amulor.rejection.reference import fit as reference
from amulor.rejection.reference.drift import NO_DRIFT, Drift
from amulor.rejection.reference.places import FEWEST_SHOTS
from amulor.rejection.reference.scatter import fluctuation
from amulor.rejection.reference.shape import ModelBehindShots, model_behind_shots
from amulor.rejection.reference.surface import Surface
from amulor.survey import Survey

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Drift of the reference that chance makes in less than 1 of 1000 scans is real [1].
_REAL_DRIFT = 1e-3
#: A larger change from the first to the last shot is another water [1].
LARGEST_DRIFT = 0.2
#: It must exceed that by so many of its own standard uncertainties [1].
_SURE = 3.0
_AXES = ("azimuth", "elevation")
#: How far the scan may go beyond the shots: a fraction of their span, at least that
#: [rad].
_BEYOND, BEYOND_AT_LEAST = 0.1, 1e-4
#: Directions count as one that are nearer than this fraction of the span of all [1], or
#: than so many standard deviations by which a scanner misses what it is sent to [1].
_NEAR, _MISSES = 1 / 50, 8.0


def shots_of(cube: xr.Dataset) -> xr.Dataset:
    """Return the open-water shots of a cube; CubeError if they are none or too few."""
    shots: xr.Dataset | None = cube.amulor.open_water
    if shots is None:
        raise CubeError(
            "the cube has no open-water shots (group open_water); record them with the "
            "target out of the beam, or use a method that needs none: joint with two "
            "or more frequencies, polarization with both ratios stated, or "
            "cross-polarized"
        )
    if shots.sizes["shot"] < FEWEST_SHOTS:
        raise CubeError(
            f"the cube has {shots.sizes['shot']} open-water shots, needed are at least "
            f"{FEWEST_SHOTS} to judge how much the water signal fluctuates; record more"
        )
    return shots


@dataclass(frozen=True, kw_only=True)
class ShotsFit:
    """What the open-water shots and the directions of all pixels tell."""

    span: Span
    """Directions of the scan."""
    directions: Floats
    """Azimuth and elevation of the shots, equal where they were sent to the same
    [rad]."""
    model: ModelBehindShots | None
    """Model relative to which they are interpolated, if there is one."""
    surfaces: tuple[Surface, ...]
    """Polynomial of each modulation frequency, channel by channel."""


def fit_shots(
    cube: xr.Dataset,
    shots: xr.Dataset,
    *,
    fit: ShotsFit | None = None,
    span: Span | None = None,
) -> tuple[list[reference.Reference], ShotsFit]:
    """Return the water signal of the shots at the pixels of a cube, and their fit.

    Modulation frequency by frequency, channel by channel. CubeError if too few shots of
    a channel are numbers, the scan goes beyond them, or the water changed too much from
    the first to the last.
    """
    pixels = np.stack(
        [cube["azimuth"].values.ravel(), cube["elevation"].values.ravel()], axis=1
    )
    known = all(name in shots for name in _AXES)
    if fit is None:
        span = span_of(cube) if span is None else span
        places = directions_of(cube, shots)
    else:
        span, places = fit.span, fit.directions
    signal = shots.amulor.signal.values
    errors = covariance_of(shots)
    usable = np.isfinite(signal + errors.in_phase + errors.quadrature + errors.cross)
    if known:
        _refuse_a_scan_beyond_the_shots(cube, places, span)
    shared = common_covariance_of(shots) if "common_covariance" in shots else None
    model = None if fit is None else fit.model
    if known and fit is None:
        model = model_behind_shots(
            cube, places, signal=signal, errors=errors, span=span
        )
    shapes = None
    if model is not None:
        shapes = model.over(pixels, cube["modulation_frequency"].values)
    fits: list[reference.Reference] = []
    for index in np.ndindex(signal.shape[:2]):
        use = usable[index]
        if use.sum() < FEWEST_SHOTS:
            raise CubeError(
                f"only {use.sum()} open-water shots at {_place(cube, index)} are "
                f"numbers, needed are {FEWEST_SHOTS}; record more"
            )
        own = errors.part(index).part(use)
        shape = None if shapes is None else shapes[index[0]].part(use)
        one = reference.fit(
            signal[index][use],
            own,
            places[use],
            pixels,
            shape=shape,
            surface=None if fit is None else fit.surfaces[len(fits)],
        )
        if shared is not None:
            one = replace(one, common=one.common + shared.part((*index, None)))
        # Shots of unknown directions may be pixels: their order is no time.
        fits.append(one if known else replace(one, drift=NO_DRIFT))
    _refuse_strong_drift(cube, fits, signal.shape[:2])
    if fit is None:
        fit = ShotsFit(
            span=span,
            directions=places,
            model=model,
            surfaces=tuple(one.surface for one in fits),
        )
    return fits, fit


def directions_of(cube: xr.Dataset, shots: xr.Dataset) -> Floats:
    """Return the directions of shots, equal where they were sent to the same.

    Shape (shot, 2), azimuth and elevation [rad], all zero where they are not known. The
    samples of the cube tell how far stages miss.
    """
    if not all(name in shots for name in _AXES):
        return np.zeros((shots.sizes["shot"], 2))
    return np.stack([_alike(cube, shots, name) for name in _AXES], axis=1)


def expected_at_pixels(
    fits: list[reference.Reference], shape: tuple[int, ...]
) -> tuple[Complex, Covariance]:
    """Return the open-water signal of every sample, and the error of its expectation.

    To the end of the column [V], and what the pixels share of its error [V^2].
    """
    signal = np.array([fit.signal for fit in fits]).reshape(shape)
    return signal, stacked([fit.common for fit in fits], shape)


def fluctuation_of(
    fits: list[reference.Reference], water_signal: Complex
) -> Covariance:
    """Return how a water signal fluctuates from sample to sample."""
    levels = water_signal.reshape(-1, *water_signal.shape[2:])
    return stacked(
        [
            fluctuation(fit.relative, level.ravel())
            for fit, level in zip(fits, levels, strict=True)
        ],
        water_signal.shape,
    )


def drift_of(fits: list[reference.Reference], shape: tuple[int, ...]) -> Complex:
    """Return the drift from the first shot to the last, zero where it may be chance.

    Per unit of the water signal, shape (modulation_frequency, polarization, 1, 1) [1].
    """
    changes = [fit.drift.change if _is_real(fit.drift, fits) else 0j for fit in fits]
    return np.array(changes).reshape(*shape[:2], 1, 1)


def _alike(cube: xr.Dataset, shots: xr.Dataset, name: str) -> Floats:
    """Return one angle of the shots, equal where they were sent to the same.

    A scanner comes to stand a little off, another little each time: without this no
    direction would be repeated. The angle is the mean of what was read back.
    """
    stands = shots[name].values
    meant = f"user_commanded_{name}"
    if meant in shots:
        group = _groups(np.round(shots[meant].values, 9))
    else:
        group = _near_each_other(stands, at_least=_MISSES * _jitter(cube, name))
    # Relative to one of them, so that equal angles stay as they are to the last bit.
    first = stands[np.unique(group, return_index=True)[1]]
    off = np.bincount(group, stands - first[group]) / np.bincount(group)
    return np.asarray(first + off)[group]


def _near_each_other(angle: Floats, *, at_least: float) -> NDArray[np.intp]:
    """Return numbers of groups that gaps keep apart; of each angle, if none do so."""
    order = np.argsort(angle, kind="stable")
    gaps = np.diff(angle[order])
    near = max(_NEAR * float(np.ptp(angle)), at_least)
    group = np.empty(angle.size, dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(gaps > near)])
    widths = [np.ptp(angle[group == number]) for number in range(group.max() + 1)]
    return group if max(widths) <= near else _groups(np.round(angle, 9))


def _groups(values: Floats) -> NDArray[np.intp]:
    return np.unique(values, return_inverse=True)[1].ravel()


def _jitter(cube: xr.Dataset, name: str) -> float:
    """Return the standard deviation of read-backs about what was asked for [rad]."""
    meant = f"user_commanded_{name}"
    if meant not in cube:
        return 0.0
    off = (cube[name] - cube[meant]).values
    off = np.abs(off - np.nanmedian(off))
    # What a stage that stuck once is off by does not count.
    return 1.4826 * float(np.nanmedian(off)) if np.isfinite(off).any() else 0.0


def _place(cube: xr.Dataset, index: tuple[int, ...]) -> str:
    frequency = float(cube["modulation_frequency"][index[0]]) / 1e6
    return f"{frequency:g} MHz in channel {cube['polarization'].values[index[1]]}"


def _is_real(drift: Drift, fits: list[reference.Reference]) -> bool:
    return drift.chance * len(fits) < _REAL_DRIFT


def _refuse_strong_drift(
    cube: xr.Dataset, fits: list[reference.Reference], shape: tuple[int, ...]
) -> None:
    sure = [
        abs(fit.drift.change) - _SURE * abs(fit.drift.uncertainty)
        if _is_real(fit.drift, fits)
        else 0.0
        for fit in fits
    ]
    worst = int(np.argmax(sure))
    if sure[worst] > LARGEST_DRIFT:
        drift = fits[worst].drift
        place = _place(cube, tuple(map(int, np.unravel_index(worst, shape))))
        raise CubeError(
            f"the open-water signal at {place} changed by "
            f"{abs(drift.change):.0%} (+- {abs(drift.uncertainty):.0%}) from the first "
            f"shot to the last, at most {LARGEST_DRIFT:.0%} can be bridged; record the "
            "reference again closer to the scan, or split scan and reference into "
            "shorter parts"
        )


def _refuse_a_scan_beyond_the_shots(
    cube: xr.Dataset, shots: NDArray[np.float64], span: Span
) -> None:
    """Raise if the water signal would have to be extrapolated over the directions."""
    text = cube.attrs.get("survey")
    if text and Survey.from_text(text).scan.moves == "both":
        return  # The receiver turns with the beam: the water is the same everywhere.
    low, high = shots.min(axis=0), shots.max(axis=0)
    room = np.maximum(_BEYOND * (high - low), BEYOND_AT_LEAST)
    first, last = np.array([span.azimuth, span.elevation]).T
    outside = np.maximum(low - first, last - high) - room
    if np.any(outside > 0):
        axis = int(np.argmax(outside))
        raise CubeError(
            f"the scan goes {np.degrees(outside[axis] + room[axis]):.2f} degrees "
            f"beyond the open-water shots in {('azimuth', 'elevation')[axis]}, where "
            "the water signal is not known; record shots at the edges of the scan"
        )
