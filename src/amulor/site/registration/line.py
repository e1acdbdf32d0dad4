"""Lines: scans from a moving vehicle, in one frame, with the errors of their poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.spatial.transform import Rotation

from amulor.cube import QualityFlag
from amulor.cube.schema import LEVELS, WINDOW_ATTRIBUTES
from amulor.errors import AmulorError, CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.moving import MovingFrame, moving_frame
from amulor.imaging.observation import geometry_of
from amulor.io.trajectories import read_trajectory
from amulor.platform import InstrumentPoses, Trajectory, read_mounting
from amulor.platform.attitude import cross_matrix
from amulor.platform.mounting import changed, error_factors, with_covariance
from amulor.site.registration.pose import ScanPose
from amulor.survey.platform import Mounting

if TYPE_CHECKING:
    from amulor.site.description import Site, SiteScan, SiteTrajectory

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]

#: Least and largest number of forms of a drift along the line [1].
_FEWEST, _MOST = 6, 32
#: Last form of a drift that counts; the rest beyond the unknowns is noise [1].
_LAST = 64
#: Largest rest of a random walk beyond its forms, in standard uncertainties of a range.
_REST = 1 / 3
#: Interval of the velocities that are filtered [s], and their largest number [1].
_INTERVAL, _MOST_INSTANTS = 0.01, 100_000
#: Least component of a velocity, in standard deviations of the drift's velocity [1].
_CLEAR = 3.5
#: Empty rows between rows of both directions; more than pixels of a block.
_BETWEEN = 8
#: Attribute: number of each row in the scan, for rows sorted by direction [1].
ROWS = "rows_of_scan"
_AXES = ("east", "north", "up")
_MOUNTING = (
    "lever arm right", "lever arm down", "lever arm forward", "boresight right",
    "boresight down", "boresight forward", "clock offset", "clock drift",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Motion:
    r"""Motion of the instrument during a line, and the errors of its poses.

    The pose in the middle of the line carries the constant errors of the trajectory.
    Errors that change along the line are forms times random factors, as those of the
    ranges. A random walk has the forms :math:`\sqrt 2 \cos(k \pi s) / k \pi` over the
    share s of the line (Karhunen-Loeve).
    """

    start: ScanPose
    """Pose in the middle of the line, by trajectory and mounting."""
    covariance: Floats
    """Covariance of this pose: translation and rotation about site axes, (6, 6)."""
    keys: tuple[str, ...]
    """Name of the factor of each error; lines with an equal key share the factor."""
    poses: InstrumentPoses
    """Poses of the instrument by the trajectory, row by row."""
    course: Floats
    """Share of the line at each pixel, from 0 to 1, shape (row, column) [1]."""
    mounting: Floats
    """Mounting change by one sigma of each of its errors, shape (error, 8)."""
    drift: tuple[float, float]
    """Random walk along the line: of position [m] and attitude [rad]."""
    forms: tuple[int, int]
    """Number of forms of the random walk of position and attitude."""
    bend: float
    """Shift of the ends of the line by a constant error of the attitude [m]."""
    own: Floats
    """Standard uncertainty of the range by the change during a reading, shape (row,
    column) [m]."""

    def rests(self, pixel: Numbers) -> tuple[Floats, Floats]:
        """Return the forms of both random walks that are no unknowns, each (form, n).

        They are in the units of position [m] and attitude [rad].
        """
        share = np.nan_to_num(self.course.ravel()[pixel])
        position, attitude = (
            _walk(share, size, range(count + 1, _LAST + 1))
            for size, count in zip(self.drift, self.forms, strict=True)
        )
        return position, attitude

    def shifts(self, pixel: Numbers, points: Floats) -> Floats:
        """Return shifts of points by one sigma of each error, shape (k, n, 3) [m].

        Points and shifts are in the axes of the pose in the middle of the line.
        """
        poses = self.poses.part(pixel)
        place = self.start.place(points)
        share = self.course.ravel()[pixel]
        rotation = self.start.rotation
        result = np.empty((len(self.keys), len(pixel), 3))
        fixed = len(self.mounting)
        if fixed:
            derivatives = poses.derivatives(place)
            result[:fixed] = np.tensordot(self.mounting, derivatives, axes=1) @ rotation
        axes = rotation[:, None, :]
        turns = -cross_matrix(place - poses.vehicle.position)
        for first, forms, by_axis in zip(
            self._firsts,
            self._along(share),
            (axes, axes, np.moveaxis(turns, -1, 0) @ rotation),
            strict=True,
        ):
            for k, form in enumerate(forms):
                at = first + 3 * k
                np.multiply(form[None, :, None], by_axis, out=result[at : at + 3])
        return result

    def shift(self, pixel: Numbers, points: Floats, factors: Floats) -> Floats:
        """Return the sum of `shifts` times the factors of the errors, (n, 3) [m]."""
        poses = self.poses.part(pixel)
        place = self.start.place(points)
        fixed = len(self.mounting)
        total = np.zeros((len(pixel), 3))
        if fixed:
            change = factors[:fixed] @ self.mounting
            total += np.tensordot(change, poses.derivatives(place), axes=1)
        vectors = []
        forms = self._along(self.course.ravel()[pixel])
        for first, values in zip(self._firsts, forms, strict=True):
            mine = factors[first : first + 3 * len(values)]
            vectors.append(values.T @ mine.reshape(-1, 3))
        total += vectors[0] + vectors[1]
        total += np.cross(vectors[2], place - poses.vehicle.position)
        return np.asarray(total @ self.start.rotation)

    @property
    def _firsts(self) -> tuple[int, int, int]:
        """Numbers of the first errors: turn of the track, both random walks."""
        turn = len(self.mounting)
        position = turn + 3 * (self.bend > 0)
        return turn, position, position + 3 * self.forms[0]

    def _along(self, share: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the forms of the errors along the line, in the order of `_firsts`."""
        turn = self.bend * (2 * share - 1)
        walks = [
            _walk(share, size, range(1, count + 1))
            for size, count in zip(self.drift, self.forms, strict=True)
        ]
        return turn[None] if self.bend > 0 else turn[None][:0], walks[0], walks[1]


def _walk(share: Floats, size: float, numbers: range) -> Floats:
    """Return forms of a random walk at shares of the line, shape (form, n)."""
    k = np.pi * np.array(numbers)[:, None]
    return np.asarray(size * np.sqrt(2) / k * np.cos(k * share))


def motion_of(site: Site, scan: SiteScan, image: xr.Dataset) -> Motion | None:
    """Return the motion of the instrument during a scan; None on a fixed instrument."""
    line = scan.trajectory
    if line is None:
        return None
    try:
        mounting = None if line.mounting is None else read_mounting(line.mounting)
        track = track_in_frame(read_trajectory(line.file), site)
        frame = moving_frame(image, trajectory=track, mounting=mounting)
    except AmulorError as error:
        raise CubeError(f"scan {scan.name!r}: {error}") from None
    if frame.unknown:
        raise CubeError(
            f"scan {scan.name!r}: nobody states the uncertainty of the "
            f"{', '.join(frame.unknown)}; state it in the columns of amulor import "
            "trajectory, or in the mounting"
        )
    return _motion(scan, line, frame, image)


def track_in_frame(track: Trajectory, site: Site) -> Trajectory:
    """Return a trajectory in the frame of a site."""
    frame = site.frame
    if frame.crs and track.crs and frame.crs != track.crs:
        raise CubeError(
            f"the trajectory has the reference system {track.crs}, the site "
            f"{frame.crs}; import the trajectory with --crs {frame.crs}"
        )
    if not (frame.crs and track.crs):
        return track
    away = np.subtract(track.crs_offset, frame.crs_offset)
    return replace(track, position=track.position + away)


def _motion(
    scan: SiteScan, line: SiteTrajectory, frame: MovingFrame, image: xr.Dataset
) -> Motion:
    """Return the motion of a line, with the errors of trajectory and mounting."""
    poses, known = frame.poses, frame.poses.known
    time = poses.vehicle.time
    first, last = np.nanmin(time[known]), np.nanmax(time[known])
    share = (time - first) / max(last - first, 1e-9)
    order = np.flatnonzero(known)[np.argsort(time[known])]
    middle = order[len(order) // 2]
    start = ScanPose(poses.rotation[middle], poses.position[middle])
    arm = start.position - poses.vehicle.position[middle]
    carried = np.eye(6)
    carried[:3, 3:] = -cross_matrix(arm)
    covariance = carried @ poses.vehicle.covariance[middle] @ carried.T
    variance = np.einsum("nii->ni", poses.vehicle.covariance[order])
    drift = []
    for part, stated in (
        (slice(0, 3), line.position_drift),
        (slice(3, 6), line.attitude_drift),
    ):
        mean = variance[:, part].mean(axis=1)
        # Uncertainties that are equal everywhere do not state how errors change.
        grown = mean.max() - mean.min()
        grown = grown if grown > 1e-6 * mean.max() else mean.max()
        drift.append(float(np.sqrt(grown)) if stated is None else 2 * stated)
    poses = _without_walk(poses, order, drift)
    turn = np.sqrt(np.trace(covariance[3:, 3:]) / 3)
    length = np.linalg.norm(poses.position[order[-1]] - poses.position[order[0]])
    reach = float(np.nanmedian(image["slant_range"].values))
    noise = float(np.nanmedian(np.sqrt(own_variance(image))))
    forms = (_forms(drift[0], noise), _forms(drift[1] * reach, noise))
    factors = error_factors(poses.mounting)
    factors = factors[np.abs(factors).max(axis=1) > 0]
    return Motion(
        start=start,
        # No direction counts as exact.
        covariance=covariance + 1e-18 * np.eye(6),
        keys=_keys(scan, poses.mounting, len(factors), forms, turn * length > 0),
        poses=poses,
        course=share.reshape(frame.shape),
        mounting=factors,
        drift=(drift[0], drift[1]),
        forms=forms,
        bend=float(turn * length / 2),
        own=_smear(frame, image),
    )


def _without_walk(
    poses: InstrumentPoses, order: Numbers, drift: Sequence[float]
) -> InstrumentPoses:
    """Return poses whose velocities lack the velocity of the drifts.

    The drift is a random walk, and its velocity is white noise. With it, the derivative
    by the clock offset would correlate with the drift in the distances. Cosine
    components that are not significant against this noise are set to 0.
    """
    time = poses.vehicle.time[order]
    lasting = max(float(time[-1] - time[0]), 1e-9)
    count = int(np.clip(np.ceil(lasting / _INTERVAL), 256, _MOST_INSTANTS))
    instants = np.linspace(time[0], time[-1], count)
    values = {}
    for name, size in zip(("velocity", "turn_rate"), drift, strict=True):
        given = getattr(poses.vehicle, name)
        even = np.array([np.interp(instants, time, part) for part in given[order].T])
        parts = dct(even, norm="ortho", axis=1)
        noise = size * np.sqrt(count) / lasting
        parts[np.abs(parts) < _CLEAR * noise] = 0.0
        smooth = idct(parts, norm="ortho", axis=1)
        filtered = [np.interp(poses.vehicle.time, instants, part) for part in smooth]
        values[name] = np.where(np.isnan(given), np.nan, np.transpose(filtered))
    return replace(poses, vehicle=replace(poses.vehicle, **values))


def _forms(drift: float, noise: float) -> int:
    """Return the number of forms whose rest is small beside the noise of a range [1].

    Beyond K forms, the rest of a random walk is its size divided by pi sqrt(K).
    """
    if not drift > 0:
        return 0
    needed = (drift / (np.pi * _REST * max(noise, 1e-9))) ** 2
    return int(np.clip(np.ceil(needed), _FEWEST, _MOST))


def _keys(
    scan: SiteScan,
    mounting: Mounting,
    count: int,
    forms: tuple[int, int],
    bent: bool,
) -> tuple[str, ...]:
    """Return the names of the errors of a line, in the order of `Motion.shifts`."""
    group = f"{scan.instrument}, {scan.epoch}"
    if mounting.correlation is None:
        sigma = np.abs(error_factors(mounting)).max(axis=1)
        names = [name for name, size in zip(_MOUNTING, sigma, strict=True) if size > 0]
    else:
        names = [f"mounting {number + 1}" for number in range(count)]
    keys = [f"{name}: {group}" for name in names]
    keys += [f"turn of the track {axis}: {scan.name}" for axis in _AXES if bent]
    for quantity, number in zip(("position", "attitude"), forms, strict=True):
        keys += [
            f"drift {form} of {quantity} {axis}: {scan.name}"
            for form in range(1, number + 1)
            for axis in _AXES
        ]
    return tuple(keys)


def _smear(frame: MovingFrame, image: xr.Dataset) -> Floats:
    """Return the range uncertainty by its change during a reading [m]."""
    poses = frame.poses
    beams = np.broadcast_to(geometry_of(image).beam.direction, (*frame.shape, 3))
    rate = np.einsum("ni,ni->n", poses.velocity, poses.turn(beams.reshape(-1, 3)))
    return np.asarray(np.abs(rate) * poses.duration / np.sqrt(12)).reshape(frame.shape)


def straightened(image: xr.Dataset, motion: Motion) -> xr.Dataset:
    """Return a range image whose beams start where the moving instrument was.

    Origins and directions are in the axes of the pose in the middle of the line. Pixels
    without a pose have no range.
    """
    pose = motion.start
    geometry = geometry_of(image)
    shape = image["slant_range"].shape
    beam = geometry.beam
    direction = np.broadcast_to(beam.direction, (*shape, 3)).reshape(-1, 3)
    before = np.broadcast_to(beam.length_before, shape).reshape(-1, 1)
    entry = np.broadcast_to(beam.entry, (*shape, 3)).reshape(-1, 3)
    known = motion.poses.known
    origin = pose.back(motion.poses.place(entry - before * direction))
    ahead = motion.poses.turn(direction) @ pose.rotation
    origin = np.where(known[:, None], origin, 0.0)
    ahead = np.where(known[:, None], ahead, direction)
    values = {
        "azimuth": np.arctan2(ahead[:, 0], ahead[:, 2]),
        "elevation": -np.arcsin(np.clip(ahead[:, 1], -1.0, 1.0)),
        **{f"origin_{axis}": origin[:, k] for k, axis in enumerate("xyz")},
    }
    known = known.reshape(shape)
    grid = image["slant_range"]
    result = image.assign(
        slant_range=grid.copy(data=np.where(known, grid.values, np.nan)),
        quality_flag=image["quality_flag"].copy(
            data=image["quality_flag"].values
            | np.where(known, 0, int(QualityFlag.MISSING)).astype(
                image["quality_flag"].dtype
            )
        ),
    ).assign_coords({
        name: (("row", "column"), values[name].reshape(shape), {
            "units": LEVELS["range_image"].coordinates[name].units,
            "long_name": LEVELS["range_image"].coordinates[name].long_name,
        })
        for name in values
    })  # fmt: skip
    place = result["geometry"].copy()
    offset = np.subtract(*(
        np.asarray(place.attrs[f"{name}_position"], dtype=float)
        for name in ("receiver", "emitter")
    ))  # fmt: skip
    place.attrs = {
        name: value
        for name, value in place.attrs.items()
        if name not in WINDOW_ATTRIBUTES
    } | {"emitter_position": np.zeros(3), "receiver_position": offset}
    return result.assign_coords(geometry=place)


def by_direction(image: xr.Dataset) -> xr.Dataset:
    """Separate the rows of both directions of a beam that swings to and fro.

    Points along the track are evenly spaced within the rows of one direction only.
    Empty rows lie between both parts. The attribute `ROWS` has the number of each row
    in the scan.
    """
    if "time" not in image.coords:
        return image
    time = np.asarray(image["time"].values, dtype=float)
    with np.errstate(invalid="ignore"):
        steps = np.sign(np.nan_to_num(np.diff(time, axis=1))).sum(axis=1)
    back = steps < 0
    if not back.any() or back.all():
        return image
    forth, other = np.flatnonzero(~back), np.flatnonzero(back)
    order = np.concatenate([forth, np.zeros(_BETWEEN, dtype=np.intp), other])
    parts = image.isel(row=order)
    between = slice(len(forth), len(forth) + _BETWEEN)
    changed = {}
    for name, values in parts.data_vars.items():
        if "row" not in values.dims:
            continue
        data = values.values.copy()
        at = tuple(between if axis == "row" else slice(None) for axis in values.dims)
        blank = np.nan if np.issubdtype(data.dtype, np.floating) else 0
        data[at] = int(QualityFlag.MISSING) if name == "quality_flag" else blank
        changed[name] = values.copy(data=data)
    order[between] = -1
    return parts.assign(changed).assign_attrs({ROWS: order})


def rows_of_scan(attributes: Mapping[Any, object], rows: Numbers) -> Numbers:
    """Return the numbers of rows in the scan, for rows of a range image of a site."""
    order = attributes.get(ROWS)
    return rows if order is None else np.asarray(order, dtype=np.intp)[rows]


def row_of_image(attributes: Mapping[Any, object], row: int) -> int:
    """Return the row of a range image of a site that is a given row of the scan."""
    order = attributes.get(ROWS)
    if order is None:
        return row
    rows = np.asarray(order, dtype=np.intp)
    at = np.flatnonzero(rows == row)
    return int(at[0]) if at.size else rows.size + row


def refined(
    track: Trajectory, motion: Motion, pose: ScanPose, errors: Floats, spread: Floats
) -> tuple[Trajectory, Mounting]:
    """Return trajectory and mounting of a line, corrected by the registration.

    `errors` are the estimates of the errors `motion.keys`, and `spread` is the
    covariance of pose and errors. The trajectory has the messages during the line, and
    three before and after it.
    """
    time = motion.poses.vehicle.time
    first, last = np.nanmin(time), np.nanmax(time)
    (inside,) = np.nonzero((track.time >= first) & (track.time <= last))
    begin, end = max(inside[0] - 3, 0), inside[-1] + 4
    stamps, position = track.time[begin:end], track.position[begin:end]
    share = (stamps - first) / (last - first)
    fixed = len(motion.mounting)
    count, number = len(motion.keys), fixed
    shift, turn = np.zeros((2, count, len(stamps), 3))
    if motion.bend > 0:
        for axis in range(3):
            shift[number + axis, :, axis] = motion.bend * (2 * share - 1)
        number += 3
    for quantity, size, forms in zip(
        (shift, turn), motion.drift, motion.forms, strict=True
    ):
        for k in range(1, forms + 1):
            form = size * np.sqrt(2) / (k * np.pi) * np.cos(k * np.pi * share)
            for axis in range(3):
                quantity[number + axis, :, axis] = form
            number += 3
    correction = pose.rotation @ motion.start.rotation.T
    position = position - np.tensordot(errors, shift, axes=1)
    placed = (position - motion.start.position) @ correction.T + pose.position
    attitude = (
        Rotation.from_matrix(correction)
        * Rotation.from_rotvec(-np.tensordot(errors, turn, axes=1))
        * Rotation.from_quat(track.attitude[begin:end])
    )
    slope = np.zeros((len(stamps), 6, 6 + count))
    slope[:, :, :6] = np.eye(6)
    slope[:, :3, 3:6] = -cross_matrix(placed - pose.position)
    slope[:, :3, 6:] = -np.transpose(shift @ correction.T, (1, 2, 0))
    slope[:, 3:, 6:] = -np.transpose(turn @ correction.T, (1, 2, 0))
    covariance = slope @ spread @ slope.swapaxes(1, 2)
    result = replace(
        track,
        time=stamps,
        position=placed,
        attitude=attitude.as_quat(),
        covariance=covariance,
        remarks=(),
    )
    factors = motion.mounting
    step = -errors[:fixed] @ factors
    of_mounting = factors.T @ spread[6 : 6 + fixed, 6 : 6 + fixed] @ factors
    return result, with_covariance(changed(motion.poses.mounting, step), of_mounting)
