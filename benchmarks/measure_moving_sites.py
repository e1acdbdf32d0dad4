"""Errors of sites of lines and a tripod scan, appended to a table.

Usage: python benchmarks/measure_moving_sites.py FILE [FIRST LAST]. Scenes, motion and
errors come from tests/oracles, which shares no code with the product. Each run has
other errors; scene and water go round. Rows that FILE has are not computed again.
Without FIRST and LAST, coverage and errors of the rows in FILE are printed.
"""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from amulor import cube as cubes
from amulor import imaging, io
from amulor.io.trajectories import write_trajectory
from amulor.platform.mounting import mounting_text
from amulor.site import Site
from amulor.site.merging.cloud import by_unknowns, merge, unknowns_of
from amulor.site.registration.line import rows_of_scan
from amulor.site.registration.register import register, surfaces_of
from amulor.survey.platform import Mounting

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))
import moving_pass
import moving_scenes
import patch_lines
from measure_patch_tests import track_of

#: Stated mounting, and standard deviations of its errors [m, rad, s].
ARM, ANGLES, OFFSET = (0.1, 0.25, 0.8), (0.02, -1.52, 0.01), 0.05
SPREAD = np.array([*[0.003] * 3, *[np.radians(0.1)] * 3, 0.003, 0.0])
#: Errors of the navigation: constant [m], walks [m, rad per root second].
ERRORS = {"shift": 0.01, "position_walk": 1e-3, "attitude_walk": 1e-4}
#: Position of the middle of each line [m], heading [deg] and speed [m/s].
LINES = (
    ((0.0, 0.0, -9.2), 0.0, 0.2),
    ((0.3, 0.1, -9.2), 180.0, 0.3),
    ((0.1, -0.1, -9.0), 90.0, 0.1),
)
ROCKING = np.radians([0.5, 0.5, 1.0])
#: Tripod: place [m], heading [rad], and errors of its start pose [m, rad].
TRIPOD, TURN, SURVEYED = (0.2, 0.1, -8.6), 0.4, (1e-3, 5e-4)
SCENES = ("amphora", "wall", "ladder")
#: Standard uncertainty of a range in clear and in turbid water [m].
WATERS = {"clear": 0.5e-3, "turbid": 2e-3}
COLUMNS = (
    "seed", "scene", "water", "good", "settled", "before", "line", "tripod", "single",
    "points1", "points2", "worst", "distances1", "distances2", "worst_distance",
    "latency", "latency_sigma", "boresight", "boresight_sigma", "pose",
)  # fmt: skip
#: Rows and columns of a line: points 7 mm apart along the track, 18 mm across.
ROWS, COLUMNS_OF_LINE = 240, 72
#: Number of points of a run, and of pairs of points, that are compared.
_POINTS, _PAIRS = 400, 400


def image_of(
    ranges: np.ndarray,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    *,
    noise: float,
    time: np.ndarray | None = None,
) -> xr.Dataset:
    """Range image of a line or of a fixed instrument, with flags."""
    shape = ranges.shape
    there = np.isfinite(ranges)
    coordinates = {"azimuth": azimuth, "elevation": elevation}
    if time is not None:
        coordinates |= {
            "time": time,
            "reading_time": time[None],
            "reading_duration": np.zeros((1, *shape)),
            "reading_weight": np.ones(1),
        }
    image = cubes.build(
        "range_image",
        {
            "slant_range": ranges,
            "slant_range_uncertainty": np.where(there, noise, np.nan),
            "slant_range_common_uncertainty": np.where(there, 0.0, np.nan),
            "intensity": np.where(there, 0.01, np.nan),
            "quality_flag": np.where(there, 0, 4).astype(np.int16),
        },
        coordinates,
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "range_image",
            title="line",
            source="simulated",
            modulation_frequencies=np.array([160e6]),
        ),
    )
    return imaging.flag_outliers(imaging.flag_mixed(image))


def make(
    folder: Path,
    seed: int,
    *,
    scene: str = "",
    noise: float = 1e-3,
    lines=LINES,
    rows: int = 120,
    columns: int = 60,
    exact: bool = False,
):
    """Write a site with its scans; return the site and true points by scan."""
    rng = np.random.default_rng([seed, 4242])
    small = 0.0 if exact else 1.0
    error = small * rng.normal(0, SPREAD)
    errors = {name: small * value for name, value in ERRORS.items()}
    trace = patch_lines.distances
    if scene:
        trace = moving_scenes.distances
    bed = getattr(moving_scenes, scene) if scene else patch_lines.rough_bed
    mounting = Mounting(
        lever_arm=ARM, heading=ANGLES[0], pitch=ANGLES[1], roll=ANGLES[2],
        clock_offset=OFFSET, lever_arm_uncertainty=SPREAD[0],
        boresight_uncertainty=SPREAD[3], clock_uncertainty=SPREAD[6],
    )  # fmt: skip
    (folder / "rov.toml").write_text(mounting_text(mounting))
    true, text = {}, ['name = "lines"', "[[epoch]]", 'name = "2026"']
    for number, (middle, heading, speed) in enumerate(lines, 1):
        vehicle = patch_lines.Vehicle(
            rng, middle=middle, heading=np.radians(heading), speed=speed,
            duration=1.6 / speed, wave=0.005, rocking=ROCKING,
        )  # fmt: skip
        line = patch_lines.line_of(
            rng, vehicle, arm=ARM + error[:3], angles=ANGLES, bend=error[3:6],
            offset=OFFSET + error[6], drift=error[7], rows=rows, columns=columns,
            fan=np.radians(40), noise=small * noise, errors=errors, bed=bed,
            trace=trace,
        )  # fmt: skip
        for name in ("slant_range", "azimuth", "time", "point"):
            # Pixels of a row are sorted by angle, in both directions of the beam.
            line[name][1::2] = line[name][1::2, ::-1].copy()
        name = f"line {number}"
        image = image_of(
            line["slant_range"], line["azimuth"], 0 * line["azimuth"],
            noise=noise, time=line["time"],
        )  # fmt: skip
        io.write_cube(image, folder / f"{name}.nc", overwrite=True)
        write_trajectory(track_of(line, errors), folder / f"{name}.csv", overwrite=True)
        true[name] = line["point"]
        text += [
            "[[scan]]", f'name = "{name}"', f'file = "{name}.nc"', 'epoch = "2026"',
            "[scan.trajectory]", f'file = "{name}.csv"', 'mounting = "rov.toml"',
        ]  # fmt: skip
    tripod, stated = _tripod(rng, noise=noise, trace=lambda *ray: trace(*ray, bed))
    io.write_cube(tripod["image"], folder / "tripod.nc", overwrite=True)
    true["tripod"] = tripod["point"]
    text += stated
    (folder / "site.toml").write_text("\n".join(text) + "\n")
    return Site.from_toml(folder / "site.toml"), true


def _tripod(rng: np.random.Generator, *, noise: float, trace):
    """Image and true points of a tripod scan, and its lines of the site file."""
    turn = moving_pass.attitude(TURN, -np.pi / 2, 0.0)
    size = 110
    azimuth, elevation = np.meshgrid(
        np.linspace(-0.3, 0.3, size), np.linspace(0.3, -0.3, size)
    )
    away = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    beams = away.reshape(-1, 3) @ turn.T
    start = np.broadcast_to(np.array(TRIPOD), beams.shape)
    ranges = trace(start, beams)
    point = (start + ranges[:, None] * beams).reshape(size, size, 3)
    ranges = (ranges + rng.normal(0, noise, ranges.shape)).reshape(size, size)
    place = np.array(TRIPOD) + rng.normal(0, SURVEYED[0], 3)
    bent = Rotation.from_rotvec(rng.normal(0, SURVEYED[1], 3)).as_matrix() @ turn
    right, ahead = bent[:, 0], bent[:, 2]
    heading = np.arctan2(ahead[0], ahead[1])
    level = np.array([np.cos(heading), -np.sin(heading), 0.0])
    roll = np.arctan2(np.cross(level, right) @ ahead, right @ level)
    position = ", ".join(f'"{value:.6f} m"' for value in place)
    stated = [
        "[[scan]]", 'name = "tripod"', 'file = "tripod.nc"', 'epoch = "2026"',
        "[scan.start]", f"position = [{position}]",
        f'heading = "{heading:.7f} rad"', f'pitch = "{np.arcsin(ahead[2]):.7f} rad"',
        f'roll = "{roll:.7f} rad"', f'position_uncertainty = "{SURVEYED[0]} m"',
        f'heading_uncertainty = "{SURVEYED[1]} rad"',
        f'level_uncertainty = "{SURVEYED[1]} rad"',
    ]  # fmt: skip
    image = image_of(ranges, azimuth, elevation, noise=noise)
    return {"image": image, "point": point}, stated


def measured(seed: int) -> dict[str, object]:
    """Adjust a site, and return errors of points and distances and their coverage."""
    scene = SCENES[seed % 3]
    water = tuple(WATERS)[seed // 3 % 2]
    with tempfile.TemporaryDirectory() as folder:
        site, true = make(
            Path(folder), seed, scene=scene, noise=WATERS[water], rows=ROWS,
            columns=COLUMNS_OF_LINE,
        )  # fmt: skip
        surfaces, images = surfaces_of(site)
    result = register(site, surfaces=surfaces, images=images)
    cloud = merge(site, result, surfaces, images)
    rng = np.random.default_rng([seed, 4243])
    off = np.full((len(cloud.scan), 3), np.nan)
    before, single, parts, common = [], [], [], []
    for number, scan in enumerate(site.scan):
        surface = surfaces[scan.name]
        mine = np.flatnonzero(cloud.scan == number)
        row, column = np.divmod(cloud.pixel[mine], surface.distance.shape[1])
        row = rows_of_scan(surface.attributes, row)
        point = true[scan.name][row, column]
        off[mine] = cloud.position[mine] - point
        chosen = rng.choice(mine, min(_POINTS, len(mine)), replace=False)
        pose = result.poses[scan.name]
        slope = by_unknowns(surface, pose, cloud.position[chosen], cloud.pixel[chosen])
        names = unknowns_of(scan.name, surface)
        parts.append((scan.name, chosen, slope, names))
        if surface.motion is not None:
            raw = surface.motion.start.place(surface.position).reshape(-1, 3)
            raw = raw[cloud.pixel[mine]] - point
            before.append((raw**2).sum(axis=1).mean())
            single.append((off[mine] ** 2).sum(axis=1).mean())
            spread = result.covariance_of(*names)
            common.append(np.einsum("nij,jk,nik->n", slope, spread, slope).mean())
    chosen = np.concatenate([part[1] for part in parts])
    score = np.abs(off[chosen]) / cloud.sigma[chosen]
    pulls = np.array(list(_distance_pulls(cloud, result, parts, off, rng)))
    tripod = cloud.scan == len(site.scan) - 1
    names = [f"boresight {axis}: instrument, 2026" for axis in ("right", "down")]
    row: dict[str, object] = {
        "seed": seed, "scene": scene, "water": water,
        "good": int(not result.contradictions), "settled": int(result.settled),
        "before": 1e3 * np.sqrt(np.mean(before)),
        "line": 1e3 * np.sqrt(np.mean(single)),
        "tripod": 1e3 * np.sqrt((off[tripod] ** 2).sum(axis=1).mean()),
        "single": 1e3 * WATERS[water],
        "points1": (score < 1).mean(), "points2": (score < 1.96).mean(),
        "worst": score.max(),
        "distances1": (pulls < 1).mean(), "distances2": (pulls < 1.96).mean(),
        "worst_distance": pulls.max(),
    }  # fmt: skip
    truth = np.random.default_rng([seed, 4242]).normal(0, SPREAD)
    for label, key, at in (
        ("latency", "clock offset: instrument, 2026", 6),
        ("boresight", names[1], 4),
    ):
        sigma = np.sqrt(result.covariance_of(f"error {key}")[0, 0])
        # The stated value minus the true one, in stated standard uncertainties.
        row[label] = (result.errors[key] + truth[at] / SPREAD[at]) * SPREAD[at]
        row[f"{label}_sigma"] = sigma * SPREAD[at]
    row["pose"] = 1e3 * np.sqrt(np.mean(common))
    return {
        name: float(f"{value:.6g}") if isinstance(value, float) else value
        for name, value in row.items()
    }


def _distance_pulls(cloud, result, parts, off, rng):
    """Yield errors of distances between points, in stated standard uncertainties."""
    for _ in range(_PAIRS):
        first, second = (parts[k] for k in rng.integers(0, len(parts), 2))
        i, j = rng.integers(0, len(first[1])), rng.integers(0, len(second[1]))
        a, b = first[1][i], second[1][j]
        along = cloud.position[a] - cloud.position[b]
        length = np.linalg.norm(along)
        if not 0.05 < length < 5.0:
            continue
        unit = along / length
        true = np.linalg.norm(along - off[a] + off[b])
        names = tuple(dict.fromkeys((*first[3], *second[3])))
        covariance = result.covariance_of(*names)
        gain, at = {}, 0
        for name in names:
            width = 6 if name.startswith("pose ") else 1
            gain[name] = slice(at, at + width)
            at += width
        slope = np.zeros(at)
        for (_, _, slopes, own), index, sign in ((first, i, 1), (second, j, -1)):
            begin = 0
            for name in own:
                width = 6 if name.startswith("pose ") else 1
                slope[gain[name]] += (
                    sign * unit @ slopes[index][:, begin : begin + width]
                )
                begin += width
        variance = slope @ covariance @ slope
        for point in (a, b):
            variance += (cloud.own[point] * (unit @ cloud.beam[point])) ** 2
        yield abs(length - true) / np.sqrt(variance)


def summary(rows: list[dict[str, str]]) -> None:
    """Print the tables of coverage and errors that stand in docs/benchmarks.md."""
    # Rows of older versions have no stated pose error.
    rows = [row for row in rows if row.get("pose")]
    print("| scene | good sites | trajectory | lines | tripod |", end="")
    print(" points within 1, 1.96 | distances within 1, 1.96 |")
    print(7 * "| --- " + "|")
    for group in (*SCENES, "all"):
        chosen = [row for row in rows if group in ("all", row["scene"])]
        good = [row for row in chosen if row["good"] == "1"]
        if good:
            words = [group, f"{len(good)} of {len(chosen)}"]
            for column in ("before", "line", "tripod"):
                words.append(f"{np.median(_column(good, column)):.2g} mm")
            for kind in ("points", "distances"):
                shares = [100 * _column(good, f"{kind}{k}") for k in (1, 2)]
                errors = [f"{part.std() / len(good) ** 0.5:.1f}" for part in shares]
                words.append(
                    ", ".join(
                        f"{part.mean():.1f} +- {error}"
                        for part, error in zip(shares, errors, strict=True)
                    )
                    + " %"
                )
            print("| " + " | ".join(words) + " |")
    print("\n| scene | lines | tripod | stated pose error |", end="")
    print(" lines over both | below 1.2 tripod scans and the pose error |")
    print(6 * "| --- " + "|")
    for group in (*SCENES, "all"):
        good = [
            row for row in rows if row["good"] == "1" and group in ("all", row["scene"])
        ]
        if not good:
            continue
        line, tripod, pose = (
            _column(good, name) for name in ("line", "tripod", "pose")
        )
        ratio = np.median(line / np.hypot(tripod, pose))
        inside = int((line < 1.2 * tripod + pose).sum())
        print(
            f"| {group} | {np.median(line):.2g} mm | {np.median(tripod):.2g} mm | "
            f"{np.median(pose):.2g} mm | {ratio:.2f} | {inside} of {len(good)} |"
        )
    settled = sum(row["settled"] == "1" for row in rows)
    print(f"\n{settled} of {len(rows)} fits settled.")
    print("\n| quantity | stated (median) | rms error | within 1.96 |", end="")
    print(" its 95 % interval |\n" + 5 * "| --- " + "|")
    good = [row for row in rows if row["good"] == "1"]
    for name, column, scale, unit in (
        ("clock offset", "latency", 1e3, "ms"),
        ("boresight about down", "boresight", np.degrees(1), "degrees"),
    ):
        error, sigma = _column(good, column), _column(good, f"{column}_sigma")
        inside = int((np.abs(error) < 1.96 * sigma).sum())
        share = binomtest(inside, len(good)).proportion_ci()
        print(
            f"| {name} | {scale * np.median(sigma):.2g} {unit} | "
            f"{scale * np.sqrt(np.mean(error**2)):.2g} {unit} | "
            f"{inside} of {len(good)} | {100 * share.low:.0f} to "
            f"{100 * share.high:.0f} % |"
        )


def _column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    """Numbers of a column."""
    return np.array([float(row[name]) for row in rows])


def main(path: Path, *limits: str) -> None:
    """Append the missing rows to a table, or print a summary."""
    present = list(csv.DictReader(path.open())) if path.exists() else []
    if not limits:
        summary(present)
        return
    done = {int(row["seed"]) for row in present}
    with path.open("a") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if not present:
            writer.writeheader()
        for seed in range(*map(int, limits)):
            if seed not in done:
                writer.writerow(measured(seed))
                file.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
