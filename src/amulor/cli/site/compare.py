"""`amulor site compare`: what changed between two visits, with significance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from amulor.site.change.moved import Motion
    from amulor.site.change.regions import Region


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
    """Compare two visits to a site: change, significance, volumes, what moved.

    Parameters
    ----------
    site
        Site file (TOML).
    poses
        Registration (JSON), from `amulor site register`.
    output
        Table to write (CSV), a row for each place of the surface.
    first
        Earlier epoch; the first one by default.
    second
        Later epoch; the last one by default.
    json
        Print the figures as JSON.
    overwrite
        Replace a file that is there.
    """
    import numpy as np

    from amulor import io
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import print_json, progress_bar
    from amulor.cli.site._results import epochs_of, opened, what_changed
    from amulor.site import Site
    from amulor.site.change.table import write_change

    io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    check_ending("--output", output, (".csv",))
    epochs = epochs_of(Site.from_toml(site), first, second)
    with progress_bar(quiet=json):
        found = opened(site, poses)
        change, places, motions = what_changed(found, epochs)
        write_change(change, output, overwrite=overwrite)
    known = np.isfinite(change.value)
    if json:
        print_json(
            {
                "epochs": epochs,
                "compared": int(known.sum()),
                "significant": int(change.significant.sum()),
                "false_alarms": change.false_alarms,
                "median_uncertainty_m": float(np.nanmedian(change.uncertainty[known])),
                "regions": [
                    _region(one, motions.get(number))
                    for number, one in enumerate(places)
                ],
            }
        )
        return
    print(
        f"{epochs[0]} to {epochs[1]}: {int(known.sum())} places compared, "
        f"{int(change.significant.sum())} changed (of these at most "
        f"{change.false_alarms:.0%} by chance); median uncertainty "
        f"{np.nanmedian(change.uncertainty[known]) * 1e3:.2f} mm"
    )
    for number, one in enumerate(places):
        print(_sentence(number + 1, one, motions.get(number)))
    print(f"{output}: {len(change.value)} rows")


def _region(one: Region, motion: Motion | None) -> dict[str, Any]:
    import numpy as np

    found: dict[str, Any] = {
        "centre_m": one.centre,
        "area_m2": one.area,
        "mean_m": one.mean,
        "mean_uncertainty_m": one.mean_uncertainty,
        "volume_m3": one.volume,
        "volume_uncertainty_m3": one.volume_uncertainty,
    }
    if motion is not None:
        found["motion"] = {
            "shift_m": motion.shift,
            "turn_rad": motion.turn,
            "uncertainty": np.sqrt(motion.covariance.diagonal()),
            "distance_m": motion.distance,
            "distance_uncertainty_m": motion.distance_uncertainty,
            "points": motion.points,
            "loose": motion.loose,
        }
    return found


def _sentence(number: int, one: Region, motion: Motion | None) -> str:
    place = ", ".join(f"{value:.3f}" for value in one.centre)
    text = (
        f"{number}: at ({place}) m, {one.area * 1e4:.0f} cm2, mean "
        f"{one.mean * 1e3:+.2f} +- {one.mean_uncertainty * 1e3:.2f} mm, volume "
        f"{one.volume * 1e6:+.0f} +- {one.volume_uncertainty * 1e6:.0f} cm3"
    )
    if motion is None:
        return text
    shift = ", ".join(f"{value * 1e3:+.2f}" for value in motion.shift)
    return (
        f"{text}\n   moved by {motion.distance * 1e3:.2f} +- "
        f"{motion.distance_uncertainty * 1e3:.2f} mm: ({shift}) mm"
    )
