"""`amulor site`: check, register, merge, compare, draw and report many scans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    import xarray as xr

    from amulor.platform import Mounting, Trajectory
    from amulor.site import Site
    from amulor.site.change.distances import Change, Region
    from amulor.site.change.moved import Motion
    from amulor.site.merging.cloud import Merged
    from amulor.site.registration.result import Registration
    from amulor.site.registration.surface import ScanSurface

    #: Motion of the object in each region, or the reason why none is fitted.
    Motions = dict[int, Motion | str]


def check(
    site: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Check a site file and the files it names.

    Parameters
    ----------
    site
        Site file (TOML).
    json
        Print the findings as JSON.
    """
    from amulor.cli._arguments import check_inputs

    check_inputs(site)

    from dataclasses import asdict

    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.errors import SurveyError
    from amulor.site import Site
    from amulor.site.check import check as look

    described = Site.from_toml(site)
    with progress_bar(quiet=json):
        content = look(described)
    if json:
        print_json({"site": described.name, **asdict(content)})
    else:
        for line in content.remarks:
            print(f"note: {line}")
    if content.mistakes:
        raise SurveyError("\n".join(f"{site}: {line}" for line in content.mistakes))
    if not json:
        targets = len(described.target)
        print(
            f"{site}: {described.name}: {len(described.scan)} scans of "
            f"{len(described.epoch)} epochs, {targets} targets, "
            f"{len(described.control)} control points"
        )
        print_next(f"amulor site register {site} -o poses.json")


def schema() -> None:
    """Print the JSON Schema of site files."""
    from amulor.cli._output import print_json
    from amulor.site.description import json_schema

    print_json(json_schema())


def register(
    site: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    trajectories: Path | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Register all scans of a site in one frame.

    Parameters
    ----------
    site
        Site file (TOML).
    output
        File to write (JSON), with all poses and their joint covariance.
    trajectories
        Folder for the corrected trajectory (CSV) and mounting (TOML) of each line.
    json
        Print the result as JSON.
    overwrite
        Replace an existing file.
    """
    from amulor import io
    from amulor._extras import require
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.errors import CubeError
    from amulor.site import Site
    from amulor.site.registration import register as room
    from amulor.site.registration.reliability import observation_groups
    from amulor.site.registration.result import write_registration

    require("site", purpose="registration")
    check_ending("--output", output, (".json",))
    described = Site.from_toml(site)
    io.check_output(
        output, overwrite=overwrite, inputs=[site, *(s.file for s in described.scan)]
    )
    with progress_bar(quiet=json):
        result = room.register(described)
        write_registration(result, output, overwrite=overwrite)
        if trajectories is not None and not result.contradictions:
            _write_lines(
                room.refined_lines(described, result), trajectories, overwrite=overwrite
            )
    if json:
        print_json(
            {
                "poses": {
                    name: {
                        "position_m": pose.position,
                        "uncertainty": _sigmas(result, name),
                        "undetected": _undetected(result, name),
                    }
                    for name, pose in result.poses.items()
                },
                "pairs": [
                    {k: v for k, v in pair.items() if k != "moved_pixels"}
                    for pair in result.pairs
                ],
                "disagreements": result.disagreements,
                "weaknesses": [vars(entry) for entry in result.weaknesses],
                "contradictions": [vars(entry) for entry in result.contradictions],
                "patterns": [vars(test) for test in result.patterns],
                "reliability": [vars(line) for line in result.reliability],
                "network": [
                    vars(group) for group in observation_groups(result.reliability)
                ],
                "scale": [vars(test) for test in result.scale],
                "remarks": result.remarks,
                "unchecked": [vars(entry) for entry in result.unchecked],
                "settled": result.settled,
            }
        )
    else:
        _print_poses(result)
        print(f"{output}: poses of {len(result.poses)} scans")
    if result.contradictions:
        raise CubeError(f"{output}: {_not_good(result)}")
    if not json:
        print_next(f"amulor site merge {site} --poses {output} -o merged")


def _write_lines(
    lines: Iterator[tuple[str, Trajectory, Mounting]],
    folder: Path,
    *,
    overwrite: bool,
) -> None:
    """Write corrected trajectory and mounting of each line."""
    from amulor.io.files import atomic_output
    from amulor.io.trajectories import write_trajectory
    from amulor.platform.mounting import mounting_text

    folder.mkdir(parents=True, exist_ok=True)
    for name, track, mounting in lines:
        write_trajectory(track, folder / f"{name}.csv", overwrite=overwrite)
        with atomic_output(folder / f"{name}.toml", overwrite=overwrite) as temporary:
            temporary.write_text(mounting_text(mounting), encoding="utf-8")


def _not_good(result: Registration) -> str:
    """Return the error text of a registration: one line per contradiction."""
    lines = [entry.sentence for entry in result.contradictions]
    return "the poses are not good\n" + "\n".join(lines)


def _sigmas(result: Registration, name: str) -> list[float]:
    import numpy as np

    return [float(v) for v in np.sqrt(np.diag(result.covariance_of(f"pose {name}")))]


def _undetected(result: Registration, name: str) -> dict[str, Any] | None:
    """Largest pose change by an undetected error; None if none was computed."""
    return vars(result.undetected[name]) if name in result.undetected else None


def _print_poses(result: Registration) -> None:
    import numpy as np

    from amulor.cli._output import print_table

    rows = []
    for name, pose in result.poses.items():
        sigma = np.array(_sigmas(result, name))
        hidden = result.undetected.get(name)
        rows.append(
            [
                name,
                *(f"{value:.4f}" for value in pose.position),
                f"{np.linalg.norm(sigma[:3]) * 1e3:.2f}",
                f"{np.linalg.norm(sigma[3:]) * 1e3:.3f}",
                f"{hidden.shift * 1e3:.1f}" if hidden else "-",
            ]
        )
    header = ["scan", "east, m", "north, m", "up, m", "u, mm", "u, mrad", "+, mm"]
    print_table("Poses", header, rows)
    if result.undetected:
        print("+: largest shift by a drift or delay of one scan that no test detects")
    if result.fixed:
        print(f"the frame is that of {result.fixed}: nothing ties it to the world")
    for test in result.scale:
        print(f"scale by {test.sentence}")
    for line in result.remarks:
        print(f"warning: {line}")
    for entry in result.unchecked:
        print(f"warning: {entry.sentence}")
    for disagreement in result.disagreements:
        first, second = disagreement["scans"]
        print(
            f"warning: {first} on {second} contradicts all others by "
            f"{disagreement['shift'] * 1e3:.2f} mm, "
            f"{disagreement['turn'] * 1e3:.3f} mrad (chi-square "
            f"{disagreement['score']:.1f} per degree of freedom); it counts "
            f"{disagreement['trust']:.0%}. Look whether something moved, or "
            "the instrument did during a scan"
        )
    for weak in result.weaknesses:
        shift, turn = np.array(weak.shift), np.array(weak.turn)
        print(
            f"warning: {weak.scan}: only its start pose holds it along "
            f"({', '.join(f'{v * 1e3:.1f}' for v in shift)}) mm with a turn of "
            f"({', '.join(f'{v * 1e3:.2f}' for v in turn)}) mrad (one standard "
            "deviation); add targets, or a scan that sees relief"
        )
    if not result.settled:
        print("warning: the fit did not settle; the covariance may be too small")


def merge(
    site: Path,
    /,
    *,
    poses: Path,
    output: Annotated[Path, Parameter(alias="-o")],
    tile: str = "5 m",
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Merge all scans of a site into LAZ tiles, or an E57 file of all scans.

    Parameters
    ----------
    site
        Site file (TOML).
    poses
        Registration (JSON), from "amulor site register".
    output
        Folder to create for LAZ tiles, or a file with the ending .e57.
    tile
        Side of a tile, such as "5 m".
    json
        Print the result as JSON.
    overwrite
        Replace existing files.
    """
    from amulor import io
    from amulor._extras import require
    from amulor.cli._arguments import quantity_of
    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.site.merging.pixels import all_points, scan_clouds
    from amulor.site.merging.tiles import write_tiles

    as_e57 = output.suffix.lower() == ".e57"
    require("e57" if as_e57 else "export", purpose="merging")
    size = quantity_of("--tile", tile, "length")
    if as_e57:
        io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    with progress_bar(quiet=json) as advance:
        merged = opened(site, poses, with_images=as_e57)
        advance(f"writing {output}", 0.8)
        points = _Counted(
            all_points(merged.cloud, merged.registration, merged.surfaces)
        )
        if as_e57:
            clouds = scan_clouds(
                merged.cloud, merged.registration, merged.surfaces, merged.images
            )
            io.write_e57_scans(list(clouds), output, overwrite=overwrite)
            files = [output]
            for _ in points:
                pass
        else:
            files = write_tiles(
                merged.cloud, output, size=size, overwrite=overwrite, pieces=points
            )
    moving = {
        scan.name: points.moving.get(number, 0)
        for number, scan in enumerate(merged.site.scan)
    }
    if json:
        print_json(
            {
                "files": files,
                "points": points.count,
                "moving_points": moving,
                "median_uncertainty_m": points.median_uncertainty,
                "seen_by_several": points.confirmed / max(points.count, 1),
            }
        )
        return
    for name, count in moving.items():
        if count:
            print(f"{name}: {count} points that other scans see through, marked")
    east, north, up = (1e3 * v for v in points.median_uncertainty)
    print(
        f"{output}: {points.count} points in {len(files)} "
        f"file{'s' if len(files) > 1 else ''}, "
        f"{points.confirmed / max(points.count, 1):.0%} seen by several scans, median "
        f"uncertainty {east:.2f}, {north:.2f}, {up:.2f} mm"
    )
    print_next(f"amulor view {files[0]}")


class _Counted:
    """Pieces of a merged cloud, counted while they are written."""

    def __init__(self, pieces: Iterator[Merged]) -> None:
        self._pieces = pieces
        self._sigma: list[Any] = []
        self.count = self.confirmed = 0
        self.moving: dict[int, int] = {}

    def __iter__(self) -> Iterator[Merged]:
        import numpy as np

        for piece in self._pieces:
            self.count += len(piece.position)
            self.confirmed += int((piece.confirmed > 0).sum())
            for number in np.unique(piece.scan[piece.moving]):
                moving = piece.moving & (piece.scan == number)
                self.moving[number] = self.moving.get(number, 0) + int(moving.sum())
            # Of the many points of averaged scans a hundredth suffices. Without a copy
            # it would keep the memory of all.
            step = 100 if piece.brightest else 1
            self._sigma.append(piece.sigma[::step].copy())
            yield piece
            release_memory()

    @property
    def median_uncertainty(self) -> list[float]:
        """Median standard uncertainty of the coordinates, shape (3,) [m]."""
        import numpy as np

        return [float(v) for v in np.median(np.concatenate(self._sigma), axis=0)]


def compare(
    site: Path,
    /,
    *,
    poses: Path,
    output: Annotated[Path, Parameter(alias="-o")],
    first: str | None = None,
    second: str | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compare two visits to a site: change, significance, volumes, motions.

    Parameters
    ----------
    site
        Site file (TOML).
    poses
        Registration (JSON), from "amulor site register".
    output
        Table to write (CSV), with a row for each point of the surface.
    first
        Earlier visit (epoch); by default the first.
    second
        Later visit (epoch); by default the last.
    json
        Print the result as JSON.
    overwrite
        Replace an existing file.
    """
    import numpy as np

    from amulor import io
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import print_json, progress_bar
    from amulor.site import Site
    from amulor.site.change.distances import write_change

    io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    check_ending("--output", output, (".csv",))
    epochs = epochs_of(Site.from_toml(site), first, second)
    with progress_bar(quiet=json):
        merged = opened(site, poses)
        change, places, motions = changes_between(merged, epochs)
        write_change(change, output, overwrite=overwrite)
    finite = np.isfinite(change.value)
    if json:
        print_json(
            {
                "epochs": epochs,
                "compared": int(finite.sum()),
                "significant": int(change.significant.sum()),
                "false_alarms": change.false_alarms,
                "median_uncertainty_m": float(np.nanmedian(change.uncertainty[finite])),
                "regions": [
                    _region(region, number, motions)
                    for number, region in enumerate(places)
                ],
            }
        )
        return
    print(
        f"{epochs[0]} to {epochs[1]}: {int(finite.sum())} places compared, "
        f"{int(change.significant.sum())} changed (of these at most "
        f"{change.false_alarms:.0%} by chance); median uncertainty "
        f"{np.nanmedian(change.uncertainty[finite]) * 1e3:.2f} mm"
    )
    for number, region in enumerate(places):
        print(region_sentence(number, region, motions))
    print(f"{output}: {len(change.value)} rows")


def _first_of(number: int, motions: Motions) -> int:
    """Return the number of the first region that moved like region `number`."""
    return next(k for k in sorted(motions) if motions[k] is motions[number])


def _region(region: Region, number: int, motions: Motions) -> dict[str, Any]:
    import numpy as np

    content: dict[str, Any] = {
        "centre_m": region.centre,
        "area_m2": region.area,
        "area_uncertainty_m2": region.area_uncertainty,
        "mean_m": region.mean,
        "mean_uncertainty_m": region.mean_uncertainty,
        "volume_m3": region.volume,
        "volume_uncertainty_m3": region.volume_uncertainty,
        "not_compared_m2": region.lost,
    }
    motion = motions.get(number)
    if motion is not None and _first_of(number, motions) != number:
        content["same_body_as_region"] = _first_of(number, motions)
    elif isinstance(motion, str):
        content["no_motion"] = motion
    elif motion is not None:
        content["motion"] = {
            "centre_m": motion.centre,
            "shift_m": motion.shift,
            "turn_rad": motion.turn,
            "uncertainty": [
                None if free else sigma
                for free, sigma in zip(
                    motion.undetermined,
                    np.sqrt(motion.covariance.diagonal()),
                    strict=True,
                )
            ],
            "distance_m": motion.distance,
            "distance_uncertainty_m": motion.distance_uncertainty,
            "angle_rad": motion.angle,
            "angle_uncertainty_rad": motion.angle_uncertainty,
            "covariance": motion.covariance,
            "points": motion.points,
            "loose": motion.loose,
        }
    return content


def region_sentence(number: int, region: Region, motions: Motions) -> str:
    """Describe a region of change: place, area, mean, volume, motion of a body."""
    place = ", ".join(f"{value:.3f}" for value in region.centre)
    text = (
        f"{number + 1}: at ({place}) m, {region.area * 1e4:.0f} +- "
        f"{region.area_uncertainty * 1e4:.0f} cm2, mean "
        f"{region.mean * 1e3:+.2f} +- {region.mean_uncertainty * 1e3:.2f} mm, volume "
        f"{region.volume * 1e6:+.0f} +- {region.volume_uncertainty * 1e6:.0f} cm3, "
        f"{region.lost * 1e4:.0f} cm2 there not compared"
    )
    motion = motions.get(number)
    if motion is None:
        return text
    first = _first_of(number, motions)
    if first != number:
        return f"{text}\n   the same body as {first + 1}"
    if isinstance(motion, str):
        return f"{text}\n   no motion of an object: {motion}"
    return f"{text}\n   {_motion_in_words(motion)}"


def _motion_in_words(motion: Motion) -> str:
    """Describe the translation and rotation of an object, with uncertainties."""
    import numpy as np

    from amulor.site.change.moved import free_motions

    shift = ", ".join(f"{value * 1e3:+.2f}" for value in motion.shift)
    centre = ", ".join(f"{value:.3f}" for value in motion.centre)
    axis = ", ".join(
        f"{value:+.2f}" for value in motion.turn / max(motion.angle, 1e-12)
    )
    return (
        f"its point ({centre}) m moved by {motion.distance * 1e3:.2f} +- "
        f"{motion.distance_uncertainty * 1e3:.2f} mm: ({shift}) mm; turned by "
        f"{np.degrees(motion.angle):.2f} +- "
        f"{np.degrees(motion.angle_uncertainty):.2f} deg about ({axis})"
        + (f"; not known: {free_motions(motion)}" if motion.loose else "")
    )


def report(
    site: Path,
    /,
    *,
    poses: Path,
    output: Annotated[Path, Parameter(alias="-o")],
    first: str | None = None,
    second: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a site report in one HTML file: plan, poses, errors, change.

    Parameters
    ----------
    site
        Site file (TOML).
    poses
        Registration (JSON), from "amulor site register".
    output
        Report to write (HTML).
    first
        Earlier visit (epoch) to compare; by default the first.
    second
        Later visit (epoch) to compare; by default the last.
    overwrite
        Replace an existing file.
    """
    from amulor import io
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import progress_bar
    from amulor.site import Site
    from amulor.site.merging.plan import placed
    from amulor.view import site_report
    from amulor.view.site_residuals import pair_residuals

    io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    check_ending("--output", output, (".html", ".htm"))
    visits = Site.from_toml(site)
    compared = len(visits.epoch) > 1 or first is not None
    epochs = epochs_of(visits, first, second) if compared else None
    change: Change | None = None
    places: tuple[Region, ...] = ()
    motions: Motions = {}
    with progress_bar() as advance:
        merged = opened(site, poses, with_images=True)
        if epochs is not None:
            change, places, motions = changes_between(merged, epochs)
        advance("drawing", 0.9)
        site_report.write(
            output,
            merged.site,
            merged.registration,
            merged.cloud,
            scans=placed(
                merged.site, merged.registration, merged.surfaces, merged.images
            ),
            change=change,
            places=places,
            motions=motions,
            residuals=pair_residuals(merged.registration, merged.surfaces),
            overwrite=overwrite,
        )
    print(f"{output}: {len(merged.site.scan)} scans, {len(places)} places that changed")


def drawings(
    site: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    poses: Path | None = None,
    epoch: str = "",
    scale: str | None = None,
    contours: str | None = None,
    line: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    exaggeration: Annotated[
        float, Parameter(validator=validators.Number(gte=0.1, lte=100))
    ] = 1.0,
    title: str = "",
    project: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Draw the plan of a site, sections across scans, and detail sheets.

    Parameters
    ----------
    site
        Site file (TOML).
    output
        File to write (PDF), with a page for each sheet. Beside it, each sheet is
        written as .svg and .dxf, and the heights as .tif.
    poses
        Registration (JSON), from "amulor site register". By default the site is
        registered first.
    epoch
        Visit of the plan; by default the last. Sections show all visits.
    scale
        Scale, such as 1:10. If the plan then exceeds a sheet of A3, it is an overview,
        and detail sheets follow. By default the plan fits A3.
    contours
        Interval of contour lines, such as "5 cm".
    line
        Section line, east and north of both ends, such as "--line=-2m,0m,2m,0m"; may
        be repeated. By default two lines through the middle.
    exaggeration
        Exaggeration of the heights of sections on paper.
    title
        Title; by default the name of the site.
    project
        Project file (TOML), as "amulor archive" reads it, for the title block.
    overwrite
        Replace existing files.
    """
    from amulor import _progress, io
    from amulor.cli._arguments import UsageError, check_ending, quantity_of
    from amulor.cli._output import progress_bar
    from amulor.cli.export import line_of, scale_of, title_fields
    from amulor.handover.site_drawings import SiteOrder, write_site_drawings
    from amulor.site.merging.plan import placed
    from amulor.site.registration.register import surfaces_of

    check_ending("--output", output, (".pdf",))
    inputs = [path for path in (site, poses, project) if path is not None]
    io.check_output(output, overwrite=overwrite, inputs=inputs)
    interval = None
    if contours is not None:
        interval = quantity_of("--contours", contours, "length")
        if not interval > 0:
            raise UsageError(f"--contours {contours}: must be above 0 m")
    order = SiteOrder(
        epoch=epoch,
        scale=None if scale is None else scale_of("--scale", scale),
        contours=interval,
        lines=tuple(line_of(text) for text in line),
        exaggeration=exaggeration,
        title=title,
        fields=title_fields(project, ""),
    )
    with progress_bar():
        with _progress.part(0.0, 0.4):
            described, registration = registered(site, poses)
        with _progress.part(0.4, 0.5):
            surfaces, images = surfaces_of(described)
        with _progress.part(0.5, 0.6):
            scans = placed(described, registration, surfaces, images)
        with _progress.part(0.6, 1.0):
            summary = write_site_drawings(
                described, registration, scans, output, order, overwrite=overwrite
            )
    print(f"{output}: {summary}")


def registered(path: Path, poses: Path | None) -> tuple[Site, Registration]:
    """Read a site and its registration, or register the site; check the poses.

    The returned site has no scans whose poses are unchecked, unless trusted.
    """
    from amulor.errors import CubeError
    from amulor.site import Site
    from amulor.site.registration.register import register as fit
    from amulor.site.registration.result import read_registration

    site = Site.from_toml(path)
    if poses is None:
        from amulor._extras import require

        require("site", purpose="registration")
        registration = fit(site)
    else:
        registration = read_registration(poses)
    lacking = [scan.name for scan in site.scan if scan.name not in registration.poses]
    if lacking:
        raise CubeError(
            f"{poses}: has no pose of scan {lacking[0]!r}; register the site again: "
            f"amulor site register {path} -o {poses} --overwrite"
        )
    if registration.contradictions:
        again = "poses.json" if poses is None else f"{poses} --overwrite"
        raise CubeError(
            f"{poses or path}: {_not_good(registration)}\nmend the site file and "
            f"register again: amulor site register {path} -o {again}"
        )
    return _without_unchecked(site, registration), registration


def _without_unchecked(site: Site, registration: Registration) -> Site:
    """Return a site without the scans whose poses no other data check."""
    import sys

    from amulor.errors import CubeError

    trusted = {scan.name for scan in site.scan if scan.trusted}
    unchecked = [item for item in registration.unchecked if item.scan not in trusted]
    names = {item.scan for item in unchecked}
    remaining = tuple(scan for scan in site.scan if scan.name not in names)
    if unchecked and len(remaining) < 2:
        raise CubeError(
            "no two scans are checked by each other\n"
            + "\n".join(item.sentence for item in unchecked)
        )
    for item in unchecked:
        print(f"warning: {item.sentence}", file=sys.stderr)
    return site.model_copy(update={"scan": remaining})


@dataclass(frozen=True, kw_only=True)
class Opened:
    """Site with its registration and its merged point cloud."""

    site: Site
    registration: Registration
    surfaces: dict[str, ScanSurface]
    images: dict[str, xr.Dataset]
    cloud: Merged


def release_memory() -> None:
    """Return freed memory to the operating system, if the C library can (glibc).

    It otherwise keeps freed blocks of less than 32 MB, some 20 MB for each large scan.
    """
    import ctypes
    import sys

    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def opened(path: Path, poses: Path | None, *, with_images: bool = False) -> Opened:
    """Read a site and its registration, or register it, and merge its scans.

    Without the range images less memory is needed.
    """
    from amulor import _progress
    from amulor.site.merging.cloud import merge
    from amulor.site.registration.register import surfaces_of

    site, registration = registered(path, poses)
    with _progress.part(0.0, 0.3):
        surfaces, images = surfaces_of(site)
    release_memory()
    with _progress.part(0.3, 0.6):
        cloud = merge(site, registration, surfaces, images)
    release_memory()
    return Opened(
        site=site,
        registration=registration,
        surfaces=surfaces,
        images=images if with_images else {},
        cloud=cloud,
    )


def epochs_of(site: Site, first: str | None, second: str | None) -> tuple[str, str]:
    """Return the names of the two visits to compare, by default first and last."""
    from amulor.cli._arguments import UsageError

    names = [epoch.name for epoch in site.epoch]
    if (first is None) != (second is None):
        raise UsageError("--first and --second must be given together")
    if first is None or second is None:
        if len(names) < 2:
            raise UsageError(
                f"the site has one epoch, {names[0]!r}; a comparison needs two"
            )
        return names[0], names[-1]
    for name in (first, second):
        if name not in names:
            listed = ", ".join(repr(epoch) for epoch in names)
            raise UsageError(f"{name!r} is no epoch of the site; there are {listed}")
    return first, second


def changes_between(
    merged: Opened, epochs: tuple[str, str]
) -> tuple[Change, tuple[Region, ...], Motions]:
    """Compute the change between two visits, its regions, and their rigid motions."""
    import numpy as np

    from amulor import _progress
    from amulor.errors import CubeError
    from amulor.site.change.distances import change, regions
    from amulor.site.change.moved import around, bodies, motion_of

    for epoch in epochs:
        if not merged.site.scans_of(epoch):
            raise CubeError(
                f"epoch {epoch!r}: no other data check the poses of its scans, so no "
                "change is known; add targets that both visits see, or state trusted "
                "= true in each [[scan]] whose start pose is surveyed"
            )
    with _progress.part(0.6, 0.8):
        result = change(
            merged.site,
            merged.registration,
            merged.surfaces,
            merged.cloud,
            epochs=epochs,
        )
    places = regions(result)
    motions: Motions = {}
    groups = bodies(places)
    for number, group in enumerate(groups):
        _progress.tell("fitting what moved", 0.8 + 0.1 * number / len(groups))
        centre, reach = around([places[k] for k in group])
        motion = motion_of(
            merged.site,
            merged.registration,
            merged.surfaces,
            epochs=epochs,
            centre=centre,
            reach=float(np.clip(1.5 * reach, 0.05, 1.0)),
        )
        motions |= dict.fromkeys(group, motion)
    return result, places, motions
