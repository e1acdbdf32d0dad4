"""What all pixels of a scan share, from a sample of them; then any of its rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import pixels as joint_pixels
from amulor.rejection.joint import shared as joint_shared
from amulor.rejection.joint._kernels.threads import each
from amulor.rejection.joint.cube import (
    Scan,
    cube_of,
    refuses_its_echo,
    typical_of,
)
from amulor.rejection.joint.drift import Clock, clock_of, trends_of
from amulor.rejection.joint.instrument import Instrument
from amulor.rejection.joint.overlap.frame import Frame, frame_of
from amulor.rejection.joint.pixels import Pixels
from amulor.rejection.joint.priors import DECISIVE, Shared
from amulor.rejection.joint.samples import (
    FEWEST_FREQUENCIES,
    SHARING,
    count,
    flat,
    refuse_errors_of_zero,
    refuse_other_windows,
    shot_directions,
    shot_pixels,
)
from amulor.rejection.joint.solve import solve

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels worked on at once: this bounds the memory beyond the cube itself.
_AT_ONCE = 4096
#: Share of the work before them, about [1].
_SHARED_TAKES = 0.3


@dataclass(frozen=True, kw_only=True)
class Common:
    """All that a pixel needs to know of the others."""

    scan: Scan
    """How the receiver looks at the scan, and what its pixels share."""
    transfer: Complex
    """What the echo has beyond its delay, as known [1]."""
    interval: tuple[float, float] | None
    """Nearest and farthest slant range [m]."""
    clock: Clock
    """When the scan was measured."""


@dataclass(frozen=True, kw_only=True)
class _Extent:
    """What a first look at all samples tells."""

    azimuth: Floats
    """Lowest, highest and mean [rad]."""
    elevation: Floats
    """Likewise [rad]."""
    enough: NDArray[np.bool_]
    """Pixels with usable samples at two frequencies, (row, column)."""


def common_of(
    source: tiles.Source,
    *,
    interval: tuple[float, float] | None,
    transfer: Complex,
    instrument: Instrument,
) -> Common:
    """Return what all pixels share, estimated from a sample of them.

    Parameters
    ----------
    source : Source
        Samples.
    interval : tuple of float, optional
        Nearest and farthest slant range [m].
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    instrument : Instrument
        How well it is known.

    Returns
    -------
    Common
        The same for whatever tiles the samples come in.

    Raises
    ------
    CubeError
        If errors are zero, the scan moves towards its window, or no pixel has usable
        samples at two frequencies.
    """
    head = source.head
    frequency = head["modulation_frequency"].values
    extent = _extent_of(source)
    shots = head.amulor.open_water
    places = shot_directions((extent.azimuth[2], extent.elevation[2]), shots)
    frame = frame_of(
        head,
        np.concatenate([extent.azimuth[:2], places[0]]),
        np.concatenate([extent.elevation[:2], places[1]]),
    )
    for begin, end in tiles.bands(source):
        if "origin_z" in head.coords or "origin_z" in source.tile(begin, end).coords:
            refuse_other_windows(source.tile(begin, end), frame)
        else:
            break
    chosen = np.flatnonzero(extent.enough)
    if not len(chosen):
        raise CubeError(
            "no pixel has usable samples at two frequencies or more; look at the "
            "flags of the samples (missing, saturated) and measure again"
        )
    chosen = chosen[
        np.linspace(0, len(chosen) - 1, min(SHARING, len(chosen))).astype(int)
    ]
    clock = clock_of(source)
    some = _joined(
        [
            _pixels(
                frame, source.tile(begin, end), begin, clock, interval=interval,
                which=which - begin * source.columns,
            )
            for begin, end in tiles.bands(source)
            if len(which := _within(chosen, begin, end, source.columns))
        ]
    )  # fmt: skip
    tell("water that all pixels share", 0.0)

    def fitted(shots: Pixels | None) -> Shared:
        return joint_shared.fit(
            frame,
            some,
            shots,
            transfer=transfer,
            deepest=float(some.depths.max()),
            turn_width=instrument.direction,
        )

    of_water = shot_pixels(frame, shots, places, frequency)
    shared = fitted(of_water)
    found = solve(frame, some, shared, transfer)
    beam = frame.beam(*_directions_at(source, chosen))
    late_spread, known = typical_of(frame, beam, found, shared, instrument)
    doubted = False
    if of_water is not None and shared.evidence > DECISIVE and shared.water_departs:
        # Shots of other water hide what is wrong with the echo: ask without them.
        alone = fitted(None)
        by_itself = solve(frame, some, alone, transfer)
        doubted = refuses_its_echo(frame, beam, by_itself, alone, instrument)
    return Common(
        scan=Scan(
            frame=frame,
            shared=shared,
            instrument=instrument,
            span=float((some.longest - some.shortest).max()),
            late_spread=late_spread,
            instrument_uncertainty=known,
            echo_is_doubted=doubted,
        ),
        transfer=transfer,
        interval=interval,
        clock=clock,
    )


def of_rows(tile: xr.Dataset, common: Common, first: int = 0) -> xr.Dataset:
    """Return the target signal of some rows of a scan.

    Parameters
    ----------
    tile : xarray.Dataset
        Level `samples`, whole rows.
    common : Common
        What all pixels share.
    first : int, optional
        Which row of the scan the first one is.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`; the same for whatever rows come together.
    """
    rows, columns = tile["azimuth"].shape
    wide = min(columns, _AT_ONCE)
    high = max(1, _AT_ONCE // wide)
    bare = cubes.without_groups(tile, "truth")
    whole = tiles.Whole(rows, columns)
    places = [
        (row, column)
        for row in range(0, rows, high)
        for column in range(0, columns, wide)
    ]

    def estimated(place: tuple[int, int]) -> xr.Dataset:
        row, column = place
        block = bare.isel(
            row=slice(row, row + high), column=slice(column, column + wide)
        )
        pixels = _pixels(
            common.scan.frame, block, first + row, common.clock,
            interval=common.interval, column=column,
        )  # fmt: skip
        result = solve(common.scan.frame, pixels, common.scan.shared, common.transfer)
        return cube_of(block, common.scan, result)

    for (row, column), part in zip(places, each(estimated, places), strict=True):
        tell(f"ranges of row {first + row:,}", _share(common.clock, first + row))
        whole.put(part, row, column)
    target = whole.made()
    truth = tile.amulor.truth
    return target if truth is None else cubes.attach(target, truth, "truth")


def _share(clock: Clock, row: int) -> float:
    return _SHARED_TAKES + (1 - _SHARED_TAKES) * row / max(clock.rows, 1)


def _pixels(
    frame: Frame,
    cube: xr.Dataset,
    first: int,
    clock: Clock,
    *,
    interval: tuple[float, float] | None,
    column: int = 0,
    which: NDArray[np.intp] | None = None,
) -> Pixels:
    """Return samples of a block that begins at a row and a column of the scan."""
    signal, errors, usable = flat(cube)
    azimuth = cube["azimuth"].values.ravel().astype(float)
    elevation = cube["elevation"].values.ravel().astype(float)
    trends = trends_of(cube, clock, row=first, column=column)
    if which is not None:
        signal, usable, trends = signal[which], usable[which], trends[which]
        azimuth, elevation = azimuth[which], elevation[which]
        errors = Covariance(*(each[which] for each in vars(errors).values()))
    return joint_pixels.pixels_of(
        frame,
        signal,
        errors,
        usable,
        azimuth,
        elevation,
        interval=interval,
        modulation_frequency=cube["modulation_frequency"].values,
        trends=trends,
    )


def _extent_of(source: tiles.Source) -> _Extent:
    """Return what a look at all samples tells; refuse errors of zero."""
    enough, lowest, highest, means = [], [], [], []
    for begin, end in tiles.bands(source):
        tile = source.tile(begin, end)
        usable, errors = count(tile)
        refuse_errors_of_zero(errors, usable)
        enough.append(usable.any(axis=1).sum(axis=0) >= FEWEST_FREQUENCIES)
        angles = np.stack(
            [tile[name].values.astype(float) for name in ("azimuth", "elevation")]
        )
        lowest.append(angles.min(axis=(1, 2)))
        highest.append(angles.max(axis=(1, 2)))
        means += [row.mean(axis=-1) for row in np.moveaxis(angles, 1, 0)]
    parts = np.min(lowest, axis=0), np.max(highest, axis=0), np.mean(means, axis=0)
    both = np.stack(parts, axis=1)
    return _Extent(
        azimuth=both[0], elevation=both[1], enough=np.concatenate(enough, axis=0)
    )


def _within(
    chosen: NDArray[np.intp], begin: int, end: int, columns: int
) -> NDArray[np.intp]:
    """Return the chosen pixels of a band of rows."""
    some = chosen[(chosen >= begin * columns) & (chosen < end * columns)]
    return np.asarray(some)


def _joined(parts: list[Pixels]) -> Pixels:
    """Return the pixels of several tiles as one."""
    if len(parts) == 1:
        return parts[0]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(parts[0])
        if name != "covariance"
    }
    errors = [
        np.concatenate([getattr(part.covariance, name) for part in parts])
        for name in ("in_phase", "quadrature", "cross")
    ]
    return Pixels(covariance=Covariance(*errors), **joined)


def _directions_at(
    source: tiles.Source, chosen: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Return where chosen pixels look [rad]."""
    found: list[tuple[Floats, Floats]] = []
    for begin, end in tiles.bands(source):
        which = _within(chosen, begin, end, source.columns) - begin * source.columns
        if len(which):
            tile = source.tile(begin, end)
            found.append(
                (
                    tile["azimuth"].values.ravel().astype(float)[which],
                    tile["elevation"].values.ravel().astype(float)[which],
                )
            )
    azimuth, elevation = (np.concatenate(each) for each in zip(*found, strict=True))
    return azimuth, elevation
