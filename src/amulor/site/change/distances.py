"""Distances between surfaces of two visits along normals (M3C2), with uncertainty."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import norm

from amulor._discoveries import largest_discovered
from amulor._progress import tell
from amulor.errors import CubeError
from amulor.io.files import atomic_output
from amulor.site.description import Site
from amulor.site.merging.cloud import Merged, by_unknowns, unknowns_of
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Points of each epoch that a curved patch needs [1].
_FEWEST = 12
#: Largest distance of a point of a patch, in units of the scatter [1].
_OFF = 3.5
#: If points scatter about a patch by more than this fraction of its radius, there is no
#: single surface [1].
_ROUGH = 0.3
#: Scatter about a patch above that of noise is its shape, and this part of it an error
#: of the height [1].
_SHAPE = 0.75
#: Scatter exceeds noise if it is larger by this many standard errors [1].
_SURE = 4.0
#: Gap between layers of surface in one cell, in spacings [1].
_LAYER = 2.0
#: Largest correction of a shared error at unchanged places, in standard errors [1].
_CORRECTED = 3.0
#: Distance from a change, in radii of the cylinders, of places that count as unchanged.
_APART = 2.0
#: Factor on the noise of corrections, for the tails of changes below significance [1].
_TAILS = 2.0
#: Correlation of the heights of two patches whose axes are 0, 0.1, ..., 2 radii apart:
#: the overlap of the weights :math:`4 - 6 r^2` of the points of a disk [1].
_CORRELATION = np.array(
    [1, 0.923, 0.823, 0.709, 0.587, 0.464, 0.347, 0.239, 0.146, 0.069, 0.011,
     -0.028, -0.049, -0.054, -0.047, -0.032, -0.014, 0.001, 0.009, 0.008, 0]
)  # fmt: skip
#: Number of cylinders searched at once, which limits memory.
_AT_ONCE = 500
#: Number of places compared at once, which limits memory, too.
_PIECE = 2000
#: Least cosine of the angle between the normals of points that belong together [1].
_ALIKE = 0.6


@dataclass(frozen=True, kw_only=True)
class Change:
    """Change between two visits at points of the first visit's surface."""

    epochs: tuple[str, str]
    """Names of the visits."""
    position: Floats
    """Points at which the visits are compared, in the site's frame, shape (n, 3)
    [m]."""
    normal: Floats
    """Normals of the first visit's surface at the points, shape (n, 3) [1]."""
    value: Floats
    """Distance from the first visit's surface to the second visit's surface along the
    normal; NaN where either was not measured, shape (n,) [m]."""
    uncertainty: Floats
    """Combined standard uncertainty of the distance [m]."""
    own: Floats
    """Part of the uncertainty from noise and roughness, independent between points
    [m]."""
    shape: Floats
    """Part of `own` from surfaces that no patch follows, such as steep flanks [m]."""
    shared: Floats
    """Change of the distance by one standard deviation of each independent error of
    poses, delay, index and open-water references, shape (n, m) [m]."""
    significant: Flags
    """Mask of points with significant change."""
    chance: Floats
    """Probability of so large a distance without a change [1]."""
    area: Floats
    """Area of the surface that each point represents, shape (n,) [m^2]."""
    spacing: float
    """Distance between neighboring points of comparison [m]."""
    radius: float
    """Radius of the cylinders in which measured points are averaged [m]."""
    false_alarms: float
    """Expected fraction of false alarms among the significant points [1]."""


def change(
    site: Site,
    registration: Registration,
    surfaces: Mapping[str, ScanSurface],
    cloud: Merged,
    *,
    epochs: tuple[str, str] | None = None,
) -> Change:
    r"""Compute the change between two visits to a site.

    Notes
    -----
    The method is M3C2 [1]_, with patches of second degree instead of means. Patches are
    fitted to the points of either epoch in a cylinder along the normal, weighted by
    their noise. The variance of a distance has two parts. One is that of the heights on
    the axis, from the stated noise or the scatter, whichever is larger. The other is
    :math:`j \Sigma j^T`, with the derivative j of the distance by all poses and shared
    errors, and their covariance :math:`\Sigma`; errors that both epochs share cancel.
    The method of Benjamini and Hochberg limits the fraction of false alarms, in place
    of a fixed limit of detection.

    A small change is part of the surface that the registration fits, so it shifts the
    poses against itself. The shared errors are therefore fitted again to the places
    without significant change, and the distances are corrected.

    References
    ----------
    .. [1] D. Lague, N. Brodu, J. Leroux, ISPRS J. Photogramm. Remote Sens. 82 (2013)
       10, :doi:`10.1016/j.isprsjprs.2013.04.009`.
    """
    names = epochs or (site.epoch[0].name, site.epoch[-1].name)
    parts = []
    for name in names:
        usable = cloud.of_epoch(name) & ~cloud.moving
        if not (usable & np.isfinite(cloud.normal).all(axis=1)).any():
            raise CubeError(
                f"epoch {name!r}: no point of its scans lies on a smooth surface; look "
                "at its scans, or name other epochs"
            )
        parts.append(np.flatnonzero(usable))
    if names[0] == names[1]:
        raise CubeError(f"both epochs are {names[0]!r}; name two visits")
    pixels = max(surfaces[scan.name].spacing for scan in site.scan)
    spacing = site.comparison.spacing or 2 * pixels
    radius = site.comparison.radius or 1.5 * spacing
    core, normal, area = _cores(cloud, parts[0], spacing, radius)
    everything = list(
        dict.fromkeys(
            name
            for scan in site.scan
            if scan.epoch in names
            for name in unknowns_of(scan.name, surfaces[scan.name])
        )
    )
    means = []
    for number, part in enumerate(parts):
        tell(f"means of {names[number]}", 0.1 + 0.4 * number)
        means.append(
            _means(cloud, part, core, normal, radius, site.comparison.reach, surfaces,
                   registration, everything)
        )  # fmt: skip
    first, second = means
    value = second.value - first.value
    noise = np.hypot(first.own, second.own)
    shape = np.hypot(first.shape, second.shape)
    slope = second.slope
    slope -= first.slope
    del means, first, second
    prior = registration.covariance_of(*everything)
    energy, axes = np.linalg.eigh(prior)
    root = axes * np.sqrt(np.maximum(energy, 0.0))
    shared = slope @ root
    del slope
    if not np.isfinite(value).any():
        raise _nothing_common(names)
    result = Change(
        epochs=names,
        position=core,
        normal=normal,
        value=value,
        uncertainty=noise,
        own=noise,
        shape=shape,
        shared=shared,
        significant=np.zeros(len(core), dtype=bool),
        chance=np.ones(len(core)),
        area=area,
        spacing=spacing,
        radius=radius,
        false_alarms=site.comparison.false_alarms,
    )
    result = _tested(result)
    visit = {scan.name: scan.epoch for scan in site.scan}
    ends = [{visit[pair[end]] for end in ("source", "target")}
            for pair in registration.pairs]  # fmt: skip
    if set(names) in ends:
        # Changes that the first correction uncovers are left out of the second.
        uncorrected = result
        for _ in range(2):
            unchanged = _unchanged(result)
            # Frees the derivatives by shared errors, which are the largest arrays.
            result = uncorrected
            result = _tested(_corrected(uncorrected, unchanged))
    return result


def _tested(change: Change) -> Change:
    """Return a comparison with the significance of its distances."""
    uncertainty = np.sqrt(
        change.own**2 + np.einsum("ij,ij->i", change.shared, change.shared)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        chance = 2 * norm.sf(np.abs(change.value) / uncertainty)
    limit = largest_discovered(chance, share=change.false_alarms)
    return replace(
        change, uncertainty=uncertainty, chance=chance, significant=chance <= limit
    )


def _unchanged(change: Change) -> Flags:
    """Return a mask of unchanged points that are far from regions of change."""
    unchanged = np.isfinite(change.value) & ~change.significant
    members = [group for group in _groups(change) if len(group) >= _FEWEST_POINTS]
    if members:
        tree = cKDTree(change.position[np.concatenate(members)])
        reach = _APART * change.radius
        away = tree.query(change.position, distance_upper_bound=reach)[0]
        unchanged &= ~np.isfinite(away)
    return unchanged


def _corrected(change: Change, unchanged: Flags) -> Change:
    """Correct a comparison for the shared errors estimated from unchanged points.

    The errors are estimated with a weak prior, or with the stated one if they exceed
    it. Their covariance is that of this
    estimate, for shared errors as stated and noise that overlapping cylinders repeat.
    """
    at = np.flatnonzero(unchanged)
    rows = change.shared[at] / change.own[at, None]
    values = change.value[at] / change.own[at]
    repeated = max(np.pi * change.radius**2 / (4 * change.spacing**2), 1.0)
    for size in (_CORRECTED, 1.0):
        weak = np.eye(rows.shape[1]) / size**2
        used = np.ones(len(at), dtype=bool)
        for _ in range(3):
            some = rows[used]
            matrix = some.T @ some
            inverse = np.linalg.inv(matrix + weak)
            errors = inverse @ (some.T @ values[used])
            del some
            used = np.abs(values - rows @ errors) < _OFF
        # Larger errors fit the shape of patches, and would change the bump.
        if np.abs(errors).max(initial=0.0) < _OFF * size:
            break
    del rows
    spread = inverse @ (_TAILS * repeated * matrix + weak @ weak) @ inverse
    energy, axes = np.linalg.eigh(spread)
    root = axes * np.sqrt(np.maximum(energy, 0.0))
    return replace(
        change,
        value=change.value - change.shared @ errors,
        shared=change.shared @ root,
    )


def _nothing_common(names: tuple[str, str]) -> CubeError:
    """Return the error message for two visits that share no surface."""
    return CubeError(
        f"{names[0]} and {names[1]} see no surface together; look at the start poses "
        "with amulor site check, or set comparison.reach or comparison.radius larger"
    )


def _cores(
    cloud: Merged, at: NDArray[np.intp], spacing: float, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Return position, normal and area of one comparison point per surface cell.

    Cells are squares across the coordinate axis nearest to the normal. Layers along
    that axis are separate surfaces.
    """
    place, normals = cloud.position[at], cloud.normal[at]
    smooth = np.isfinite(normals).all(axis=1)
    nearest = cKDTree(place[smooth]).query(place[~smooth])[1]
    normals[~smooth] = normals[smooth][nearest]
    axis = np.abs(normals).argmax(axis=1)
    number = np.arange(len(place))
    across = np.array([[1, 2], [2, 0], [0, 1]])[axis]
    cell = np.floor(np.take_along_axis(place, across, axis=1) / spacing)
    height = place[number, axis]
    order = np.lexsort((height, cell[:, 1], cell[:, 0], axis))
    changed = np.diff(np.column_stack([axis, cell])[order], axis=0).any(axis=1)
    changed |= np.diff(height[order]) > _LAYER * spacing
    group = np.empty(len(place), dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(changed)])
    count = np.bincount(group)

    def mean(values: Floats) -> Floats:
        sums = [np.bincount(group, weights=values[:, k]) for k in range(3)]
        return np.stack(sums, axis=1) / count[:, None]

    core = mean(place)
    tree = cKDTree(place)
    normal = np.array(
        [
            normals[members].mean(axis=0)
            for begin in range(0, len(core), _AT_ONCE)
            for members in tree.query_ball_point(core[begin : begin + _AT_ONCE], radius)
        ]
    )
    size = np.linalg.norm(normal, axis=1)
    # Points whose normals have all directions lie on an edge, not on a surface.
    good = (size > 0.8) & (count >= 2)
    normal = normal / np.maximum(size, 1e-9)[:, None]
    of_group = np.empty(len(count), dtype=np.intp)
    of_group[group] = axis
    facing = np.abs(normal[np.arange(len(count)), of_group])
    area = spacing**2 / np.maximum(facing, 0.3)
    return core[good], normal[good], area[good]


@dataclass(frozen=True)
class _Means:
    value: Floats
    own: Floats
    shape: Floats
    slope: Floats


def _means(
    cloud: Merged,
    at: NDArray[np.intp],
    core: Floats,
    normal: Floats,
    radius: float,
    reach: float,
    surfaces: Mapping[str, ScanSurface],
    registration: Registration,
    unknowns: Sequence[str],
) -> _Means:
    """Return mean heights along normals, with noise and derivatives by unknowns."""
    width = {"pose": 6, "point": 3, "error": 1}
    sizes = [width[name.partition(" ")[0]] for name in unknowns]
    ends = np.cumsum(sizes)
    columns = {
        name: np.arange(end - size, end)
        for name, size, end in zip(unknowns, sizes, ends, strict=True)
    }
    slope = np.zeros((len(core), int(ends[-1])))
    value, own, shape = (np.full(len(core), np.nan) for _ in range(3))
    tree = cKDTree(cloud.position[at])
    # Pieces limit the memory.
    for begin in range(0, len(core), _PIECE):
        some = slice(begin, begin + _PIECE)
        facing = normal[some]
        owner, index, off, along = _in_cylinders(
            cloud, at, core[some], facing, radius, reach, tree=tree
        )
        points, size = at[index], len(facing)
        beams = np.einsum("ij,ij->i", cloud.beam[points], facing[owner])
        weight = 1 / np.maximum(np.abs(beams) * cloud.own[points], 1e-6) ** 2
        fitted = _patches(owner, along, off, facing, weight, radius)
        value[some] = np.where(fitted.good, fitted.height, np.nan)
        own[some], shape[some] = fitted.own, fitted.shape
        for number in np.unique(cloud.scan[points]):
            scan = cloud.site.scan[number].name
            mine = cloud.scan[points] == number
            surface, pose = surfaces[scan], registration.poses[scan]
            by_scan = by_unknowns(
                surface, pose, cloud.position[points[mine]], cloud.pixel[points[mine]]
            )
            by_scan = np.einsum("ni,nij->nj", facing[owner[mine]], by_scan)
            by_scan *= fitted.share[mine][:, None]
            names = unknowns_of(scan, surface)
            into = np.concatenate([columns[name] for name in names])
            for column, part in zip(into, by_scan.T, strict=True):
                slope[some, column] += np.bincount(owner[mine], part, minlength=size)
    return _Means(value, own, shape, slope)


def _in_cylinders(
    cloud: Merged,
    at: NDArray[np.intp],
    core: Floats,
    normal: Floats,
    radius: float,
    reach: float,
    *,
    tree: cKDTree | None = None,
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
    """Return cylinder number, point index, offset and axial offset of enclosed points.

    Cylinders are searched by slabs along their axes and in groups, because one sphere
    around a cylinder contains many more points.
    """
    tree = cKDTree(cloud.position[at]) if tree is None else tree
    place = np.asarray(tree.data)
    slabs = max(math.ceil(reach / radius), 1)
    half = reach / slabs
    ball = 1.000001 * math.hypot(radius, half)
    pieces = []
    for begin, slab in itertools.product(
        range(0, max(len(core), 1), _AT_ONCE), range(slabs)
    ):
        some = slice(begin, begin + _AT_ONCE)
        middle = core[some] + ((2 * slab + 1) * half - reach) * normal[some]
        near = tree.query_ball_point(middle, ball)
        owner = begin + np.repeat(
            np.arange(len(near)), [len(members) for members in near]
        )
        index = np.concatenate([np.empty(0, np.intp), *map(np.asarray, near)]).astype(
            np.intp
        )
        off = place[index] - core[owner]
        along = np.einsum("ij,ij->i", off, normal[owner])
        across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0))
        facing = np.einsum("ij,ij->i", cloud.normal[at[index]], normal[owner])
        # Points without a normal, on flanks and creases, are selected by position
        # alone.
        alike = ~(facing <= _ALIKE)
        number = np.clip((along + reach) // (2 * half), 0, slabs - 1)
        inside = (across <= radius) & (np.abs(along) <= reach) & alike
        inside &= number == slab
        pieces.append((owner[inside], index[inside], off[inside], along[inside]))
    owner, index, off, along = (
        np.concatenate(piece) for piece in zip(*pieces, strict=True)
    )
    order = np.lexsort((index, owner))
    return owner[order], index[order], off[order], along[order]


@dataclass(frozen=True)
class _Patches:
    height: Floats
    own: Floats
    shape: Floats
    share: Floats
    good: Flags


def _patches(
    owner: NDArray[np.intp],
    along: Floats,
    off: Floats,
    normal: Floats,
    weight: Floats,
    radius: float,
) -> _Patches:
    """Return heights of curved surfaces fitted to points in cylinders, with errors.

    Patches have the second degree, so that two epochs with different sampling of a
    slope or a bend have equal heights. Points that scatter more than their noise, as on
    a steep flank, do not lie on such a patch; the height then has an error by its
    shape. `share` has the derivatives of a height by the heights of the points.
    """
    size = len(normal)
    helper = np.where(np.abs(normal[:, :1]) < 0.8, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    u = np.einsum("ij,ij->i", off, first[owner]) / (radius / 2)
    v = np.einsum("ij,ij->i", off, second[owner]) / (radius / 2)
    terms = np.stack([np.ones_like(u), u, v, u**2, u * v, v**2], axis=1)
    used = weight.copy()
    for _ in range(3):
        count = np.bincount(owner[used > 0], minlength=size)
        scale = np.maximum(np.bincount(owner, weights=used, minlength=size), 1e-300)
        part = used / scale[owner]
        matrix = np.zeros((size, 6, 6))
        right = np.zeros((size, 6))
        for i in range(6):
            of_term = part * terms[:, i]
            right[:, i] = np.bincount(owner, weights=of_term * along, minlength=size)
            for j in range(i, 6):
                matrix[:, i, j] = matrix[:, j, i] = np.bincount(
                    owner, weights=of_term * terms[:, j], minlength=size
                )
        back = np.linalg.inv(matrix + 1e-9 * np.eye(6))
        solved = np.einsum("nij,nj->ni", back, right)
        residual = along - np.einsum("ij,ij->i", terms, solved[owner])
        freedom = np.maximum(count - 6, 1)
        square = np.bincount(owner, weights=used * residual**2, minlength=size)
        scatter = np.sqrt(np.maximum(square / freedom, 1.0))
        used = np.where(
            np.abs(residual) * np.sqrt(weight) < _OFF * scatter[owner], weight, 0.0
        )
    share = np.einsum("ij,ij->i", back[owner, 0], terms) * part
    deviation = np.sqrt(np.abs(back[:, 0, 0]) / np.maximum(scale, 1e-30)) * scatter
    # Root mean square of the shape: scatter without the noise.
    noise = count / np.maximum(np.bincount(owner, used, minlength=size), 1e-300)
    excess = np.where(
        scatter**2 > 1 + _SURE * np.sqrt(2 / freedom), scatter**2 - 1, 0.0
    )
    shape = np.sqrt(excess * noise)
    deviation = np.hypot(deviation, _SHAPE * shape)
    good = (count >= _FEWEST) & (back[:, 0, 0] < 0.5 * _FEWEST)
    good &= shape < _ROUGH * radius
    return _Patches(solved[:, 0], deviation, _SHAPE * shape, share, good)


#: Smallest number of points of a region [1].
_FEWEST_POINTS = 4
#: Uncertainty of an area in spacings times its root, and in the area not compared [1].
_AREA, _AREA_LOST = 0.5, 0.7
#: Part of the errors by shape that remains in a volume and in a mean [1].
_SHAPE_IN_VOLUME, _SHAPE_IN_MEAN = 0.14, 0.42
#: Error of a mean by the width of the cylinders, times the root of the places [1].
_WIDTH = 0.25
#: Error of interpolated changes over the scatter of their neighbors, and their number.
_INTERPOLATED, _NEIGHBORS = 0.75, 6
#: Width of the rim around a region, in radii of the cylinders, and the largest number
#: of rings of one radius that extend it [1].
_RIM, _RINGS = 1.5, 12
#: A ring belongs to a region if its change exceeds this many standard errors [1].
_RING_SCORE = 1.0
#: Largest distance of neighbors in a region, in spacings [1].
_TOGETHER = 3.0


@dataclass(frozen=True, kw_only=True)
class Region:
    """Connected region of significant change."""

    members: NDArray[np.intp]
    """Numbers of its significant points in the comparison."""
    centre: Floats
    """Center of the points, shape (3,) [m]."""
    reach: float
    """Largest distance of a point from the center [m]."""
    area: float
    """Area where the change exceeds the smallest significant one, including
    interpolated changes [m^2]."""
    area_uncertainty: float
    """Standard uncertainty of the area [m^2]."""
    mean: float
    """Area-weighted mean change along the normals [m]."""
    mean_uncertainty: float
    """Standard uncertainty of the mean [m]."""
    largest: float
    """Change of largest magnitude [m]."""
    volume: float
    """Volume added minus volume removed, including the rim around the points and the
    interpolated change where nothing could be compared [m^3]."""
    volume_uncertainty: float
    """Standard uncertainty of the volume [m^3]."""
    lost: float
    """Area within the region and its rim that could not be compared [m^2]."""


def regions(change: Change) -> tuple[Region, ...]:
    """Return the regions of significant change, largest area first."""
    groups = [group for group in _groups(change) if len(group) >= _FEWEST_POINTS]
    places = [
        region_of(
            change,
            members,
            others=np.concatenate(
                [np.empty(0, dtype=np.intp), *groups[:number], *groups[number + 1 :]]
            ),
        )
        for number, members in enumerate(groups)
    ]
    return tuple(sorted(places, key=lambda region: -region.area))


def _groups(change: Change) -> list[NDArray[np.intp]]:
    """Return the connected groups of places with significant change."""
    at = np.flatnonzero(change.significant)
    if not len(at):
        return []
    tree = cKDTree(change.position[at])
    links = tree.query_pairs(_TOGETHER * change.spacing, output_type="ndarray")
    ones = np.ones(len(links))
    graph = coo_matrix((ones, (links[:, 0], links[:, 1])), shape=(len(at), len(at)))
    count, label = connected_components(graph, directed=False)
    return [at[label == number] for number in range(count)]


def region_of(
    change: Change,
    members: NDArray[np.intp],
    *,
    others: NDArray[np.intp] | None = None,
) -> Region:
    """Return area, mean change and volume of a group of comparison points.

    At the rim of a region single changes are below their errors, but their sum is not.
    The volume is therefore summed over a rim of at least one and a half cylinder radii,
    up to where the mean change is not significant, or to the middle between the points
    and those of other regions. On steep flanks a large change may be below its error.
    The area therefore contains each place whose change exceeds the smallest significant
    one.
    """
    members = members[np.isfinite(change.value[members])]
    place, area = change.position[members], change.area[members]
    value = change.value[members]
    total = float(area.sum())
    centre = (area[:, None] * place).sum(axis=0) / total
    around, beyond = _extent(change, members, others)
    compared = np.isfinite(change.value[around])
    at_lost, scatter = _interpolated(change, around[~compared])
    area_lost = change.area[around[~compared]]
    lost = float(area_lost.sum())
    volume, spread, shape = _sum_of(change, around[compared])
    more, unsure = float(area_lost @ at_lost), float(area_lost @ scatter)
    changed = change.value[around].copy()
    changed[~compared] = at_lost
    if np.ptp(np.sign(value)) == 0:
        changed = np.maximum(changed * np.sign(value[0]), 0.0)
    beside = around[np.abs(changed) > np.abs(value).min()]
    whole = float(change.area[np.union1d(members, beside)].sum())
    mean, error, bent = _sum_of(change, members)
    wide = _WIDTH * mean / np.sqrt(len(members))
    return Region(
        members=members,
        centre=centre,
        reach=float(np.linalg.norm(place - centre, axis=1).max()),
        area=whole,
        area_uncertainty=float(
            np.hypot(_AREA * change.spacing * np.sqrt(whole), _AREA_LOST * lost)
        ),
        mean=mean / total,
        mean_uncertainty=float(
            np.linalg.norm([error, _SHAPE_IN_MEAN * bent, wide]) / total
        ),
        largest=float(value[np.argmax(np.abs(value))]),
        volume=volume + more,
        volume_uncertainty=float(
            np.linalg.norm([spread, _SHAPE_IN_VOLUME * shape, unsure, beyond])
        ),
        lost=lost,
    )


def _extent(
    change: Change, members: NDArray[np.intp], others: NDArray[np.intp] | None
) -> tuple[NDArray[np.intp], float]:
    """Return the places of a region with its rim, and the uncertainty beyond [m^3].

    The rim ends with the first ring whose mean change is not significant, or opposite
    to that of the region, as at the former place of a moved object.
    """
    signs = set(np.sign(change.value[members]))
    rim, step = _RIM * change.radius, max(change.radius, change.spacing)
    limit, beyond = rim + _RINGS * step, 0.0
    away, nearest = cKDTree(change.position[members]).query(
        change.position, distance_upper_bound=limit
    )
    if others is not None and len(others):
        apart = cKDTree(change.position[others]).query(change.position)[0]
        away = np.where(away <= apart, away, np.inf)
    near = np.flatnonzero(np.isfinite(away))
    alike = np.einsum(
        "ij,ij->i", change.normal[near], change.normal[members[nearest[near]]]
    )
    near = near[alike > _ALIKE]
    while rim < limit:
        ring = near[(away[near] > rim) & (away[near] <= rim + step)]
        volume, beyond, _ = _sum_of(change, ring[np.isfinite(change.value[ring])])
        significant = abs(volume) > _RING_SCORE * beyond
        if significant and signs == {-np.sign(volume)}:
            # The rim may contain as much of the opposite change.
            beyond = math.hypot(beyond, volume)
            break
        rim += step
        if not significant:
            break
    return near[away[near] <= rim], beyond


def _sum_of(change: Change, members: NDArray[np.intp]) -> tuple[float, float, float]:
    """Return volume change, its uncertainty, and the sum of errors by shape [m^3].

    The third value is the sum of the errors by shape, which the second has not.
    """
    place, area = change.position[members], change.area[members]
    own, shape = change.own[members], change.shape[members]
    # Cylinders closer than their width contain common points.
    near = cKDTree(place).query_pairs(2 * change.radius, output_type="ndarray")
    noise = area * np.sqrt(np.maximum(own**2 - shape**2, 0.0))
    variance = float((noise**2).sum())
    if len(near):
        apart = np.linalg.norm(place[near[:, 0]] - place[near[:, 1]], axis=1)
        common = np.interp(
            apart / change.radius, np.linspace(0, 2, len(_CORRELATION)), _CORRELATION
        )
        variance += float(2 * (noise[near[:, 0]] * noise[near[:, 1]] * common).sum())
    shared = (area[:, None] * change.shared[members]).sum(axis=0)
    sigma = float(np.sqrt(max(variance, 0.0) + (shared**2).sum()))
    total = float((area * change.value[members]).sum())
    return total, sigma, float((area * shape).sum())


def _interpolated(change: Change, lost: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return interpolated changes of places not compared, and their errors [m]."""
    compared = np.flatnonzero(np.isfinite(change.value))
    count = min(_NEIGHBORS, len(compared))
    away, near = cKDTree(change.position[compared]).query(
        change.position[lost], k=[*range(1, count + 1)]
    )
    weight = 1 / np.maximum(away, 1e-9) ** 2
    values = change.value[compared][near]
    mean = (weight * values).sum(axis=1) / weight.sum(axis=1)
    return np.asarray(mean), _INTERPOLATED * np.asarray(values.std(axis=1))


def write_change(change: Change, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a comparison of visits as CSV, one row per comparison point."""
    compared = np.isfinite(change.value)
    columns = [
        *(change.position[compared].T),
        *(change.normal[compared].T),
        change.value[compared],
        change.uncertainty[compared],
        change.own[compared],
        change.chance[compared],
        change.significant[compared],
        change.area[compared],
    ]
    head = (
        "x_m,y_m,z_m,normal_x,normal_y,normal_z,change_m,standard_uncertainty_m,"
        "own_part_m,chance,significant,area_m2"
    )
    rows = [
        ",".join(
            [
                # To the micrometer, at any distance from the origin of the frame.
                *(f"{v:.6f}" for v in row[:3]),
                *(f"{v:.6g}" for v in row[3:-2]),
                f"{row[-2]:.0f}",
                f"{row[-1]:.6g}",
            ]
        )
        for row in np.stack([np.asarray(c, dtype=float) for c in columns], axis=1)
    ]
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text("\n".join([head, *rows]) + "\n")
