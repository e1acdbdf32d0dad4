"""Rigid motion of an object between two visits, with its covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from amulor.platform.attitude import cross_matrix
from amulor.site.change.distances import Region
from amulor.site.description import Site
from amulor.site.registration.bodies import held_directions, mean_lever, of_size_one
from amulor.site.registration.pair import Pair, compared, tree_of
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface, corrected

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Smallest height of the object above the ground around it [m].
_ABOVE = 0.02
#: Smallest number of points that constrain a motion, and of pixels of an object in a
#: scan [1].
_FEWEST, _FEWEST_PIXELS = 60, 20
_STEPS = 12
#: Largest component of a free motion of size 1 that is neglected [1].
_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Rigid motion of an object from the first visit to the second."""

    centre: Floats
    """Reference point of the motion in the site, shape (3,) [m]: center of the visible
    points. If the shape does not show a rotation about an axis, the point of that axis
    next to the center."""
    shift: Floats
    """Translation of the reference point: east, north, up [m]."""
    turn: Floats
    """Rotation vector about the axes east, north, up [rad]."""
    covariance: Floats
    """Covariance of translation and rotation, including poses and shared errors, shape
    (6, 6). Along `loose` it has the variance of a motion as large as the fitted one."""
    loose: tuple[Floats, ...]
    """Motions (translation, rotation) of the reference point that the object's shape
    does not constrain, such as the rotation of a body about its own axis; they are set
    to zero. The larger part, at the object's surface, has the length 1."""
    points: int
    """Number of points that constrain the motion [1]."""
    misfit: float
    """Scatter of the points over their stated noise [1]."""

    @property
    def undetermined(self) -> Flags:
        """Mask of the components of translation and rotation that `loose` changes."""
        if not self.loose:
            return np.zeros(6, dtype=bool)
        return np.asarray(np.abs(self.loose).max(axis=0) > _SHARE)

    @property
    def distance(self) -> float:
        """Length of the object's translation [m]."""
        return float(np.linalg.norm(self.shift))

    @property
    def distance_uncertainty(self) -> float:
        """Standard uncertainty of the length of the translation [m]."""
        return _along(self.shift, self.covariance[:3, :3])

    @property
    def angle(self) -> float:
        """Rotation angle of the object [rad]."""
        return float(np.linalg.norm(self.turn))

    @property
    def angle_uncertainty(self) -> float:
        """Standard uncertainty of the rotation angle [rad]."""
        return _along(self.turn, self.covariance[3:, 3:])


def _along(vector: Floats, covariance: Floats) -> float:
    """Return the standard uncertainty of a vector along its own direction."""
    unit = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return float(np.sqrt(unit @ covariance @ unit))


def free_motions(motion: Motion) -> str:
    """Describe the motions that the object's shape does not constrain, with axes."""
    words = []
    for free in motion.loose:
        turns = abs(np.linalg.norm(free[3:]) - 1) < 1e-9
        kind, axis = ("turn about", free[3:]) if turns else ("shift along", free[:3])
        words.append(f"{kind} ({', '.join(f'{value:+.2f}' for value in axis)})")
    return "; ".join(words)


def bodies(places: Sequence[Region]) -> tuple[tuple[int, ...], ...]:
    """Group regions of change that one moved object may have caused.

    The surface is lower at the former position of a body, and higher at its new one.
    These are two regions within reach of each other.
    """
    waiting = list(range(len(places)))
    groups = []
    while waiting:
        group = [waiting.pop(0)]
        for number in group:
            region = places[number]
            near = [
                k
                for k in waiting
                if np.linalg.norm(places[k].centre - region.centre)
                < places[k].reach + region.reach
            ]
            waiting = [k for k in waiting if k not in near]
            group += near
        groups.append(tuple(sorted(group)))
    return tuple(groups)


def around(places: Sequence[Region]) -> tuple[Floats, float]:
    """Return the common center of regions, and the radius that encloses them [m]."""
    area = np.array([region.area for region in places])
    centres = np.array([region.centre for region in places])
    middle = np.asarray(area @ centres / area.sum())
    reach = max(
        float(np.linalg.norm(region.centre - middle)) + region.reach
        for region in places
    )
    return middle, reach


def motion_of(
    site: Site,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    *,
    epochs: tuple[str, str],
    centre: Floats,
    reach: float,
) -> Motion | str:
    """Fit the rigid motion of an object between two visits, or return why none is.

    The object is everything above the ground, a plane fitted to the surfaces between
    one and one and a half times `reach` from the center. Its points in the second epoch
    are fitted to its surface in the first, as scans are to each other.
    """
    cut = {}
    for scan in site.scan:
        if scan.epoch not in epochs:
            continue
        on_object = _object(surfaces[scan.name], registration, scan.name, centre, reach)
        if on_object is not None and int(on_object.sum()) >= _FEWEST_PIXELS:
            cut[scan.name] = replace(
                surfaces[scan.name], smooth=surfaces[scan.name].smooth & on_object
            )
    names = [[s.name for s in site.scans_of(e) if s.name in cut] for e in epochs]
    for epoch, of_epoch in zip(epochs, names, strict=True):
        if not of_epoch:
            return (
                f"no scan of {epoch} has {_FEWEST_PIXELS} pixels of an object at least "
                f"{_ABOVE * 1e3:.0f} mm above the ground around it"
            )
    partners = [(later, earlier) for later in names[1] for earlier in names[0]]
    trees = {name: tree_of(surface) for name, surface in cut.items()}
    shift, turn = np.zeros(3), np.eye(3)
    # About the center of the visible points, errors of translation and rotation are
    # least correlated.
    clouds = [
        registration.poses[name].place(cut[name].position[cut[name].smooth])
        for name in names[0]
    ]
    middle = np.concatenate(clouds).mean(axis=0)
    pairs: list[Pair] = []
    gates = [0.08, 0.05, 0.03, 0.02, 0.015]
    for number in range(_STEPS):
        gate = gates[number] if number < len(gates) else None
        pairs = []
        for later, earlier in partners:
            back = ScanPose(
                turn.T @ registration.poses[later].rotation,
                turn.T @ (registration.poses[later].position - middle - shift) + middle,
            )
            pair = compared(
                cut[later],
                cut[earlier],
                (back, registration.poses[earlier]),
                gate=gate,
                errors=registration.errors,
                tree=trees[earlier],
            )
            if pair is not None and pair.used >= 20:
                pairs.append(pair)
        used = sum(pair.used for pair in pairs)
        if used < _FEWEST:
            return (
                f"{used} points of the object meet its surface in {epochs[0]}, and "
                f"{_FEWEST} are needed"
            )
        held, _ = _held(pairs, middle)
        normal, gradient = _sums(pairs, middle, held, steady=gate is not None)
        step = -np.linalg.pinv(normal, rcond=1e-9) @ gradient
        # A motion of the points back to the first epoch is the inverse motion of the
        # object.
        undone = Rotation.from_rotvec(step[3:]).as_matrix()
        shift = turn @ undone.T @ -step[:3] + shift
        turn = turn @ undone.T
        if gate is None and float(np.abs(step).max()) < 1e-6:
            break
    return _result(pairs, middle, shift, turn, registration, cut)


def _object(
    surface: ScanSurface,
    registration: Registration,
    name: str,
    centre: Floats,
    reach: float,
) -> Flags | None:
    """Return a mask of pixels above the ground near a point; None without a ground."""
    place = registration.poses[name].place(corrected(surface, registration.errors))
    away = np.linalg.norm((place - centre)[..., :2], axis=-1)
    with np.errstate(invalid="ignore"):
        ring = surface.usable & (away > reach) & (away < 1.6 * reach)
        inside = surface.usable & (away <= 1.1 * reach)
    if int(ring.sum()) < 30 or not inside.any():
        return None
    ground = place[ring]
    level = np.ones(len(ground), dtype=bool)
    plane = np.zeros(3)
    for _ in range(8):
        design = np.column_stack([ground[level, :2] - centre[:2], np.ones(level.sum())])
        plane = np.linalg.lstsq(design, ground[level, 2], rcond=None)[0]
        off = ground[:, 2] - (ground[:, :2] - centre[:2]) @ plane[:2] - plane[2]
        # Other objects stand on the ground, too; the ground is the lowest surface.
        spread = 1.4826 * float(np.median(np.abs(off[level] - np.median(off[level]))))
        level = (off < 2 * spread + 1e-3) & (off > -4 * spread - 1e-3)
        if int(level.sum()) < 20:
            return None
    height = place[..., 2] - (place[..., :2] - centre[:2]) @ plane[:2] - plane[2]
    with np.errstate(invalid="ignore"):
        return np.asarray(inside & (height > _ABOVE))


def _to_middle(pair: Pair, middle: Floats) -> Floats:
    """Return the matrix from motions about `middle` to motions about a pair's pivot."""
    carried = np.eye(6)
    carried[:3, 3:] = -cross_matrix(pair.pivot - middle)
    return carried


def _held(pairs: list[Pair], middle: Floats) -> tuple[Floats, tuple[Floats, ...]]:
    """Return the projector onto motions that scan pairs determine, and free motions.

    All pairs are combined, because each alone would leave a different rotation of a
    round body undetermined.
    """
    matrix = np.zeros((6, 6))
    for pair in pairs:
        into = _to_middle(pair, middle)
        weighted = (pair.by_source[:, :6] @ into) * pair.weight[:, None]
        matrix += weighted.T @ (pair.by_target[:, :6] @ into)
    lever = np.concatenate([pair.place - middle for pair in pairs])
    weight = np.concatenate([pair.weight for pair in pairs])
    unsure = float(np.sqrt(sum(pair.unsure**2 for pair in pairs)))
    return held_directions(matrix, unsure=unsure, length=mean_lever(lever, weight))


def _sums(
    pairs: list[Pair], middle: Floats, held: Floats, *, steady: bool
) -> tuple[Floats, Floats]:
    normal, gradient = np.zeros((6, 6)), np.zeros(6)
    for pair in pairs:
        into = _to_middle(pair, middle) @ held
        x = pair.by_target[:, :6] @ into
        z = x if steady else pair.by_source[:, :6] @ into
        weighted = z * pair.weight[:, None]
        normal += weighted.T @ x
        gradient += weighted.T @ pair.distance
    return normal, gradient


def _result(
    pairs: list[Pair],
    middle: Floats,
    shift: Floats,
    turn: Floats,
    registration: Registration,
    cut: Mapping[str, ScanSurface],
) -> Motion:
    held, loose = _held(pairs, middle)
    normal, _ = _sums(pairs, middle, held, steady=False)
    back = np.linalg.pinv(normal, rcond=1e-9)
    # Each pixel takes part in several pairs.
    noise = np.zeros((6, 6))
    of_pixel = {name: np.zeros((surface.own.size, 6)) for name, surface in cut.items()}
    names = list(
        dict.fromkeys(
            name
            for pair in pairs
            for name in (
                f"pose {pair.source}",
                f"pose {pair.target}",
                *(f"error {key}" for key in pair.keys),
            )
        )
    )
    width = {"pose": 6, "error": 1}
    sizes = [width[name.partition(" ")[0]] for name in names]
    starts = dict(zip(names, np.cumsum([0, *sizes[:-1]]), strict=True))
    gain = np.zeros((6, sum(sizes)))
    for pair in pairs:
        into = _to_middle(pair, middle) @ held
        weighted = (pair.by_source[:, :6] @ into) * pair.weight[:, None]
        rows = pair.misfit * weighted
        of_pixel[pair.source][pair.source_pixel] += rows * pair.along[:, None]
        of_pixel[pair.target] += pair.window.T @ rows
        for name, sign in ((pair.source, 1.0), (pair.target, -1.0)):
            block = np.eye(6)
            block[:3, 3:] = -cross_matrix(
                pair.pivot - registration.poses[name].position
            )
            at = starts[f"pose {name}"]
            gain[:, at : at + 6] += sign * weighted.T @ (pair.by_target[:, :6] @ block)
        for number, key in enumerate(pair.keys):
            column = pair.by_target[:, 6 + number]
            gain[:, starts[f"error {key}"]] += weighted.T @ column
    for name, rows in of_pixel.items():
        scaled = rows * np.nan_to_num(cut[name].own.ravel())[:, None]
        noise += scaled.T @ scaled
    prior = registration.covariance_of(*names)
    covariance = back @ (noise + gain @ prior @ gain.T) @ back.T
    # An unconstrained rotation has any angle: the reference point is on its axis, if
    # the axis passes through the object.
    away = np.zeros(3)
    if loose:
        away = _best_place(
            np.sum([np.outer(surface, surface) for surface in loose], axis=0)
        )
        extent = max(
            float(np.linalg.norm(pair.place - middle, axis=1).max()) for pair in pairs
        )
        if float(np.linalg.norm(away)) > extent:
            away = np.zeros(3)
    carried = np.eye(6)
    carried[:3, 3:] = -cross_matrix(away)
    fitted = np.concatenate(
        [shift + (turn - np.eye(3)) @ away, Rotation.from_matrix(turn).as_rotvec()]
    )
    lever = np.concatenate([pair.place - middle - away for pair in pairs])
    length = mean_lever(lever, np.concatenate([pair.weight for pair in pairs]))
    loose = tuple(of_size_one(carried @ motion, length) for motion in loose)
    if loose:
        # The steps of the fit leave a part of the free motions.
        scale = np.repeat([1.0, length], 3)
        free = (np.array(loose) * scale).T
        fitted -= free @ np.linalg.lstsq(free, scale * fitted, rcond=None)[0] / scale
    return Motion(
        centre=middle + away,
        shift=fitted[:3],
        turn=fitted[3:],
        covariance=carried @ covariance @ carried.T
        + _free(loose, fitted[:3], fitted[3:], length=length),
        loose=loose,
        points=sum(pair.used for pair in pairs),
        misfit=max(pair.misfit for pair in pairs),
    )


def _free(
    loose: tuple[Floats, ...], shift: Floats, turn: Floats, *, length: float
) -> Floats:
    """Return the covariance of free motions that are as large as the fitted motion."""
    size = np.hypot(np.linalg.norm(shift), length * np.linalg.norm(turn))
    covariance = np.zeros((6, 6))
    for motion in loose:
        at_surface = np.hypot(
            np.linalg.norm(motion[:3]), length * np.linalg.norm(motion[3:])
        )
        covariance += (size / at_surface) ** 2 * np.outer(motion, motion)
    return covariance


def _best_place(covariance: Floats) -> Floats:
    """Return the reference point for which the translation is most certain [m].

    The translation of the point d is t + w x d; d minimizes its mean square error.
    """
    turns, both = covariance[3:, 3:], covariance[:3, 3:]
    matrix = np.trace(turns) * np.eye(3) - turns
    cross = np.array(
        [
            both[1, 2] - both[2, 1],
            both[2, 0] - both[0, 2],
            both[0, 1] - both[1, 0],
        ]
    )
    return np.asarray(-np.linalg.pinv(matrix, rcond=1e-9) @ cross)
