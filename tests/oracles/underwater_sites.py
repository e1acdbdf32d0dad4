"""Underwater sites with exact geometry, scanned from drawn poses.

Nothing is shared with the package. A scene is a field that is positive in the water,
zero on the surface, and grows by at most one metre a metre, so that a beam may advance
by the field without passing a surface (sphere tracing); the last step is a bisection.
Poses are rotations built from heading, pitch and roll as surveyors define them.
"""

from dataclasses import dataclass, field, replace

import numpy as np

FREQUENCY, GROUP_INDEX, LIGHT = 40e6, 1.36, 299792458.0


def rotation(axis, angle):
    """Return the matrix of a turn about an axis (Rodrigues)."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def angle_between(one, other):
    """Return the angle of the turn from one rotation to another [rad]."""
    return float(np.arccos(np.clip((np.trace(one.T @ other) - 1) / 2, -1, 1)))


@dataclass(frozen=True)
class Station:
    """Place, heading clockwise from north, pitch upwards, roll right side down."""

    place: tuple
    heading: float
    pitch: float
    roll: float = 0.0

    @property
    def matrix(self):
        """Columns: right, down, forward of the instrument in east, north, up."""
        # Level and looking north, then turned about its own axes.
        axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        for axis, angle in (
            ((0, 1, 0), self.heading),
            ((1, 0, 0), self.pitch),
            ((0, 0, 1), self.roll),
        ):
            axes = axes @ rotation(axis, angle)
        return axes


def looking(place, at, roll=0.0):
    """Return the station at a place that looks at a point."""
    east, north, up = np.asarray(at, dtype=float) - place
    return Station(
        tuple(place), np.arctan2(east, north), np.arctan2(up, np.hypot(east, north)),
        roll,
    )  # fmt: skip


# Scenes: fields of points of shape (n, 3).


@dataclass(frozen=True)
class Swelling:
    """Change of the height of a bed: a block, a heap, a wedge, or a hollow if negative.

    A block has a flat top, and flanks that are smooth steps; a wedge rises from 0 at
    one end to its height at the other; a heap is a Gaussian.
    """

    shape: str
    height: float
    middle: tuple
    half: tuple
    flank: float
    turn: float = 0.0

    def __call__(self, x, y):
        sine, cosine = np.sin(self.turn), np.cos(self.turn)
        x, y = x - self.middle[0], y - self.middle[1]
        along, across = cosine * x + sine * y, cosine * y - sine * x
        if self.shape == "heap":
            square = (along / self.half[0]) ** 2 + (across / self.half[1]) ** 2
            return self.height * np.exp(-2 * square)
        size = self.height
        for away, half in zip((along, across), self.half, strict=True):
            t = np.clip((half - np.abs(away)) / self.flank, 0, 1)
            size = size * t * t * (3 - 2 * t)
        if self.shape == "wedge":
            size = size * (1 + np.clip(along / self.half[0], -1, 1)) / 2
        return size

    @property
    def steepest(self):
        """Return a bound of the slope [1]."""
        least = min(self.half)
        if self.shape == "heap":
            return 2 * np.exp(-0.5) * abs(self.height) / least
        step = 1.5 * np.sqrt(2) * abs(self.height) / self.flank
        return step + abs(self.height) / least


@dataclass(frozen=True)
class Bed:
    """Sea bed of Gaussian humps on a tilted plane, and a bump with flat top."""

    humps: tuple = ()
    tilt: tuple = (0.0, 0.0)
    bump: float = 0.0
    middle: tuple = (0.0, 0.0)
    half: float = 0.10
    flank: float = 0.04
    swellings: tuple = ()

    def profile(self, away):
        """Return a smooth step from 1 at the plateau to 0 at the half width."""
        t = np.clip((self.half - np.abs(away)) / self.flank, 0, 1)
        return t * t * (3 - 2 * t)

    def height(self, x, y):
        """Return the height of the bed [m]."""
        z = self.tilt[0] * x + self.tilt[1] * y
        for east, north, high, wide in self.humps:
            square = (x - east) ** 2 + (y - north) ** 2
            z = z + high * np.exp(-square / (2 * wide**2))
        if self.bump:
            east, north = self.middle
            z = z + self.bump * self.profile(x - east) * self.profile(y - north)
        for swelling in self.swellings:
            z = z + swelling(x, y)
        return z

    @property
    def steepest(self):
        """Return a bound of the slope [1]."""
        slope = np.hypot(*self.tilt) + 1.5 * abs(self.bump) / self.flank * np.sqrt(2)
        slope += sum(swelling.steepest for swelling in self.swellings)
        return slope + sum(abs(h) / w * np.exp(-0.5) for _, _, h, w in self.humps)

    def __call__(self, point):
        off = point[:, 2] - self.height(point[:, 0], point[:, 1])
        return off / np.hypot(1, self.steepest)


@dataclass(frozen=True)
class Wall:
    """Wall in the plane y = 0, water at y < 0, with struts (capsules)."""

    struts: tuple

    def __call__(self, point):
        found = -point[:, 1]
        for begin, end, radius in self.struts:
            begin, end = np.asarray(begin, float), np.asarray(end, float)
            axis = end - begin
            at = np.clip((point - begin) @ axis / (axis @ axis), 0, 1)
            away = np.linalg.norm(point - begin - at[:, None] * axis, axis=1)
            found = np.minimum(found, away - radius)
        return found


@dataclass(frozen=True)
class Amphora:
    """Body of revolution: a belly, shoulders and a neck, with two handles."""

    place: tuple
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    size: float = 0.35

    def moved(self, shift, turn):
        """Return it moved by a shift of its centre and a turn about that."""
        angle = np.linalg.norm(turn)
        spin = rotation(turn, angle) if angle else np.eye(3)
        return replace(
            self, place=tuple(np.add(self.place, shift)), axes=spin @ self.axes
        )

    def __call__(self, point):
        # Along the first axis of its own; lengths in parts of its size.
        p = (point - self.place) @ self.axes / self.size
        along, across = p[:, 0], np.hypot(p[:, 1], p[:, 2])
        balls = [(-0.5, 0.20), (-0.25, 0.30), (0.05, 0.36), (0.3, 0.26), (0.5, 0.14),
                 (0.75, 0.13)]  # fmt: skip
        # A smooth union of balls along the axis: no step of normals between them.
        sharp = 12.0
        total = sum(
            np.exp(-sharp * (np.hypot(along - a, across) - r)) for a, r in balls
        )
        found = -np.log(np.maximum(total, 1e-300)) / sharp
        for side in (1, -1):
            ring = np.hypot(
                np.hypot(along - 0.45, p[:, 1] - side * 0.12) - 0.22, p[:, 2]
            )
            found = np.minimum(found, ring - 0.045)
        return found * self.size


@dataclass(frozen=True)
class Ball:
    """A sphere, such as a fish."""

    place: tuple
    radius: float

    def __call__(self, point):
        return np.linalg.norm(point - self.place, axis=1) - self.radius


@dataclass(frozen=True)
class Scene:
    """Several fields at once."""

    parts: tuple

    def __call__(self, point):
        return np.min([part(point) for part in self.parts], axis=0)


def cast(scene, station, directions, farthest=8.0):
    """Return the distance along each beam to the surface; NaN for none [m]."""
    beams = (directions @ station.matrix.T).reshape(-1, 3)
    place = np.asarray(station.place, dtype=float)
    far = np.zeros(len(beams))
    found = np.full(len(beams), np.nan)
    left = np.arange(len(beams))
    for _ in range(400):
        off = scene(place + far[left, None] * beams[left])
        near = off < 1e-4
        if near.any():
            found[left[near]] = far[left[near]]
        left, off = left[~near], off[~near]
        far[left] += off
        left = left[far[left] < farthest]
        if not len(left):
            break
    hit = np.flatnonzero(np.isfinite(found))
    low, high = found[hit] - 2e-3, found[hit].copy()
    # On to the other side of the surface; a beam that only grazes it has no range.
    for _ in range(60):
        outside = scene(place + high[:, None] * beams[hit]) > 0
        if not outside.any():
            break
        high[outside] += 1e-3
    crossed = scene(place + high[:, None] * beams[hit]) <= 0
    for _ in range(45):
        middle = (low + high) / 2
        outside = scene(place + middle[:, None] * beams[hit]) > 0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    found[hit] = np.where(crossed, (low + high) / 2, np.nan)
    return found.reshape(directions.shape[:-1])


def grid(rows, columns, half=0.35):
    """Return azimuth, elevation and unit vectors (right, down, forward) of a scan."""
    azimuth, elevation = np.meshgrid(
        np.linspace(-half, half, columns),
        np.linspace(half * rows / columns, -half * rows / columns, rows),
    )
    unit = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    return azimuth, elevation, unit


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the errors of ranges."""

    own: float = 1e-3
    delay: float = 1e-3
    index: float = 2e-4
    reference: float = 5e-4


@dataclass
class Drawn:
    """Errors that scans of one instrument, one water or one reference share."""

    rng: np.random.Generator
    numbers: dict = field(default_factory=dict)

    def of(self, key):
        """Return the number of a key, always the same."""
        return self.numbers.setdefault(key, float(self.rng.normal()))


def measured(distance, noise, drawn, *, scan, visit):
    """Return ranges with errors drawn as they are stated [m]."""
    turn = 4 * np.pi * FREQUENCY * GROUP_INDEX / LIGHT * distance
    return (
        distance
        + noise.own * drawn.rng.normal(size=distance.shape)
        + noise.delay * drawn.of(f"delay {visit}")
        + noise.index * distance * drawn.of(f"index {visit}")
        + noise.reference * drawn.of(f"cosine {scan}") * np.cos(turn)
        + noise.reference * drawn.of(f"sine {scan}") * np.sin(turn)
    )


@dataclass(frozen=True)
class Start:
    """Start pose as a surveyor states it: the station, and its stated errors."""

    station: Station
    position: float
    heading: float
    level: float


def start_of(station, rng, *, position, angle, stated=None):
    """Return a start pose that is wrong by drawn errors, each axis by itself."""
    off = rng.normal(size=6) * ([position] * 3 + [angle] * 3)
    told = stated or (position, angle)
    return Start(
        Station(
            tuple(np.add(station.place, off[:3])),
            station.heading + off[3],
            station.pitch + off[4],
            station.roll + off[5],
        ),
        told[0], told[1], told[1],
    )  # fmt: skip


def ring(
    count, rng, *, at=(0.0, 0.0, 0.05), reach=2.5, spread=2 * np.pi, toward=-np.pi / 2
):
    """Return stations about a place, on an arc of headings."""
    found = []
    for number in range(count):
        angle = toward + spread * ((number + 0.5) / count - 0.5)
        angle += rng.uniform(-0.15, 0.15)
        down = rng.uniform(0.6, 0.9)
        place = np.asarray(at) + reach * np.array(
            [np.cos(angle) * np.cos(down), np.sin(angle) * np.cos(down), np.sin(down)]
        )
        found.append(looking(place, np.asarray(at) + rng.uniform(-0.05, 0.05, 3)))
    return found


def bed(rng, high=(0.05, 0.15)):
    """Return a sea bed with eight humps."""
    humps = [
        (*rng.uniform(-1, 1, 2), rng.uniform(*high), rng.uniform(0.15, 0.35))
        for _ in range(8)
    ]
    return Bed(tuple(humps), tuple(rng.uniform(-0.05, 0.05, 2)))


#: Kinds of change of a bed between two visits.
CHANGES = ("bump", "hollow", "heap", "flank", "slope", "wedge", "body")


def changed_bed(kind, height, rng):
    """Return a bed before and after a change of a kind and a size [m].

    A flank is steep; a slope is a bump on ground that falls by 15 to 30 degrees; a body
    is a stone that moves along the bed by its size.
    """
    ground = bed(rng, high=(0.03, 0.08))
    middle, half = tuple(rng.uniform(-0.15, 0.15, 2)), tuple(rng.uniform(0.09, 0.2, 2))
    turn, flank = rng.uniform(0, np.pi), rng.uniform(0.03, 0.06)
    if kind == "slope":
        fall = np.tan(np.radians(rng.uniform(15, 30)))
        toward = rng.uniform(0, 2 * np.pi)
        ground = replace(ground, tilt=(fall * np.cos(toward), fall * np.sin(toward)))
    if kind == "body":
        stone = Swelling("heap", rng.uniform(0.06, 0.12), middle, (0.2, 0.2), 0.0)
        way = height * np.array([np.cos(turn), np.sin(turn)])
        moved = replace(stone, middle=tuple(np.add(middle, way)))
        return (
            replace(ground, swellings=(stone,)),
            replace(ground, swellings=(moved,)),
        )
    if kind == "flank":
        flank = rng.uniform(0.01, 0.02)
    shape = {"heap": "heap", "wedge": "wedge"}.get(kind, "block")
    size = -height if kind == "hollow" or rng.random() < 0.3 else height
    swelling = Swelling(shape, size, middle, half, flank, turn)
    return ground, replace(ground, swellings=(swelling,))


def with_moved_stone(before, after, at, way, rng):
    """Return a bed before and after a change, with a stone at `at` moved by `way`."""
    stone = Swelling("heap", rng.uniform(0.06, 0.12), tuple(at), (0.2, 0.2), 0.0)
    moved = replace(stone, middle=tuple(np.add(at, way)))
    return (
        replace(before, swellings=(*before.swellings, stone)),
        replace(after, swellings=(*after.swellings, moved)),
    )


def along_normals(before, after, place, normal, reach=0.2):
    """Return distances of two beds along lines, by bisection [m]."""

    def crossing(scene):
        low, high = np.full(len(place), -reach), np.full(len(place), reach)
        for _ in range(50):
            middle = (low + high) / 2
            at = place + middle[:, None] * normal
            below = (at[:, 2] - scene.height(at[:, 0], at[:, 1])) * normal[:, 2] < 0
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return (low + high) / 2

    return crossing(after) - crossing(before)


def amphorae(rng):
    """Return two amphorae of a cargo, side by side on a gentle sea bed."""
    ground = bed(rng, high=(0.005, 0.02))
    heading = rng.uniform(0, 2 * np.pi)
    apart = 0.28 * np.array([-np.sin(heading), np.cos(heading), 0.0])
    things = []
    for side in (-1, 1):
        turned = rotation((0, 0, 1), heading + rng.uniform(-0.15, 0.15))
        things.append(Amphora(tuple(side * apart + [0, 0, 0.10]), turned, 0.36))
    return Scene((ground, *things))


def wall(rng):
    """Return a wall with upright, level and slanting struts."""
    struts = []
    for east in (-0.6, 0.1, 0.7):
        struts.append(((east, -0.03, -2), (east + 0.05, -0.03, 2), 0.14))
    for up in (-0.4, 0.5):
        struts.append(((-2, -0.02, up), (2, -0.02, up + rng.uniform(-0.1, 0.1)), 0.12))
    struts.append(((-0.6, -0.04, -0.9), (0.8, -0.04, 0.9), 0.10))
    return Wall(tuple(struts))


def wall_stations(count, rng):
    """Return stations in front of the wall."""
    found = []
    for number in range(count):
        east = 1.4 * ((number + 0.5) / count - 0.5) * 2 + rng.uniform(-0.1, 0.1)
        up = rng.uniform(-0.6, 0.6)
        found.append(looking((east, -2.2, up), rng.uniform(-0.1, 0.1, 3) * [1, 0, 1]))
    return found


@dataclass(frozen=True)
class Corner:
    """Three planes that meet: a floor and two walls, water above and before them."""

    turn: float

    def __call__(self, point):
        sine, cosine = np.sin(self.turn), np.cos(self.turn)
        first = cosine * point[:, 0] + sine * point[:, 1]
        second = -sine * point[:, 0] + cosine * point[:, 1]
        return np.minimum(np.minimum(first + 1.0, second + 1.0), point[:, 2])


def corner(rng):
    """Return a corner of two walls on a floor, turned a little, and some stones."""
    stones = [
        Ball((*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.05, 0.05)), 0.15)
        for _ in range(3)
    ]
    return Scene((Corner(rng.uniform(-0.1, 0.1)), *stones))


def corner_stations(count, rng):
    """Return stations that look into the corner."""
    return ring(
        count, rng, at=(-0.5, -0.5, 0.3), spread=1.2, toward=np.pi / 4, reach=2.6
    )
