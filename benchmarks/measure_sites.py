"""Registers drawn sites and tests each statement: python benchmarks/measure_sites.py 20

Sites come from `tests/oracles/underwater_sites.py`, which shares no code with the
package: beds, walls, bodies, planes and corners; starts wrong by up to 50 cm and 20
degrees, stated as they are or too small; a fish, a scan that nothing explains, a drift
over the rows, a delay, another height datum, and quiet sites. Sites from number 1000 on
have a scan of another place, those from 3000 on a delay or drift near the limit of
detection, and those from 4000 on the same in each scan, as stated. Sites from 5000 on
are the first ones again, with a stated drift of 1 cm in each scan.

Each site is a row of `benchmarks/sites.csv`, with a digest of the code of
`amulor.site.registration` that measured it. A number of further sites is measured, and
the campaign goes on where it ended. `--redo` measures rows of other versions again, in
random order, evenly by kind and error. Without a number the summary of all rows of the
present version, or of other ones (`--of`), is printed. `--page` writes it into
docs/benchmarks.md.

`--first 1000 --until 1100` draws numbers from 1000 to 1099. `--part 3/16` measures the
fourth of 16 parts of the sites, and writes its rows beside the table; `--merge` adds
them to the table.
"""

from __future__ import annotations

import argparse
import ast
import csv
import dataclasses
import hashlib
import itertools
import re
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
for folder in ("oracles", "support"):
    sys.path.insert(0, str(HERE.parent / "tests" / folder))

import drawn_sites  # noqa: E402
import underwater_sites as oracle  # noqa: E402

from amulor.errors import AmulorError  # noqa: E402
from amulor.io.files import atomic_output  # noqa: E402
from amulor.site.registration.pose import start_pose  # noqa: E402
from amulor.site.registration.register import register, surface_of  # noqa: E402

TABLE = HERE / "sites.csv"
PAGE = HERE.parent / "docs/benchmarks.md"
KINDS = ("bed", "wall", "amphorae", "corner", "plane")
#: Rows of pixels; struts need more.
ROWS = {"bed": 42, "wall": 72, "amphorae": 48, "corner": 42, "plane": 42}
#: Standard deviation of start poses, each axis by itself [m, deg].
STARTS = ((0.01, 0.5), (0.05, 3.0), (0.05, 3.0), (0.15, 6.0), (0.3, 10.0), (0.5, 20.0))
#: The stated one over the drawn one; below 1 a statement is wrong [1].
STATED = (1.0, 1.0, 1.0, 0.2)
SPOILERS = ("quiet", "quiet", "quiet", "fish", "outlier", "drift", "delay", "datum")
#: Errors of sites in words.
WORDS = {
    "quiet": "quiet", "fish": "fish", "outlier": "wrong ranges",
    "elsewhere": "another place", "drift": "drift", "delay": "delay", "datum": "datum",
    "near": "near the limit", "stated": "stated delay or drift",
}  # fmt: skip
#: First reasons of contradictions in words; all others are shared errors.
REASONS = {
    "start pose": ("start",),
    "pattern, one amount": ("constant",),
    "pattern, angle of incidence": ("angle",),
    "pattern, rows": ("rows", "rows,_bent"),
    "pattern, columns or range": ("columns", "columns,_bent", "range"),
    "no fitting neighbor": ("surface",),
    "surfaces block beams": ("sight",),
    "points of others absent": ("absent",),
    "another height datum": ("datum",),
}
#: From this number on the scan a3 is one of another place.
ELSEWHERE = 1000
#: From these numbers on a2 has a delay or drift near the limit of detection, and from
#: the second one on all scans have a stated one.
NEAR, STATED_ERRORS = 3000, 4000
#: Sites from this number on are the first ones, with a stated drift of all scans [m].
EXPECTED, EXPECTED_DRIFT = 5000, 0.01
#: Limits of these sizes [m].
SIZES = {"drift": (0.002, 0.02), "delay": (0.003, 0.06)}
#: Parts of the generator's sites without an error or with a fish, and with a delay or
#: drift [1].
PARTS = {"quiet": 0.5, "near": 0.25}
#: Limits of the largest test value of a site [1].
CLASSES = (0.0, 2.0, 3.0, np.inf)
#: A pose is grossly wrong beyond so many standard uncertainties, and beyond so much
#: [1, m, rad].
GROSS = (6.0, 0.02, 0.01)
COLUMNS = (
    "site", "kind", "spoiler", "start_m", "start_deg", "stated", "outcome", "settled",
    "gross", "silent", "beyond", "covered", "poses", "undetected_m",
    "within_1", "within_2", "components", "points_1", "points_2", "points",
    "lengths_1", "lengths_2", "lengths", "largest_m", "gicp_gross", "seconds",
    "off", "tied", "unchecked", "score", "reasons", "named", "version", "words",
)  # fmt: skip


def changed_ranges(error: str, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """Function that adds a delay, or a drift over the rows (from minus to plus)."""

    def changed(distance: np.ndarray) -> np.ndarray:
        if error == "delay":
            return distance + size
        return distance + size * np.linspace(-1, 1, distance.shape[0])[:, None]

    return changed


def state_errors(drawn: Any, error: str, size: float) -> None:
    """State a delay or a drift of each scan by itself in a drawn site."""
    for image in drawn.images.values() if error == "delay" else ():
        for name in ("_delay", ""):
            value = image[f"slant_range_uncertainty{name}"]
            value.values = np.hypot(value.values, size)
        common = image["slant_range_common_uncertainty"]
        common.values = np.hypot(common.values, size)
    scans = []
    for scan in drawn.site.scan:
        changed = {"drift": size} if error == "drift" else {"instrument": scan.name}
        scans.append(scan.model_copy(update=changed))
    drawn.site = drawn.site.model_copy(update={"scan": tuple(scans)})
    drawn.surfaces = {
        scan.name: surface_of(drawn.site, scan, drawn.images[scan.name])
        for scan in scans
    }


def version(*folders: str) -> str:
    """Digest of the code of folders of `amulor.site` without its docstrings.

    The drawn sites have no lines of a vehicle, so the code of lines does not count.
    """
    digest = hashlib.sha256()
    site = HERE.parent / "src/amulor/site"
    for path in sorted(
        path
        for part in folders
        for path in (site / part).rglob("*.py")
        if path.name != "line.py"
    ):
        tree = ast.parse(path.read_text("utf-8"))
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list):
                node.body = [  # type: ignore[attr-defined]
                    line for line in body
                    if not (isinstance(line, ast.Expr)
                            and isinstance(line.value, ast.Constant))
                ]  # fmt: skip
        # From 3.13 on, empty fields have to be asked for; 3.12 has one more of them.
        words = {"show_empty": True} if sys.version_info >= (3, 13) else {}
        text = ast.dump(tree, **words).replace(", type_params=[]", "")
        digest.update(text.encode())
    return digest.hexdigest()[:8]


def drawn(number: int) -> tuple[Any, dict[str, Any]]:
    """Function that scans the site of a number, and its draw in words."""
    settings: dict[str, Any] = {}
    if number >= EXPECTED:
        number -= EXPECTED
        settings = {"registration": {"drift": EXPECTED_DRIFT}}
    rng = np.random.default_rng([40, number])
    kind = KINDS[number % len(KINDS)]
    rows = ROWS[kind]
    spoiler = SPOILERS[rng.integers(len(SPOILERS))]
    if number >= ELSEWHERE:
        spoiler = "elsewhere"
    if number >= NEAR:
        spoiler = "near" if number < STATED_ERRORS else "stated"
    position, degrees = STARTS[rng.integers(len(STARTS))]
    stated = STATED[rng.integers(len(STATED))] if number < NEAR else 1.0
    angle = np.radians(degrees)
    if kind == "wall":
        scene, places = oracle.wall(rng), oracle.wall_stations(4, rng)
    elif kind == "corner":
        scene, places = oracle.corner(rng), oracle.corner_stations(4, rng)
    else:
        scene = {
            "bed": oracle.bed,
            "amphorae": oracle.amphorae,
            "plane": lambda _: oracle.Bed(),
        }[kind](rng)
        places = oracle.ring(4, rng)
    stations = {f"a{k + 1}": place for k, place in enumerate(places)}
    statement = (stated * position, stated * angle)
    starts = {
        name: oracle.start_of(
            place, rng, position=position, angle=angle, stated=statement
        )
        for name, place in stations.items()
    }
    starts["a1"] = oracle.start_of(
        stations["a1"], rng,
        position=drawn_sites.SURVEYED[0], angle=drawn_sites.SURVEYED[1],
    )  # fmt: skip
    for name, start in starts.items():
        # No start pose states a pitch beyond upright.
        pitch = float(np.clip(start.station.pitch, -1.55, 1.55))
        station = dataclasses.replace(start.station, pitch=pitch)
        starts[name] = dataclasses.replace(start, station=station)
    spoiled: dict[str, Any] = {}
    error, size = "", 0.0
    if number >= NEAR:
        error = ("drift", "delay")[rng.integers(2)]
        size = float(np.exp(rng.uniform(*np.log(SIZES[error]))))
    if spoiler == "near":
        spoiled["a2"] = changed_ranges(error, size)
    elif spoiler == "stated":
        for name in stations:
            spoiled[name] = changed_ranges(error, size * float(rng.normal()))
    elif spoiler == "fish":
        row, column = rng.integers(8, rows - 12), rng.integers(8, rows * 4 // 3 - 12)

        def fish(distance: np.ndarray) -> np.ndarray:
            nearer = distance.copy()
            nearer[row : row + 5, column : column + 8] -= 0.6
            return nearer

        spoiled["a2"] = fish
    elif spoiler == "outlier":
        spoiled["a3"] = lambda distance: 1.05 * distance + 0.1
    elif spoiler == "elsewhere":
        other = {
            "wall": oracle.wall, "corner": oracle.corner, "amphorae": oracle.amphorae,
        }.get(kind, oracle.bed)(rng)  # fmt: skip

        def elsewhere(distance: np.ndarray) -> np.ndarray:
            beams = oracle.grid(*distance.shape)[2]
            away = oracle.cast(other, stations["a3"], beams)
            return away + oracle.Noise().own * rng.normal(size=distance.shape)

        spoiled["a3"] = elsewhere
    elif spoiler == "drift":
        size = float(rng.choice([0.005, 0.01, 0.03]))
        spoiled["a2"] = changed_ranges(spoiler, size)
    elif spoiler == "delay":
        size = float(rng.choice([0.02, 0.05]))
        spoiled["a2"] = changed_ranges(spoiler, size)
    elif spoiler == "datum":
        for name in ("a3", "a4"):
            east, north, up = starts[name].station.place
            other = dataclasses.replace(
                starts[name].station, place=(east, north, up + 6.2)
            )
            starts[name] = dataclasses.replace(starts[name], station=other)
    if settings:
        number += EXPECTED
    words = {
        "site": number, "kind": kind, "spoiler": spoiler, "start_m": position,
        "start_deg": degrees, "stated": stated,
    }  # fmt: skip

    def scanned() -> Any:
        site = drawn_sites.drawn_site(
            {"one": scene}, {"one": stations}, starts, rng, rows=rows,
            spoiled=spoiled, **settings,
        )  # fmt: skip
        if spoiler == "stated":
            state_errors(site, error, size)
        return site

    return scanned, words


def measured(number: int) -> dict[str, Any]:
    """Row of one site."""
    scanned, row = drawn(number)
    begin = time.process_time()
    try:
        site = scanned()
        begin = time.process_time()
        result = register(site.site, surfaces=site.surfaces, images=site.images)
    except AmulorError as error:
        row |= {"outcome": "refused", "words": str(error).splitlines()[0]}
        return row | {"seconds": round(time.process_time() - begin, 1)}
    row["seconds"] = round(time.process_time() - begin, 1)
    row["outcome"] = "contradicted" if result.contradictions else "good"
    warned = result.weaknesses or result.remarks or result.unchecked
    if not result.contradictions and warned:
        row["outcome"] = "good, warned"
    if not result.contradictions and result.disagreements:
        row["outcome"] = "good, pair contradicts"
    row["settled"] = int(result.settled)
    row["words"] = "; ".join(one.sentence for one in result.contradictions[:1])
    row["reasons"] = " ".join(
        (one.error or "start").replace(" ", "_") for one in result.contradictions
    )
    row["score"] = round(max((abs(t.score) for t in result.patterns), default=0.0), 2)
    row["named"] = " ".join(
        dict.fromkeys(
            name
            for one in result.contradictions
            for name in (one.scan, *one.peers)
            if name
        )
    )
    scores, lengths, points, gross, largest = [], [], [], [], 0.0
    covered = []
    # Unchecked scans are neither merged nor compared.
    unchecked = {item.scan for item in result.unchecked}
    row["unchecked"] = " ".join(sorted(unchecked))
    names = [name for name in result.poses if name not in {"a1", *unchecked}]
    for name in names:
        true, pose = site.stations[name], result.poses[name]
        off = np.concatenate(
            [pose.position - true.place, rotation_vector(pose.rotation @ true.matrix.T)]
        )
        spread = result.covariance_of(f"pose {name}")
        sigma = np.sqrt(np.diag(spread))
        scores += list(off / sigma)
        largest = max(largest, float(np.linalg.norm(off[:3])))
        whitened = off @ np.linalg.solve(spread, off)
        if whitened > 6 * GROSS[0] ** 2 and (
            np.linalg.norm(off[:3]) > GROSS[1] or np.linalg.norm(off[3:]) > GROSS[2]
        ):
            gross.append(name)
        hidden = result.undetected.get(name)
        beside = (hidden.shift, hidden.turn) if hidden else (0.0, 0.0)
        if all(
            np.linalg.norm(off[at]) <= extra + 1.96 * np.linalg.norm(sigma[at])
            for extra, at in zip(beside, (slice(3), slice(3, 6)), strict=True)
        ):
            covered.append(name)
        # Some points at the true ranges, placed by the pose alone.
        cloud = oracle.grid(5, 7)[2].reshape(-1, 3) * 2.5
        for point in cloud[::6]:
            arm = pose.rotation @ point
            turn = np.array(
                [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
            )
            rows_of = np.hstack([np.eye(3), turn])
            shift = pose.place(point) - (true.matrix @ point + true.place)
            points += list(shift / np.sqrt(np.diag(rows_of @ spread @ rows_of.T)))
    for one, other in itertools.pairwise(names):
        both = result.covariance_of(f"pose {one}", f"pose {other}")
        between = result.poses[one].position - result.poses[other].position
        unit = between / np.linalg.norm(between)
        line = np.concatenate([unit, np.zeros(3), -unit, np.zeros(3)])
        true = np.subtract(site.stations[one].place, site.stations[other].place)
        off = np.linalg.norm(between) - np.linalg.norm(true)
        lengths.append(off / np.sqrt(line @ both @ line))
    for name, values in (
        ("within", scores), ("points", points), ("lengths", lengths),
    ):  # fmt: skip
        inside = np.abs(values)
        row[f"{name}_1"] = int((inside < 1).sum())
        row[f"{name}_2"] = int((inside < 1.96).sum())
        row["components" if name == "within" else name] = len(values)
    warnings_text = " ".join(
        [*result.remarks, *(weak.scan for weak in result.weaknesses)]
    )
    silent = [name for name in gross if name not in warnings_text]
    row |= {"gross": len(gross), "silent": len(silent), "largest_m": round(largest, 4)}
    row |= {"beyond": sum(name not in covered for name in silent)}
    row |= {"covered": len(covered), "poses": len(names)}
    row["off"] = " ".join(gross)
    pairs = {pair[end] for pair in result.pairs for end in ("source", "target")}
    row["tied"] = " ".join(sorted(pairs))
    row["undetected_m"] = round(
        max((result.undetected[name].shift for name in names
             if name in result.undetected), default=0.0), 4,
    )  # fmt: skip
    row["gicp_gross"] = gicp(site)
    return row


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Turn of a rotation [rad]."""
    angle = oracle.angle_between(np.eye(3), matrix)
    axis = np.array(
        [
            matrix[2, 1] - matrix[1, 2],
            matrix[0, 2] - matrix[2, 0],
            matrix[1, 0] - matrix[0, 1],
        ]
    )
    size = np.linalg.norm(axis)
    return axis * (angle / size) if size > 0 else axis


def gicp(site: Any) -> int:
    """Scans that small_gicp with its defaults leaves more than 2 cm or 10 mrad off."""
    import small_gicp

    clouds, gross = {}, 0
    for scan in site.site.scan:
        surface = site.surfaces[scan.name]
        pose = start_pose(scan.start)
        clouds[scan.name] = (surface.position[surface.usable], pose)
    cloud, pose = clouds["a1"]
    merged = pose.place(cloud)
    for name, (cloud, pose) in clouds.items():
        if name == "a1":
            continue
        found = small_gicp.align(merged, cloud, init_T_target_source=pose.matrix)
        matrix, true = np.asarray(found.T_target_source), site.stations[name]
        away = np.linalg.norm(matrix[:3, 3] - true.place)
        turn = oracle.angle_between(matrix[:3, :3], true.matrix)
        gross += bool(away > GROSS[1] or turn > GROSS[2])
        merged = np.concatenate([merged, cloud @ matrix[:3, :3].T + matrix[:3, 3]])
    return gross


def shares(rows: list[dict[str, str]], key: str) -> str:
    """Shares of errors within 1 and 1.96 stated uncertainties, as two cells."""
    total = sum(int(row["components" if key == "within" else key]) for row in rows)
    inside = [sum(int(row[f"{key}_{limit}"]) for row in rows) for limit in (1, 2)]
    return " | ".join(
        f"{100 * count / total:.1f} %" if total else "" for count in inside
    )


def good_of(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    """Rows of sites rated good."""
    return [row for row in rows if row["outcome"].startswith("good")]


def table(rows: list[dict[str, str]]) -> str:
    """Summary of sites by error and by kind (Markdown)."""
    lines = [
        "| sites | number | good | contradicted | refused | not settled | gross "
        "| silent | within 1 error | within 1.96 errors | small_gicp wrong |",
        "| --- " * 11 + "|",
    ]
    of_error = {
        words: [row for row in rows if row["spoiler"] == name]
        for name, words in WORDS.items()
    }
    further = {words: of_error.pop(words) for words in (WORDS["near"], WORDS["stated"])}
    drawn = [row for row in rows if int(row["site"]) < NEAR]
    of_kind = {kind: [row for row in drawn if row["kind"] == kind] for kind in KINDS}
    for words, some in {**of_error, **of_kind, "all": drawn, **further}.items():
        if not some:
            continue
        good = good_of(some)
        counts = [
            len(some),
            len(good),
            *(sum(row["outcome"] == outcome for row in some)
              for outcome in ("contradicted", "refused")),
            sum(row["settled"] == "0" for row in some),
            *(sum(int(row[key]) > 0 for row in good) for key in ("gross", "silent")),
        ]  # fmt: skip
        peer = [int(row["gicp_gross"]) > 0 for row in some if row["gicp_gross"]]
        lines.append(
            f"| {words} | {' | '.join(f'{count:,}' for count in counts)} | "
            f"{shares(good, 'within')} | {sum(peer)} of {len(peer)} |"
        )
    return "\n".join(lines)


def quantities(rows: list[dict[str, str]]) -> str:
    """Shares of errors of each quantity in quiet sites rated good (Markdown)."""
    good = [row for row in good_of(rows) if row["spoiler"] == "quiet"]
    lines = ["| quantity | number | within 1 error | within 1.96 errors |"]
    lines.append("| --- " * 4 + "|")
    for key, words in (
        ("within", "pose components"), ("points", "coordinates of points"),
        ("lengths", "lengths between instruments"),
    ):  # fmt: skip
        total = sum(int(row["components" if key == "within" else key]) for row in good)
        lines.append(f"| {words} | {total:,} | {shares(good, key)} |")
    honest = [
        row
        for row in rows
        if row["spoiler"] in ("quiet", "fish") and float(row["stated"]) == 1
    ]
    lines.append(
        f"\n{len(good_of(honest))} of {len(honest)} quiet sites and sites with a fish, "
        "with right uncertainties of the start poses, are rated good."
    )
    return "\n".join(lines)


def classes(rows: list[dict[str, str]]) -> str:
    """Shares of pose components by the largest test value of a site (Markdown).

    Sites without an error and sites near the limit count as often as the generator
    draws sites without an error, and with a delay or drift.
    """
    honest = [row for row in rows if row.get("score") and float(row["stated"]) == 1]
    groups = {
        "quiet": [row for row in honest if row["spoiler"] in ("quiet", "fish")],
        "near": [row for row in honest if row["spoiler"] == "near"],
    }
    counted = [
        (
            PARTS[name] / len(some),
            float(row["score"]),
            *(int(row[key]) for key in ("components", "within_1", "within_2")),
            name,
        )
        for name, some in groups.items()
        for row in good_of(some)
        if int(row["components"])
    ]
    lines = [
        "| largest test value | sites without an error | sites near the limit "
        "| within 1 error | within 1.96 errors |",
        "| --- " * 5 + "|",
    ]
    names = ["below 2", "2 to 3", "above 3"]
    limits = [*itertools.pairwise(CLASSES), (0.0, np.inf)]
    for words, (low, high) in zip([*names, "all"], limits, strict=True):
        some = [row for row in counted if low <= row[1] < high]
        cells = ["", ""]
        if some:
            values = np.array([row[:5] for row in some])
            drawn = np.random.default_rng(0).integers(len(some), size=(400, len(some)))
            for at in (0, 1):
                total, inside = (values[:, 0] * values[:, k] for k in (2, 3 + at))
                spread = inside[drawn].sum(axis=1) / total[drawn].sum(axis=1)
                share = inside.sum() / total.sum()
                cells[at] = f"{100 * share:.1f} +- {100 * spread.std():.1f} %"
        counts = [sum(row[5] == name for row in some) for name in groups]
        lines.append(
            f"| {words} | {' | '.join(map(str, counts))} | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def expected_drifts(rows: list[dict[str, str]]) -> str:
    """Shares and errors of sites with and without a stated drift of all scans."""
    by_number = {int(row["site"]): row for row in rows}
    again = [row for number, row in by_number.items() if number >= EXPECTED]
    lines = [
        "| sites | stated drift | number | rated good | pose components within 1, 1.96 "
        "errors | coordinates of points | largest error of a position, median |",
        "| --- " * 7 + "|",
    ]
    for words, error, good in (
        ("drift, not detected", "drift", True),
        ("drift, detected", "drift", False),
        ("quiet", "quiet", True),
    ):
        some = [
            row for row in again if row["spoiler"] == error
            and good == bool(good_of([by_number[int(row["site"]) - EXPECTED]]))
        ]  # fmt: skip
        before = [by_number[int(row["site"]) - EXPECTED] for row in some]
        for stated, group in (("none", before), ("1 cm", some)):
            largest = [float(row["largest_m"]) for row in group if int(row["poses"])]
            cells = [
                shares(good_of(group), key).replace(" |", ",").strip(", ")
                for key in ("within", "points")
            ]
            lines.append(
                f"| {words} | {stated} | {len(group)} | {len(good_of(group))} | "
                f"{' | '.join(cells)} | {1e3 * np.median(largest):.1f} mm |"
            )
    return "\n".join(lines)


def reasons(rows: list[dict[str, str]]) -> str:
    """Numbers of contradicted sites by first reason and error (Markdown)."""
    firsts = [
        (row["spoiler"], reason_of(row))
        for row in rows
        if row["outcome"] == "contradicted"
    ]
    errors = [name for name in WORDS if any(row["spoiler"] == name for row in rows)]
    lines = [f"| first reason | {' | '.join(WORDS[name] for name in errors)} |"]
    lines.append("| --- " * (len(errors) + 1) + "|")
    for words in (*REASONS, "shared error"):
        cells = [firsts.count((error, words)) for error in errors]
        if any(cells):
            lines.append(f"| {words} | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def reason_of(row: dict[str, str]) -> str:
    """First reason of a contradicted site in words."""
    first = row["reasons"].split()[0]
    return next(
        (words for words, names in REASONS.items() if first in names), "shared error"
    )


def honest_contradicted(rows: list[dict[str, str]]) -> str:
    """Contradicted sites with right statements and without an error (Markdown).

    A contradiction is right if a scan was registered at a wrong place.
    """
    lines = [
        "| site | kind | error | start | first reason | largest error of a position |",
        "| --: | --- | --- | --- | --- | --: |",
    ]
    for row in rows:
        honest = row["spoiler"] in ("quiet", "fish", "stated")
        if honest and row["outcome"] == "contradicted" and float(row["stated"]) == 1:
            start = f"{float(row['start_m']):g} m, {float(row['start_deg']):g} deg"
            cells = [row["site"], row["kind"], WORDS[row["spoiler"]], start]
            error = f"{1e3 * float(row['largest_m']):.0f} mm"
            lines.append(f"| {' | '.join(cells)} | {reason_of(row)} | {error} |")
    return "\n".join(lines)


def counted_of(rows: list[dict[str, str]], shown: list[str]) -> list[dict[str, str]]:
    """Rows of some versions, without those of sites with expected drifts."""
    return [
        row for row in rows if row["version"] in shown and int(row["site"]) < EXPECTED
    ]


def write_page(every: list[dict[str, str]], shown: list[str]) -> None:
    """Replace the tables of the page of benchmarks."""
    text = PAGE.read_text("utf-8")
    total = sum(int(row["site"]) < EXPECTED for row in every)
    rows = counted_of(every, shown)
    counts = [
        f"{sum(row['version'] == one for row in rows):,} of version `{one}`"
        for one in shown
    ]
    count = f"Of the {total:,} rows, {' and '.join(counts)} are counted."
    for name, content in {
        "random sites": f"{count}\n\n{table(rows)}",
        "quantities of random sites": quantities(rows),
        "reasons of random sites": reasons(rows),
        "honest sites contradicted": honest_contradicted(rows),
        "expected drifts": expected_drifts(every),
    }.items():
        marks = rf"(<!-- {name} -->\n).*?(<!-- end of {name} -->\n)"
        text, found = re.subn(
            marks,
            lambda at, new=content: f"{at[1]}{new}\n{at[2]}",
            text,
            flags=re.DOTALL,
        )
        if found != 1:
            raise SystemExit(f"{PAGE} has {found} places for {name}, not 1")
    PAGE.write_text(text, "utf-8")


def main() -> None:
    """Measure further sites, or print the table."""
    parser = measuring_options(__doc__)
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--of", metavar="VERSION", nargs="*")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    present = version("registration")
    go_on(TABLE, COLUMNS, measured, options, present)
    rows = rows_of(TABLE)
    shown = options.of or [present]
    if options.page:
        write_page(rows, shown)
    some = counted_of(rows, shown)
    texts = (table, quantities, classes, reasons, honest_contradicted)
    print(*(text(some) for text in texts), expected_drifts(rows), sep="\n\n")


def measuring_options(about: str | None) -> argparse.ArgumentParser:
    """Options of the campaigns of drawn sites and of drawn changes."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("count", type=int, nargs="?", default=0)
    parser.add_argument("--redo", action="store_true")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--until", type=int, default=10**6)
    parser.add_argument("--seconds", type=float, default=1150.0)
    parser.add_argument("--part", metavar="K/N")
    parser.add_argument("--merge", action="store_true")
    return parser


def go_on(
    path: Path,
    columns: tuple[str, ...],
    measure: Callable[[int], dict[str, Any]],
    options: argparse.Namespace,
    present: str,
) -> None:
    """Add rows to a table, or measure rows of other versions again."""
    rows: dict[int, Any] = {int(row["site"]): row for row in rows_of(path)}
    output, written = path, rows
    part, parts = 0, 1
    if options.part:
        part, parts = map(int, options.part.split("/"))
        output = path.with_name(f"{path.stem}_part{part}.csv")
        written = {int(row["site"]): row for row in rows_of(output)}
        rows |= written
    if options.merge:
        merge_parts(path, columns, rows)
    if options.redo:
        others = [n for n in rows if rows[n].get("version") != present]
        numbers = iter(evenly({n: rows[n] for n in others}))
    else:
        numbers = (n for n in range(options.first, options.until) if n not in rows)
    begin = time.monotonic()
    mine = (number for number in numbers if number % parts == part)
    for number in itertools.islice(mine, options.count):
        if time.monotonic() - begin > options.seconds:
            break
        rows[number] = written[number] = measure(number) | {"version": present}
        with atomic_output(output, overwrite=True) as temporary:
            _write(temporary, columns, written)
    total = sum(row.get("version") == present for row in rows.values())
    print(f"{path.name}: {total} of {len(rows)} rows are of this version ({present})")


def merge_parts(path: Path, columns: tuple[str, ...], rows: dict[int, Any]) -> None:
    """Move the rows of all parts of a campaign into the table."""
    parts = sorted(path.parent.glob(f"{path.stem}_part*.csv"))
    rows |= {int(row["site"]): row for part in parts for row in rows_of(part)}
    with atomic_output(path, overwrite=True) as temporary:
        _write(temporary, columns, rows)
    for part in parts:
        part.unlink()


def evenly(rows: dict[int, Any]) -> list[int]:
    """Numbers of rows in random order, each kind and error as often as the others."""
    groups: dict[tuple[Any, Any], list[int]] = {}
    for number in np.random.default_rng(40).permutation(list(rows)).tolist():
        row = rows[number]
        groups.setdefault((row.get("kind"), row.get("spoiler")), []).append(number)
    turns = itertools.zip_longest(*groups.values())
    return [number for turn in turns for number in turn if number is not None]


def _write(path: Path, columns: tuple[str, ...], rows: dict[int, Any]) -> None:
    """Write a table, ordered by number."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[number] for number in sorted(rows))


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a table, none without a file."""
    if not path.is_file():
        return []
    with path.open() as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    main()
