"""Compares drawn visits with a change: python benchmarks/measure_site_changes.py 20

The beds come from `tests/oracles/underwater_sites.py`: bumps, hollows, heaps, bumps
with steep flanks, bumps on slopes, wedges, and stones that moved, by 2 to 50 mm, or no
change. Each is scanned from three places before and after, with wrong start poses, and
is registered, merged and compared. Area, mean change and volume, and six lengths
between points of two scans, are tested by their stated errors. Pairs from 2000 on have
a change of 2 mm, and a stone beside it that moved by 5 to 50 mm. Each pair of visits is
a row of `benchmarks/site_changes.csv`; the options are those of `measure_sites.py`.
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from measure_sites import (
    drawn_sites,
    go_on,
    measuring_options,
    oracle,
    rows_of,
    version,
)

from amulor.errors import AmulorError
from amulor.site.change.distances import change, regions
from amulor.site.merging.cloud import Merged, by_unknowns, merge, unknowns_of
from amulor.site.registration.register import register
from amulor.site.registration.result import Registration

TABLE = Path(__file__).parent / "site_changes.csv"
SIZES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.0)
#: Regions farther from the middle of a change are false [m].
FAR = 0.4
#: First pair with a moved stone beside the change, and distances of the stone [m].
BESIDE, AWAY = 2000, (0.6, 0.75)
#: Half width of a stone [m].
STONE = 0.2
ROWS, COUNT, LENGTHS = 60, 3, 6
COLUMNS = (
    "site", "kind", "size_mm", "outcome", "places", "called", "called_far", "regions",
    "area_cm2", "area_stated", "area_true", "mean_mm", "mean_stated", "mean_true",
    "volume_cm3", "volume_stated", "volume_true", "lost_cm2",
    "lengths_1", "lengths_2", "lengths", "seconds", "version",
)  # fmt: skip


def measured(number: int) -> dict[str, Any]:
    """Row of two visits to one bed."""
    rng = np.random.default_rng([44, number])
    beside = number >= BESIDE
    kinds = oracle.CHANGES[:-1] if beside else oracle.CHANGES
    kind = kinds[number % len(kinds)]
    size = SIZES[0] if beside else SIZES[number // len(oracle.CHANGES) % len(SIZES)]
    before, after = changed = oracle.changed_bed(kind, size, rng)
    if beside:
        angle, toward = rng.uniform(0, 2 * np.pi, 2)
        unit, way = (np.array([np.cos(a), np.sin(a)]) for a in (angle, toward))
        before, after = oracle.with_moved_stone(
            before, after,
            changed[1].swellings[0].middle + rng.uniform(*AWAY) * unit,
            rng.choice(SIZES[1:5]) * way, rng,
        )  # fmt: skip
    site = drawn_sites.two_visits(before, after, rng, rows=ROWS, count=COUNT)
    row: dict[str, Any] = {"site": number, "kind": kind, "size_mm": round(1e3 * size)}
    begin = time.process_time()
    try:
        result = register(site.site, surfaces=site.surfaces, images=site.images)
        cloud = merge(site.site, result, site.surfaces, site.images)
        found = change(site.site, result, site.surfaces, cloud)
    except AmulorError as error:
        return row | {"outcome": f"refused: {str(error).splitlines()[0]}"}
    row["seconds"] = round(time.process_time() - begin, 1)
    row["outcome"] = "contradicted" if result.contradictions else "good"
    middle = np.array((after.swellings or before.swellings)[0].middle)
    away = np.linalg.norm(found.position[:, :2] - middle, axis=1)
    row["places"] = int(np.isfinite(found.value).sum())
    row["called"] = int(found.significant.sum())
    row["called_far"] = int((found.significant & (away > FAR)).sum())
    near = [
        region for region in regions(found)
        if np.linalg.norm(region.centre[:2] - middle) < FAR
    ]  # fmt: skip
    row["regions"] = len(near)
    if size and len(near) == 1:
        (region,) = near
        members = region.members
        true = oracle.along_normals(
            before, after, found.position[members], found.normal[members]
        )
        area = found.area[members]
        limit = np.abs(found.value[members]).min()
        signs = set(np.sign(found.value[members]))
        # A large region contains the stone, too.
        stones = [bed.swellings[-1] for bed in (before, after)] if beside else []
        apart = [np.subtract(found.position[members, :2], stone.middle)
                 for stone in stones]  # fmt: skip
        joined = any(np.linalg.norm(off, axis=1).min() < STONE for off in apart)
        sign = signs.pop() if len(signs) == 1 else 0.0
        scenes = (before, after) if joined else changed
        true_area, true_volume = true_sums(*scenes, limit, sign=sign)
        row |= {
            "area_cm2": round(1e4 * region.area, 1),
            "area_stated": round(1e4 * region.area_uncertainty, 1),
            "area_true": round(1e4 * true_area, 1),
            "mean_mm": round(1e3 * region.mean, 4),
            "mean_stated": round(1e3 * region.mean_uncertainty, 4),
            "mean_true": round(1e3 * float(area @ true / area.sum()), 4),
            "volume_cm3": round(1e6 * region.volume, 2),
            "volume_stated": round(1e6 * region.volume_uncertainty, 2),
            "volume_true": round(1e6 * true_volume, 2),
            "lost_cm2": round(1e4 * region.lost, 1),
        }
    scores = np.abs(length_scores(site, result, cloud, before, after, rng))
    return row | {
        "lengths_1": int((scores < 1).sum()),
        "lengths_2": int((scores < 1.96).sum()),
        "lengths": len(scores),
    }


def true_sums(
    before: Any, after: Any, limit: float, *, sign: float
) -> tuple[float, float]:
    """Area in which a bed changed by more than a limit, and volume of the change.

    If the sign is not 0, a region has only the part of a moved body with this sign.
    """
    step = 0.004
    axis = np.arange(-1.2, 1.2, step) + step / 2
    x, y = np.meshgrid(axis, axis, indexing="ij")
    rise = after.height(x, y) - before.height(x, y)
    if sign:
        rise = np.where(rise * sign > 0, rise, 0.0)
    slopes = np.gradient(before.height(x, y), step)
    surface = step**2 * np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    # Along the normal a change is smaller than upwards, as much as the area is larger.
    changed = np.abs(rise) * step**2 / surface > limit
    return float(surface[changed].sum()), float(step**2 * rise.sum())


def length_scores(
    site: Any, result: Registration, cloud: Merged, before: Any, after: Any, rng: Any
) -> np.ndarray:
    """Errors of lengths between points of two scans, over their stated errors."""
    scenes = {"one": before, "two": after}
    beams = oracle.grid(ROWS, ROWS * 4 // 3)[2].reshape(-1, 3)
    scores = []
    while len(scores) < LENGTHS:
        ends = rng.integers(len(cloud.position), size=2)
        scans = [site.site.scan[cloud.scan[end]] for end in ends]
        if scans[0].name == scans[1].name:
            continue
        between = cloud.position[ends[0]] - cloud.position[ends[1]]
        length = np.linalg.norm(between)
        if length < 0.1:
            continue
        unit, true, names, slopes, noise = between / length, [], [], [], 0.0
        for sign, end, scan in zip((1, -1), ends, scans, strict=True):
            beam = beams[cloud.pixel[end]]
            station = site.stations[scan.name]
            reach = oracle.cast(scenes[scan.epoch], station, beam[None])[0]
            true.append(station.place + reach * (station.matrix @ beam))
            surface, pose = site.surfaces[scan.name], result.poses[scan.name]
            at = np.array([end])
            by = by_unknowns(surface, pose, cloud.position[at], cloud.pixel[at])[0]
            names += unknowns_of(scan.name, surface)
            slopes += list(sign * unit @ by)
            noise += float(unit @ cloud.beam[end] * cloud.own[end]) ** 2
        row, single, width = np.array(slopes), list(dict.fromkeys(names)), 0
        summed = {
            name: np.zeros(6 if name.startswith("pose") else 1) for name in single
        }
        for name in names:
            size = len(summed[name])
            summed[name] = summed[name] + row[width : width + size]
            width += size
        row = np.concatenate([summed[name] for name in single])
        variance = row @ result.covariance_of(*single) @ row + noise
        off = length - np.linalg.norm(true[0] - true[1])
        scores.append(off / np.sqrt(variance))
    return np.array(scores)


def table(rows: list[dict[str, str]]) -> None:
    """Print the summary of all pairs of visits."""
    good = [row for row in rows if row["outcome"] == "good"]
    still = [row for row in good if row["size_mm"] == "0"]
    beside = [row for row in good if int(row["site"]) >= BESIDE]
    changed = [row for row in good if row["size_mm"] != "0" and row not in beside]
    places = sum(int(row["places"]) for row in still)
    far, called = (
        sum(int(row[key]) for row in changed) for key in ("called_far", "called")
    )
    print(
        f"{len(rows)} pairs of visits, {len(good)} good; {len(still)} without change: "
        f"{sum(int(row['called']) for row in still)} of {places} places called; with "
        f"change {far} of {called} called lie far off"
    )
    groups = [(f"{size * 1e3:.0f} mm", [r for r in changed if r["size_mm"] ==
               f"{size * 1e3:.0f}"]) for size in SIZES[:-1]]  # fmt: skip
    groups += [(kind, [r for r in changed if r["kind"] == kind])
               for kind in oracle.CHANGES]  # fmt: skip
    print(
        f"{'':18} pairs, one region; within 1, 1.96 stated errors, chi-square of each"
    )
    groups += [("all", changed), ("2 mm beside stones", beside)]
    for name, some in groups:
        if not some:
            continue
        sizes = [row for row in some if row["volume_cm3"]]
        text = f"{name:18} {len(some):5} {len(sizes):5}"
        for key, unit in (("volume", "cm3"), ("area", "cm2"), ("mean", "mm")):
            score = np.array(
                [
                    (float(row[f"{key}_{unit}"]) - float(row[f"{key}_true"]))
                    / float(row[f"{key}_stated"])
                    for row in sizes
                ]
            )
            score = score if len(score) else np.full(1, np.nan)
            text += (
                f" | {key} {(np.abs(score) < 1).mean():.0%} "
                f"{(np.abs(score) < 1.96).mean():.0%} {(score**2).mean():.2f}"
            )
        print(text)
    inside = [sum(int(row[f"lengths_{k}"]) for row in good) for k in (1, 2)]
    total = sum(int(row["lengths"]) for row in good)
    print(f"lengths: {inside[0] / total:.1%}, {inside[1] / total:.1%} of {total}")


def main() -> None:
    """Measure further pairs of visits, or print the table."""
    options = measuring_options(__doc__).parse_args()
    warnings.simplefilter("ignore")
    present = version("registration", "merging", "change")
    go_on(TABLE, COLUMNS, measured, options, present)
    rows = rows_of(TABLE)
    first = rows[0]["version"]
    for words, is_first in ((f"version {first}", True), ("later versions", False)):
        print(words)
        table([row for row in rows if (row["version"] == first) == is_first])


if __name__ == "__main__":
    main()
