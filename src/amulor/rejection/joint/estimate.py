"""Joint estimation: shared parameters from sampled pixels, then all pixels by rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.optics._geometry import Geometry
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import shared as joint_shared
from amulor.rejection.joint._kernels.compiled import each
from amulor.rejection.joint.cube import (
    Scan,
    cube_of,
    echo_departs,
    typical_of,
)
from amulor.rejection.joint.overlap import Frame, frame_of
from amulor.rejection.joint.priors import (
    DECISIVE,
    DIRECTION,
    LATE_ECHO,
    Clock,
    Instrument,
    Shared,
    clock_of,
    trends_of,
)
from amulor.rejection.joint.samples import (
    FEWEST_FREQUENCIES,
    SHARING,
    Pixels,
    pixels_of,
    refuse_errors_of_zero,
    refuse_other_windows,
    refuse_single_frequency,
    shot_directions,
    shot_pixels,
)
from amulor.rejection.joint.solve import solve
from amulor.rejection.methods import method
from amulor.rejection.observation import Observation, ScanObservation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels of a block: this bounds the memory beyond the cube itself.
_AT_ONCE = 4096
#: Share of the fit in the run time, about [1].
_SHARED_TAKES = 0.3


@dataclass(frozen=True, kw_only=True)
class Common:
    """Shared parameters, transfer function, range interval and duration of the scan."""

    scan: Scan
    """View of the receiver and shared parameters."""
    transfer: Complex
    """User's transfer function of the echo beyond its delay [1]."""
    interval: tuple[float, float] | None
    """Nearest and farthest slant range [m]."""
    clock: Clock
    """Time span of the scan."""


@dataclass(frozen=True, kw_only=True)
class _Extent:
    """Directions and usable pixels of a scan."""

    azimuth: Floats
    """Lowest, highest and mean azimuth [rad]."""
    elevation: Floats
    """Lowest, highest and mean elevation [rad]."""
    enough: NDArray[np.bool_]
    """Pixels with usable samples at two or more frequencies, (row, column)."""


def common_of(
    scan: ScanObservation,
    *,
    interval: tuple[float, float] | None,
    transfer: Complex,
    instrument: Instrument,
) -> Common:
    """Estimate the parameters that all pixels share, from a sample of the pixels."""
    extent = _extent_of(scan)
    shots = scan.head.shots
    places = shot_directions((extent.azimuth[2], extent.elevation[2]), shots)
    frame = frame_of(
        scan.head,
        np.concatenate([extent.azimuth[:2], places[0]]),
        np.concatenate([extent.elevation[:2], places[1]]),
    )
    for begin, end in scan.bands:
        origin_z = scan.tile(begin, end).origin_z
        if origin_z is None:
            break
        refuse_other_windows(origin_z, frame)
    sample = np.flatnonzero(extent.enough)
    if not len(sample):
        raise CubeError(
            "no pixel has usable samples at two frequencies or more; look at the "
            "flags of the samples (missing, saturated) and measure again"
        )
    sample = sample[
        np.linspace(0, len(sample) - 1, min(SHARING, len(sample))).astype(int)
    ]
    clock = clock_of(scan)
    pixels, geometry = _sampled(scan, sample, frame, clock, interval)
    tell("water that all pixels share", 0.0)

    def fitted(shots: Pixels | None) -> Shared:
        return joint_shared.fit(
            frame,
            pixels,
            shots,
            transfer=transfer,
            deepest=float(pixels.depths.max()),
            turn_width=instrument.direction,
        )

    of_water = shot_pixels(frame, shots, places)
    shared = fitted(of_water)
    result = solve(frame, pixels, shared, transfer)
    late_spread, uncertainty = typical_of(frame, geometry, result, shared, instrument)
    doubted = False
    if of_water is not None and shared.evidence > DECISIVE and shared.water_departs:
        # Shots of other water hide an echo that departs: fit without them.
        without_shots = fitted(None)
        result_without_shots = solve(frame, pixels, without_shots, transfer)
        doubted = echo_departs(
            geometry, result_without_shots, without_shots, instrument
        )
    return Common(
        scan=Scan(
            frame=frame,
            shared=shared,
            instrument=instrument,
            span=float((pixels.longest - pixels.shortest).max()),
            late_spread=late_spread,
            instrument_uncertainty=uncertainty,
            echo_is_doubted=doubted,
        ),
        transfer=transfer,
        interval=interval,
        clock=clock,
    )


def of_rows(tile: xr.Dataset, common: Common, first: int = 0) -> xr.Dataset:
    """Return the target signal of some rows of a scan."""
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
    frame, clock = common.scan.frame, common.clock

    def estimated(place: tuple[int, int]) -> xr.Dataset:
        row, column = place
        block = Observation(
            cube=bare.isel(
                row=slice(row, row + high), column=slice(column, column + wide)
            )
        )
        pixels = pixels_of(
            frame,
            block.flat(),
            block.azimuth.ravel(),
            block.elevation.ravel(),
            interval=common.interval,
            trends=trends_of(block, clock, row=first + row, column=column),
        )
        result = solve(frame, pixels, common.scan.shared, common.transfer)
        return cube_of(block, common.scan, result)

    for (row, column), part in zip(places, each(estimated, places), strict=True):
        tell(f"ranges of row {first + row:,}", _share(clock, first + row))
        whole.put(part, row, column)
    target = whole.made()
    truth = tile.amulor.truth
    return target if truth is None else cubes.attach(target, truth, "truth")


def _share(clock: Clock, row: int) -> float:
    return _SHARED_TAKES + (1 - _SHARED_TAKES) * row / max(clock.rows, 1)


def _sampled(
    scan: ScanObservation,
    sample: NDArray[np.intp],
    frame: Frame,
    clock: Clock,
    interval: tuple[float, float] | None,
) -> tuple[Pixels, Geometry]:
    """Return pixels sampled over the scan, and their geometry."""
    parts, directions = [], []
    for begin, end in scan.bands:
        index = sample - begin * scan.columns
        index = index[(index >= 0) & (index < (end - begin) * scan.columns)]
        if not len(index):
            continue
        rows = scan.tile(begin, end)
        azimuth = rows.azimuth.ravel()[index]
        elevation = rows.elevation.ravel()[index]
        parts.append(
            pixels_of(
                frame,
                rows.flat().part(index),
                azimuth,
                elevation,
                interval=interval,
                trends=trends_of(rows, clock, row=begin)[index],
            )
        )
        directions.append((azimuth, elevation))
    azimuth, elevation = map(np.concatenate, zip(*directions, strict=True))
    return _joined(parts), frame.geometry(azimuth, elevation)


def _extent_of(scan: ScanObservation) -> _Extent:
    """Return directions and usable pixels of a scan; CubeError if an error is 0."""
    enough, lowest, highest, means = [], [], [], []
    for begin, end in scan.bands:
        rows = scan.tile(begin, end)
        refuse_errors_of_zero(rows.covariance, rows.usable)
        enough.append(rows.usable.any(axis=1).sum(axis=0) >= FEWEST_FREQUENCIES)
        angles = np.stack([rows.azimuth, rows.elevation])
        lowest.append(angles.min(axis=(1, 2)))
        highest.append(angles.max(axis=(1, 2)))
        means += [row.mean(axis=-1) for row in np.moveaxis(angles, 1, 0)]
    extremes = np.min(lowest, axis=0), np.max(highest, axis=0), np.mean(means, axis=0)
    azimuth, elevation = np.stack(extremes, axis=1)
    return _Extent(
        azimuth=azimuth, elevation=elevation, enough=np.concatenate(enough, axis=0)
    )


def _joined(parts: list[Pixels]) -> Pixels:
    """Concatenate the pixels of several tiles."""
    if len(parts) == 1:
        return parts[0]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, values in vars(parts[0]).items()
        if name != "covariance" and values is not None
    }
    errors = [
        np.concatenate([getattr(part.covariance, name) for part in parts])
        for name in ("in_phase", "quadrature", "cross")
    ]
    return Pixels(covariance=Covariance(*errors), **joined)


def _fit(source: tiles.Source, **options: Any) -> tiles.OfRows:
    """Fit the shared parameters; return a function that estimates rows of the scan."""
    common = prepared(source, **options)
    return lambda rows, first: of_rows(rows, common, first)


@method("joint", simplicity=5, distrusts_open_water=True, fitter=_fit)
def joint(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    echo_transfer: NDArray[np.complex128] | None = None,
    delay_uncertainty: float = 0.0,
    group_index_uncertainty: float = 0.0,
    receiver_position_uncertainty: float = 0.0,
    receiver_direction_uncertainty: float = DIRECTION,
    late_echo_uncertainty: float | None = None,
) -> xr.Dataset:
    r"""Estimate target and water signal together, by maximum likelihood.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` with at least two modulation frequencies and the attribute
        `survey`. From the survey the method takes the instrument, the scan and the
        shape of the water's phase function, but not absorption, scattering and
        distances. Open-water shots are used if there are any.
    interval : tuple of float, optional
        Nearest and farthest possible slant range [m]. From 0 to the unambiguous range
        of the frequencies by default.
    echo_transfer : ndarray of complex, optional
        Known factor of the echo at each frequency besides its delay, such as the spread
        of its arrival times [1]; 1 by default.
    delay_uncertainty : float, optional
        Standard uncertainty of the instrument's delay, which all channels share [s].
        By default this and the next two are not included here: a range image takes
        them from the survey's `[calibration]`, and lists those that are not stated.
    group_index_uncertainty : float, optional
        Standard uncertainty of the group index of the water [1].
    receiver_position_uncertainty : float, optional
        Standard uncertainty of the receiver's position to the right and down [m]. Its
        distance forward of the emitter is part of the delay.
    receiver_direction_uncertainty : float, optional
        Standard uncertainty of the axis of the receiver in azimuth and elevation
        [rad]; 1 degree by default.
    late_echo_uncertainty : float, optional
        Standard uncertainty of the delay of the echo by scattering, divided by twice
        the delay of `optics.late_echo` for the estimated spread of the light [1]. By
        default 0.5, and 0 for a simulation without late light. State 0 if
        `echo_transfer` contains this delay, or for the range of the echo itself.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`: the samples less the water signal that ends at the
        target. Parameters that pixels share are attributes that begin with `joint_`.
        These variables over (row, column) begin with `joint_`, too:

        - `slant_range`, `slant_range_uncertainty` [m].
        - `slant_range_common_uncertainty`: the part that all pixels share [m].
        - `slant_range_bound`: Cramer-Rao bound [m].
        - `slant_range_lower`, `slant_range_upper`: ends of the 68 % interval from the
          profile of the likelihood [m].
        - `wrong_interval_probability`: probability of another ambiguity interval [1].
        - `misfit`: chi-square over its degrees of freedom [1].
        - `nearer_surface`, `farther_surface`: slant ranges of two surfaces in one
          beam [m].

    Raises
    ------
    CubeError
        If the cube has a single frequency, no survey, errors that are zero, a
        receiver that does not see the beam, or a scan that moves towards a window.
    ValueError
        If the interval is empty or contains far too many ambiguity intervals, or the
        transfer is not one number above zero for each frequency.

    Notes
    -----
    The signal of a pixel in channel c at frequency f is
    :math:`A_c H(f) e^{2 \pi i f p / c_0} + s_c W(f; k', b_f \langle\theta^2\rangle,
    z)`, with the optical path p and the depth z of the target. W is the water signal in
    front of this depth, eq. (29) of [1]_, for the phase function of the survey's water
    with a scaled angle. For water without a phase function it is eq. (46). Strengths
    and shape of W belong to the whole scan. Three terms describe effects that the model
    lacks: a smooth factor on the overlap, light from in front of all targets, and
    departures of the echo at each frequency. The data determine the widths of their
    priors, and their uncertainty is part of the result's. A random change of the water
    signal from sample to sample is estimated from the scatter. Light that is scattered
    between instrument and target arrives late. The part of this delay that
    `echo_transfer` omits remains in the slant range, and its uncertainty covers it.

    The water of the open-water shots may differ from that of the scan. Their strength,
    and a departure at each frequency, have priors whose widths the data determine.
    Errors that the samples cannot show widen the intervals. Delay, group index,
    receiver position and late echoes shift all ranges together
    (`slant_range_common_uncertainty`). The receiver direction is estimated with its
    prior. The scale of the stated noise is estimated from differences between
    neighboring pixels; see decision 11. The strength of the water may change smoothly
    over the time of the scan.

    Samples that disagree with the others of their pixel are omitted, at most a third of
    them, and flagged `OUTLIER`. If it is unclear which samples are wrong, the whole
    pixel is flagged. With three or more frequencies, `MIXED` marks pixels that two
    surfaces explain and one does not; see decision 14.

    For a vehicle that takes readings in turn, the change of the range between them is
    a parameter of each pixel, with a prior of the planned motion. Its changes, and
    those of the amplitude, are errors of the readings. Ranges belong to the mean time
    of the readings with weights proportional to the squares of the frequencies. Pixels
    that disagree beyond that are `MOVED`.

    Other flags: `NO_TARGET` if open water explains the samples about as well;
    `AMBIGUOUS` if another interval has a probability above 3e-4; `WATER_RESIDUAL` if
    the samples contradict the model, with a p-value of chi-square below 1e-4.
    `WATER_RESIDUAL` is also set if departures seen in the scan shift the path by ten
    times its other uncertainty. If only the echo departs, 0.3 times is enough. The
    shift is part of the uncertainty.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cube = cubes.checked(cube, "samples")
    common = prepared(
        tiles.InMemory(cube),
        interval=interval,
        echo_transfer=echo_transfer,
        delay_uncertainty=delay_uncertainty,
        group_index_uncertainty=group_index_uncertainty,
        receiver_position_uncertainty=receiver_position_uncertainty,
        receiver_direction_uncertainty=receiver_direction_uncertainty,
        late_echo_uncertainty=late_echo_uncertainty,
    )
    return of_rows(cube, common)


def prepared(
    source: tiles.Source,
    *,
    interval: tuple[float, float] | None = None,
    echo_transfer: NDArray[np.complex128] | None = None,
    delay_uncertainty: float = 0.0,
    group_index_uncertainty: float = 0.0,
    receiver_position_uncertainty: float = 0.0,
    receiver_direction_uncertainty: float = DIRECTION,
    late_echo_uncertainty: float | None = None,
) -> Common:
    """Fit the shared parameters of a scan, for the estimates of its rows."""
    scan = ScanObservation(source=source)
    frequency = scan.head.frequency
    refuse_single_frequency(frequency)
    instrument = Instrument.checked(
        delay=delay_uncertainty,
        group_index=group_index_uncertainty,
        position=receiver_position_uncertainty,
        direction=receiver_direction_uncertainty,
        late_echo=(LATE_ECHO if scan.head.has_late_light else 0.0)
        if late_echo_uncertainty is None
        else late_echo_uncertainty,
    )
    # Hundreds of small matrices: threads of BLAS wait for each other longer than they
    # work, ten times longer where other programs have the processors.
    with threadpool_limits(limits=1, user_api="blas"):
        return common_of(
            scan,
            interval=interval,
            transfer=_checked_transfer(echo_transfer, frequency),
            instrument=instrument,
        )


def _checked_transfer(
    transfer: NDArray[np.complex128] | None, frequency: Floats
) -> Complex:
    if transfer is None:
        return np.ones(frequency.size, dtype=complex)
    values = np.asarray(transfer, dtype=complex)
    if values.shape != frequency.shape or not np.all(
        np.isfinite(values) & (np.abs(values) > 0)
    ):
        raise ValueError(
            f"echo_transfer must be one finite number other than 0 for each of the "
            f"{frequency.size} modulation frequencies, got shape {values.shape}"
        )
    return values
