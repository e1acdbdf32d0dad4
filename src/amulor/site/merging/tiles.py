"""Square LAZ tiles of a merged point cloud, with a common coordinate offset."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor._progress import tell
from amulor.cube import DOUBTFUL
from amulor.errors import FormatError, MissingExtraError
from amulor.io.files import atomic_output
from amulor.site.merging.cloud import Merged

#: Step of the coordinates in the files [m].
SCALE = 1e-5
_LARGEST = np.iinfo(np.int32).max
_BRIGHTEST = np.iinfo(np.uint16).max
_EXTRA = (
    ("sigma_x", np.float64, "standard uncertainty of x [m]"),
    ("sigma_y", np.float64, "standard uncertainty of y [m]"),
    ("sigma_z", np.float64, "standard uncertainty of z [m]"),
    ("cov_xy", np.float64, "covariance of x and y [m2]"),
    ("cov_xz", np.float64, "covariance of x and z [m2]"),
    ("cov_yz", np.float64, "covariance of y and z [m2]"),
    ("own_sigma", np.float64, "own part along the beam [m]"),
    ("share", np.float32, "weight among other scans [1]"),
    ("confirmed", np.uint8, "scans that see it, too [1]"),
    ("moving", np.uint8, "1: other scans see through it"),
    ("quality_flag", np.uint16, "amulor flag bits, 0: good [1]"),
)


def write_tiles(
    cloud: Merged,
    folder: str | Path,
    *,
    size: float = 5.0,
    epoch: str | None = None,
    overwrite: bool = False,
    pieces: Iterable[Merged] | None = None,
) -> list[Path]:
    """Write a merged point cloud as square LAZ tiles.

    `pieces` are the points to write, for scans that the cloud contains averaged.

    The format is LAS 1.4, point format 6. Coordinates have steps of 1e-5 m from an
    offset common to all tiles and epochs: that of the site's reference system, or whole
    meters near the middle of the site. Coordinates in the millions thus keep their
    precision, and tiles can be subtracted. `point_source_id` is the number of the scan,
    from 1. Moving and doubtful points have the flag "withheld".
    """
    laspy = _laspy()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    place = cloud.position
    world = np.array(cloud.site.frame.crs_offset)
    offset = world + np.round(place.mean(axis=0)) if not world.any() else world
    brightest = max(float(cloud.intensity.max(initial=0.0)), cloud.brightest) or 1.0
    written: dict[tuple[int, int], Path] = {}
    count: Counter[tuple[int, int]] = Counter()
    with ExitStack() as stack:
        for piece in pieces or [cloud]:
            _check_reach(folder, piece.position + world - offset)
            selected = np.ones(len(piece.position), dtype=bool)
            if epoch is not None:
                selected = piece.of_epoch(epoch)
            cell = np.floor(piece.position[:, :2] / size).astype(int)
            cells = np.unique(cell[selected], axis=0)
            for number, corner in enumerate(cells):
                if pieces is None:
                    tell("writing tiles", number / len(cells))
                at = np.flatnonzero(selected & (cell == corner).all(axis=1))
                points = _tile(laspy, piece, at, offset, world, brightest)
                key = (int(corner[0]), int(corner[1]))
                if key in written:
                    with laspy.open(written[key], mode="a") as file:
                        file.append_points(points.points)
                else:
                    path = folder / _name(key, epoch)
                    written[key] = stack.enter_context(
                        atomic_output(path, overwrite=overwrite)
                    )
                    points.write(written[key])
                count[key] += len(at)
    listed = {
        _name(key, epoch): {
            "points": count[key],
            "west_south_m": [float(v) for v in np.array(key) * size],
            "size_m": size,
        }
        for key in sorted(written)
    }
    names = [folder / name for name in listed]
    about = {
        "site": cloud.site.name,
        "crs": cloud.site.frame.crs,
        "offset_m": offset.tolist(),
        "scans": [scan.name for scan in cloud.site.scan],
        "tiles": listed,
    }
    index = folder / ("tiles.json" if epoch is None else f"tiles_{epoch}.json")
    with atomic_output(index, overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(about, indent=1))
    return names


def _name(corner: tuple[int, int], epoch: str | None) -> str:
    """Return the name of a tile's file."""
    suffix = f"_{epoch}" if epoch is not None else ""
    return f"tile_{corner[0]:+04d}_{corner[1]:+04d}{suffix}.laz"


def _check_reach(folder: Path, away: NDArray[np.float64]) -> None:
    """Raise `FormatError` if a point is too far from the files' coordinate offset."""
    far = np.abs(away).max(initial=0.0)
    if far / SCALE > _LARGEST:
        raise FormatError(
            f"{folder}: a point lies {far:.0f} m off the offset of the site, LAS files "
            f"in steps of {SCALE:g} m hold {_LARGEST * SCALE:.0f} m; set "
            "frame.crs_offset near the site"
        )


def _laspy() -> Any:
    try:
        import laspy
        import lazrs  # noqa: F401  laspy compresses with it
    except ImportError as error:
        raise MissingExtraError(
            "laspy[lazrs]", extra="export", purpose="writing LAZ tiles"
        ) from error
    return laspy


def _tile(
    laspy: Any,
    cloud: Merged,
    at: NDArray[np.intp],
    offset: NDArray[np.float64],
    world: NDArray[np.float64],
    brightest: float,
) -> Any:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.global_encoding.wkt = True  # asked for by this point format, even if unused
    header.system_identifier = "amulor"
    header.scales = np.full(3, SCALE)
    header.offsets = offset
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, kind, about) for name, kind, about in _EXTRA]
    )
    points = laspy.LasData(header)
    steps = np.round((cloud.position[at] + (world - offset)) / SCALE).astype(np.int32)
    for number, axis in enumerate("XYZ"):
        points[axis] = steps[:, number]
    level = cloud.intensity[at] / brightest * _BRIGHTEST
    points["intensity"] = np.round(level).astype(np.uint16)
    points["point_source_id"] = (cloud.scan[at] + 1).astype(np.uint16)
    ones = np.ones(len(at), dtype=np.uint8)
    points["return_number"] = points["number_of_returns"] = ones
    doubtful = (cloud.flag[at].astype(np.int64) & int(DOUBTFUL)) != 0
    points["withheld"] = (doubtful | cloud.moving[at]).astype(np.uint8)
    spread = cloud.covariance[at]
    values = {
        **{f"sigma_{a}": np.sqrt(spread[:, k, k]) for k, a in enumerate("xyz")},
        "cov_xy": spread[:, 0, 1],
        "cov_xz": spread[:, 0, 2],
        "cov_yz": spread[:, 1, 2],
        "own_sigma": cloud.own[at],
        "share": cloud.share[at],
        "confirmed": cloud.confirmed[at],
        "moving": cloud.moving[at],
        "quality_flag": cloud.flag[at],
    }
    for name, kind, _ in _EXTRA:
        points[name] = values[name].astype(kind)
    return points
