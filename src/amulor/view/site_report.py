"""Report on a site: poses, plan, weakly determined poses, change between visits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from amulor.site.change.distances import Change, Region
from amulor.site.change.moved import Motion, free_motions
from amulor.site.description import ScaleBar, Site
from amulor.site.merging.cloud import Merged
from amulor.site.merging.plan import PlacedScan
from amulor.site.registration.reliability import (
    ObservationGroup,
    Reliability,
    group_of,
    observation_groups,
)
from amulor.site.registration.result import Registration, relative_covariance
from amulor.view.report import Heading, Paragraph, Part, Picture, Table, write_report
from amulor.view.sheet import error_ellipse, separate
from amulor.view.site_plan import label_plan, plan_figure, with_all_digits
from amulor.view.site_residuals import (
    MOST_MAPS,
    PairResiduals,
    residual_histograms,
    residual_maps,
)
from amulor.view.style import (
    COLOURS,
    DIFFERENCE_MAP,
    ERROR_MAP,
    new_figure,
    style,
)

Floats = NDArray[np.float64]

#: Largest number of points in a figure; more would cover each other [1].
_SHOWN = 60_000


def write(
    path: str | Path,
    site: Site,
    registration: Registration,
    cloud: Merged,
    *,
    scans: Sequence[PlacedScan],
    change: Change | None = None,
    places: Sequence[Region] = (),
    motions: Mapping[int, Motion | str] | None = None,
    residuals: Sequence[PairResiduals] = (),
    overwrite: bool = False,
) -> None:
    """Write the report on a site as one HTML file."""
    with style():
        plan, enlarged = plan_figure(site, registration, scans)
        parts: list[Part] = [Paragraph(_summary(site, registration, cloud))]
        parts += [
            Heading("Plan"),
            Picture(
                plan,
                f"Visit {site.epoch[-1].name} from above, shaded, with targets (rings) "
                "and the stations of all visits (crosses). The ellipses are one "
                f"standard uncertainty against {site.scan[0].name}, enlarged "
                f"{enlarged:g} times. The command amulor site drawings draws it to "
                "scale.",
            ),
            Heading("Poses"),
            _poses(site, registration),
            *_warnings(registration),
            _pairs(registration),
            *_residuals(residuals),
            *_network(site, registration, residuals),
            Heading("Points"),
            Picture(
                errors(cloud),
                "Largest standard uncertainty of each point, from noise, shared errors "
                "and pose.",
            ),
            _scans(site, cloud),
        ]
        if change is not None:
            parts += _changed(change, places, motions or {})
        write_report(path, site.name, parts, overwrite=overwrite)


def ellipses(site: Site, registration: Registration) -> Figure:
    """Draw the error ellipses of scans and targets in plan and in profile."""
    places = {
        scan.name: (
            registration.poses[scan.name].position,
            registration.covariance_of(f"pose {scan.name}")[:3, :3],
            COLOURS[0],
        )
        for scan in site.scan
    }
    for name, point in registration.points.items():
        places[name] = (point, registration.covariance_of(f"point {name}"), COLOURS[1])
    at = np.array([place for place, _, _ in places.values()])
    extent = max(float(np.ptp(at, axis=0).max()), 0.1)
    largest = max(
        float(np.sqrt(max(np.linalg.eigvalsh(spread)[-1], 0.0)))
        for _, spread, _ in places.values()
    )
    # A round number, so that the largest ellipse is about a tenth of the site.
    factor = 0.05 * extent / max(largest, 1e-9)
    power = 10.0 ** np.floor(np.log10(factor))
    factor = max(step for step in (1, 2, 5) if step * power <= factor) * power
    pad = 0.12 * extent
    low, high = at.min(axis=0) - pad, at.max(axis=0) + pad
    wide, *spans = high - low
    figure = new_figure(7.0, min(6.2 * float(sum(spans) / wide) + 1.3, 11.0))
    panels = figure.subplots(2, 1, height_ratios=spans)
    names = []
    for axes, height, label, title in zip(
        panels, (1, 2), ("north [m]", "up [m]"), ("Plan", "Profile"), strict=True
    ):
        columns = (0, height)
        labels, drawn = [], []
        for name, (place, spread, colour) in places.items():
            center = (float(place[0]), float(place[height]))
            axes.plot(*center, ".", color=colour, markersize=3)
            labels.append(
                axes.annotate(
                    name, center, xytext=(8, 8), textcoords="offset points",
                    ha="center", va="center",
                )
            )  # fmt: skip
            section = spread[np.ix_(columns, columns)]
            ellipse = error_ellipse(center, section, factor=factor, colour=colour)
            drawn.append(axes.add_patch(ellipse))
        names.append((axes, labels, drawn))
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[height], high[height])
        axes.set_ylabel(label)
        axes.set_title(title)
        axes.grid(visible=True)
        with_all_digits(axes)
    panels[1].set_xlabel("east [m]")
    panels[0].plot([], [], color=COLOURS[0], label="scans")
    if registration.points:
        panels[0].plot([], [], color=COLOURS[1], label="targets")
    size = 10.0 ** np.floor(np.log10(max(largest, 1e-9)))
    figure.legend(
        loc="outside lower center",
        ncols=2,
        title=f"Ellipses enlarged {factor:g} times: {size * factor:.3g} m on the axes "
        f"for {size * 1e3:g} mm",
    )
    for axes, labels, drawn in names:
        separate(axes, labels, drawn)
    return figure


def errors(cloud: Merged) -> Figure:
    """Draw a plan map of point uncertainty, and its histogram."""
    figure = new_figure(7.0, 3.4)
    axes = figure.subplots(1, 2, width_ratios=(1.5, 1))
    some = _thinned(np.flatnonzero(~cloud.moving))
    largest = np.sqrt(np.linalg.eigvalsh(cloud.covariance[some])[:, -1]) * 1e3
    points = axes[0].scatter(
        *cloud.position[some, :2].T, c=largest, s=0.6, cmap=ERROR_MAP, linewidths=0,
        vmin=float(np.quantile(largest, 0.01)), vmax=float(np.quantile(largest, 0.99)),
        rasterized=True,
    )  # fmt: skip
    figure.colorbar(points, ax=axes[0], label="standard uncertainty [mm]")
    label_plan(axes[0])
    axes[1].hist(largest, bins=60, range=(0, float(np.quantile(largest, 0.995))))
    axes[1].set_xlabel("standard uncertainty [mm]")
    axes[1].set_ylabel("points shown")
    return figure


def change_map(change: Change, places: Sequence[Region]) -> Figure:
    """Draw the change between visits in plan, and a histogram of its significance."""
    figure = new_figure(7.0, 3.6)
    axes = figure.subplots(1, 2, width_ratios=(1.5, 1))
    both = np.isfinite(change.value)
    still, sure = both & ~change.significant, both & change.significant
    value = change.value * 1e3
    limit = max(float(np.quantile(np.abs(value[both]), 0.995)), 1e-3)
    colours = {"cmap": DIFFERENCE_MAP, "vmin": -limit, "vmax": limit, "linewidths": 0}
    axes[0].scatter(*change.position[still, :2].T, c=value[still], s=3, **colours)
    points = axes[0].scatter(
        *change.position[sure, :2].T, c=value[sure], s=12, **colours
    )
    figure.colorbar(points, ax=axes[0], label="change along the normal [mm]")
    for number, place in enumerate(places):
        ring = Circle(
            (float(place.centre[0]), float(place.centre[1])),
            place.reach * 1.15,
            fill=False,
        )
        axes[0].add_patch(ring)
        corner = (place.centre[0] + place.reach, place.centre[1] + place.reach)
        axes[0].annotate(str(number + 1), corner)
    if places:
        # Limits around the changed regions, which may be small within the site.
        low, high = (
            pick([sign * place.reach + place.centre[:2] for place in places], axis=0)
            for pick, sign in ((np.min, -1), (np.max, 1))
        )
        margin = max(float((high - low).max()), 10 * change.spacing) / 2
        axes[0].set_xlim(low[0] - margin, high[0] + margin)
        axes[0].set_ylim(low[1] - margin, high[1] + margin)
    label_plan(axes[0])
    score = change.value[both] / change.uncertainty[both]
    bins = np.linspace(-6, 6, 61)
    axes[1].hist(
        np.clip(score, -6, 6), bins=list(bins), density=True, color=COLOURS[5],
        label="measured",
    )  # fmt: skip
    axes[1].plot(
        bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=COLOURS[6],
        label="without change",
    )  # fmt: skip
    axes[1].set_xlabel("change over its uncertainty")
    axes[1].set_yticks([])
    axes[1].legend(loc="upper right")
    return figure


def _thinned(at: NDArray[np.intp]) -> NDArray[np.intp]:
    return at[:: max(len(at) // _SHOWN, 1)]


def _summary(site: Site, registration: Registration, cloud: Merged) -> str:
    unsettled = "" if registration.settled else " The fit did not settle."
    tied = (
        f" The frame is that of {registration.fixed}; nothing ties it to the world."
        if registration.fixed
        else ""
    )
    crs = f" Reference system: {site.frame.crs}." if site.frame.crs else ""
    present = {scan.name for scan in site.scan}
    unchecked = "".join(
        f" Left out is {item.scan}: {item.reason}."
        for item in registration.unchecked
        if item.scan not in present
    )
    return (
        f"{len(site.scan)} scans of {len(site.epoch)} visits, "
        f"{len(cloud.position):,} points, {int((cloud.confirmed > 0).sum()):,} of them "
        f"seen by several scans of a visit, {int(cloud.moving.sum()):,} seen through "
        f"by others and left out of comparisons.{tied}{crs}{unsettled}{unchecked} "
        "Uncertainties are standard uncertainties (k = 1)."
    )


def _poses(site: Site, registration: Registration) -> Table:
    rows = []
    for scan in site.scan:
        pose = registration.poses[scan.name]
        sigma = np.sqrt(np.diag(registration.covariance_of(f"pose {scan.name}"))) * 1e3
        against = relative_covariance(registration, scan.name, site.scan[0].name)
        rows.append(
            [
                scan.name,
                scan.epoch,
                *(f"{value:.4f}" for value in pose.position),
                *(f"{value:.2f}" for value in sigma[:3]),
                *(f"{value:.3f}" for value in sigma[3:]),
                *(f"{value:.2f}" for value in _largest(against)),
            ]
        )
    header = ["scan", "epoch", "east [m]", "north [m]", "up [m]"]
    header += ["u(e) [mm]", "u(n) [mm]", "u(u) [mm]"]
    header += ["about e [mrad]", "about n [mrad]", "about up [mrad]"]
    header += [f"against {site.scan[0].name} [mm]", "[mrad]"]
    return Table(
        header,
        rows,
        "Standard uncertainties in the frame of the site. They include errors that are "
        "common to all scans, such as the position of the whole site. The last two "
        f"columns are relative to {site.scan[0].name}, the largest of three axes.",
    )


def _largest(covariance: Floats) -> tuple[float, float]:
    """Largest standard uncertainties of position [mm] and attitude [mrad]."""
    shift, turn = (
        np.sqrt(max(float(np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1]), 0))
        for k in (0, 3)
    )
    return float(shift) * 1e3, float(turn) * 1e3


def _warnings(registration: Registration) -> list[Part]:
    parts: list[Part] = []
    for worst in registration.disagreements:
        first, second = worst["scans"]
        parts.append(
            Paragraph(
                f"{first} on {second} contradicts all others by "
                f"{worst['shift'] * 1e3:.2f} mm and {worst['turn'] * 1e3:.3f} mrad; it "
                f"counts {worst['trust']:.0%}."
            )
        )
    for weak in registration.weaknesses:
        shift = ", ".join(f"{v * 1e3:.1f}" for v in weak.shift)
        turn = ", ".join(f"{v * 1e3:.2f}" for v in weak.turn)
        parts.append(
            Paragraph(
                f"Only its start pose holds {weak.scan} along ({shift}) mm with a turn "
                f"of ({turn}) mrad (one standard deviation)."
            )
        )
    return parts


def _pairs(registration: Registration) -> Table:
    rows = [
        [
            f"{pair['source']} on {pair['target']}",
            f"{pair['points']}",
            f"{pair['median_distance_m'] * 1e3:.2f}",
            f"{pair['misfit']:.2f}",
            f"{pair['moved_points']}",
            f"!{6 - len(pair['loose'])}" if pair["loose"] else "6",
        ]
        for pair in registration.pairs
    ]
    return Table(
        ["scans", "points", "median [mm]", "misfit", "excluded", "directions"],
        rows,
        "Distances of the points of one scan from the surface of another, along the "
        "beam. The misfit is their scatter over the stated noise. Groups of points off "
        "the surface belong to other objects and are excluded. The last column is the "
        "number of pose directions that the pair determines: three on a flat sea bed.",
    )


#: Factor and name of the unit in which values of a kind are shown.
_SHOWN_AS = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "1": (1.0, "u")}


def _residuals(residuals: Sequence[PairResiduals]) -> list[Part]:
    """Return the maps of the residuals of scan pairs."""
    if not residuals:
        return []
    which = (
        "All pairs"
        if len(residuals) <= MOST_MAPS
        else f"The {MOST_MAPS} of {len(residuals)} pairs with the largest scatter"
    )
    return [
        Picture(
            residual_maps(residuals),
            f"{which}: mean distances over cells of pixels of the first scan. The "
            "number in a title is the root mean square of the distances over their "
            "stated noise, which is 1 without other errors. Rows or columns of one "
            "color show a drift, and a single spot shows another object. Gray cells "
            "are not compared.",
        )
    ]


def _network(
    site: Site, registration: Registration, residuals: Sequence[PairResiduals]
) -> list[Part]:
    """Return the network report: ellipses, groups and values with their reliability."""
    groups = observation_groups(registration.reliability)
    if not groups:
        return []
    rows = []
    for group in groups:
        mark = "!" if abs(group.largest_score) > group.limit else ""
        rows.append(
            [
                group.group,
                f"{group.count}",
                f"{group.unchecked}",
                f"{group.redundancy:.2f}",
                f"{mark}{group.largest_score:+.2f} of {group.limit:.2f}",
                group.largest_of,
                _detectable(group),
                _scaled(group.external, 1e3),
            ]
        )
    parts: list[Part] = [
        Heading("Network"),
        Picture(
            ellipses(site, registration),
            "Standard error ellipses (k = 1) in the frame of the site: in plan above, "
            "in the plane of east and up below.",
        ),
        Picture(
            residual_histograms(residuals, registration.reliability),
            "Residuals over their standard uncertainties: of the points of all scan "
            "pairs, and of the stated values that other data check. Points in tails "
            "and a wide histogram show errors that are not stated.",
        ),
        Table(
            [
                "observations", "values", "unchecked", "mean redundancy",
                "largest w and its limit", "of", "detectable",
                "external reliability [mm]",
            ],
            rows,
            "Reliability by group, after W. Baarda. The redundancy number is the part "
            "of an error that appears in the residual. The standardized residual w "
            "exceeds its limit by chance in one of 1,000 networks. An error is "
            "detectable with a power of 80 %, at a false-alarm rate of 1 in 1,000. "
            "External reliability is the largest shift of a scan by such an error. "
            "The table contains the largest values of each group.",
        ),
    ]  # fmt: skip
    for group in groups:
        lines = [
            line for line in registration.reliability
            if group_of(line)[0] == group.group
        ]  # fmt: skip
        parts.append(_observations(site, group, lines))
    if registration.scale:
        parts.append(_scale(registration))
    return parts


def _scale(registration: Registration) -> Table:
    """Return the table of the site's scale and group index by scale bars."""
    rows = []
    for test in registration.scale:
        index, stated = "-", "-"
        if test.stated_index is not None:
            stated = f"{test.stated_index:.5f} ± {test.stated_index_uncertainty:.5f}"
        if test.group_index is not None:
            index = f"{test.group_index:.5f} ± {test.group_index_uncertainty:.5f}"
        rows.append(
            [
                test.bar,
                f"{test.length * 1e3:.2f} ± {test.length_uncertainty * 1e3:.2f}",
                f"{test.measured * 1e3:.2f} ± {test.measured_uncertainty * 1e3:.2f}",
                f"{test.scale:.6f} ± {test.scale_uncertainty:.6f}",
                f"{'!' if test.chance < 1e-3 else ''}{test.score:+.2f}",
                index,
                stated,
            ]
        )
    return Table(
        [
            "bar", "stated length [mm]", "by the scans [mm]", "scale", "score",
            "group index by the bar", "stated group index",
        ],
        rows,
        "Absolute scale: length between both ends of a bar by all other observations, "
        "over its stated length. The score is the difference over its standard "
        "uncertainty. The group index by the bar is that for which both lengths agree, "
        "without the stated group index.",
    )  # fmt: skip


def _observations(
    site: Site, group: ObservationGroup, lines: Sequence[Reliability]
) -> Table:
    """Return the table of all values of a group, with their residuals."""
    factor, unit = _SHOWN_AS[group.unit]
    in_unit = f" [{unit}]"
    lengths = {
        f"bar {' '.join(item.ends)}": item.length
        for item in site.target
        if isinstance(item, ScaleBar)
    }
    bars = group.group == "scale bars"
    rows = []
    for line in lines:
        name = line.observation.partition(" ")[2]
        row = [name] if bars or not line.part else [name, line.part]
        if bars:
            row.append(f"{lengths.get(line.observation, float('nan')):.4f}")
        mark = "!" if abs(line.score) > group.limit else ""
        rows.append(
            [
                *row,
                _scaled(line.uncertainty, factor),
                f"{line.residual * factor:+.3f}",
                f"{line.redundancy:.2f}",
                f"{mark}{line.score:+.2f}" if line.detectable is not None else "-",
                _scaled(line.detectable, factor),
                _scaled(line.external, 1e3),
                line.external_scan or "-",
            ]
        )
    first = {"scale bars": ["bar", "length [m]"], "shared errors": ["error"]}
    return Table(
        [
            *first.get(group.group, ["observation", "component"]),
            f"stated u{in_unit}", f"residual{in_unit}", "redundancy", "w",
            f"detectable{in_unit}", "external [mm]", "of scan",
        ],
        rows,
        f"{group.group.capitalize()}: adjusted minus stated value, and reliability. A "
        "dash marks values that no other observation checks."
        + (
            " The unit u of each value is its stated standard uncertainty. A shape "
            "is an error of the open-water reference or the water of this scan: these "
            "errors vary over the image, and shape 1 is the largest independent part."
            if group.unit == "1"
            else ""
        ),
    )  # fmt: skip


def _detectable(group: ObservationGroup) -> str:
    """Return the largest minimal detectable error of a group with its unit."""
    factor, unit = _SHOWN_AS[group.unit]
    if group.detectable is None:
        return "-"
    return f"{_scaled(group.detectable, factor)} {unit}"


def _scaled(value: float | None, factor: float) -> str:
    """Return a value in another unit as text; a dash for no value."""
    return "-" if value is None else f"{value * factor:.2f}"


def _scans(site: Site, cloud: Merged) -> Table:
    rows = []
    for number, scan in enumerate(site.scan):
        mine = cloud.scan == number
        sigma = np.median(cloud.sigma[mine], axis=0) * 1e3
        moving = int(cloud.moving[mine].sum())
        rows.append(
            [
                scan.name,
                f"{int(mine.sum())}",
                f"{(cloud.confirmed[mine] > 0).mean():.0%}",
                f"!{moving}" if moving else "0",
                *(f"{value:.2f}" for value in sigma),
            ]
        )
    return Table(
        ["scan", "points", "seen by others", "seen through", "u(e) [mm]", "u(n) [mm]",
         "u(u) [mm]"],
        rows,
        "Medians over the points. Points that others see through, such as fish and "
        "divers, are marked in all files.",
    )  # fmt: skip


def _changed(
    change: Change, places: Sequence[Region], motions: Mapping[int, Motion | str]
) -> list[Part]:
    both = np.isfinite(change.value)
    share = change.significant.sum()
    parts: list[Part] = [
        Heading(f"Change from {change.epochs[0]} to {change.epochs[1]}"),
        Paragraph(
            f"{int(both.sum())} places {change.spacing * 1e3:.0f} mm apart were "
            f"compared, in cylinders of {change.radius * 1e3:.0f} mm radius; "
            f"{int(share)} changed, of which at most {change.false_alarms:.0%} by "
            "chance. Median standard uncertainty "
            f"{np.nanmedian(change.uncertainty[both]) * 1e3:.2f} mm, poses included."
        ),
        Picture(
            change_map(change, places),
            "Large dots are significant changes, and circles are connected regions. "
            "Right: distribution of all places, and that without change.",
        ),
    ]
    if not places:
        return [*parts, Paragraph("No place changed.")]
    rows, moved_rows = [], []
    for number, place in enumerate(places):
        motion = motions.get(number)
        moved = ["-", "", "", "", ""]
        first = next((k for k in sorted(motions) if motions[k] is motion), number)
        if motion is not None and first != number:
            moved[0] = f"as place {first + 1}"
        elif isinstance(motion, str):
            moved[4] = motion
        elif motion is not None:
            shift = ", ".join(f"{v * 1e3:+.2f}" for v in motion.shift)
            moved = [
                f"{motion.distance * 1e3:.2f} ± "
                f"{motion.distance_uncertainty * 1e3:.2f}",
                shift,
                f"{np.degrees(motion.angle):.2f} ± "
                f"{np.degrees(motion.angle_uncertainty):.2f}",
                ", ".join(f"{v:.3f}" for v in motion.centre),
                free_motions(motion) or "-",
            ]
        rows.append(
            [
                str(number + 1),
                ", ".join(f"{v:.2f}" for v in place.centre),
                f"{place.area * 1e4:.0f} ± {place.area_uncertainty * 1e4:.0f}",
                f"{place.mean * 1e3:+.2f} ± {place.mean_uncertainty * 1e3:.2f}",
                f"{place.volume * 1e6:+.0f} ± {place.volume_uncertainty * 1e6:.0f}",
                f"{place.lost * 1e4:.0f}",
            ]
        )
        if motion is not None:
            moved_rows.append([str(number + 1), *moved])
    header = ["place", "at [m]", "area [cm²]", "mean [mm]", "volume [cm³]"]
    header += ["not compared [cm²]"]
    parts.append(
        Table(
            header,
            rows,
            "Mean changes and volumes along the normals. A volume includes the rim of "
            "its region, and interpolated changes where nothing could be compared.",
        )
    )
    if not moved_rows:
        return parts
    header = ["place", "moved by [mm]", "east, north, up [mm]", "turned by [deg]"]
    header += ["center [m]", "not known"]
    caption = (
        "Rigid motions of the objects above the ground, from the first visit to the "
        "second. Motions that the shape of an object does not determine are not known, "
        "and set to zero."
    )
    return [*parts, Table(header, moved_rows, caption)]
