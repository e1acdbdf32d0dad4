"""`amulor site report`: poses, plan and change of a site in one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from amulor.site.change.distances import Change
    from amulor.site.change.moved import Motion
    from amulor.site.change.regions import Region


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
    """Draw a site into one HTML file: plan, poses, errors, change.

    Parameters
    ----------
    site
        Site file (TOML).
    poses
        Registration (JSON), from `amulor site register`.
    output
        File to write (HTML).
    first
        Earlier epoch to compare; the first one by default.
    second
        Later epoch to compare; the last one by default.
    overwrite
        Replace a file that is there.
    """
    from amulor import io
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import progress_bar
    from amulor.cli.site._results import epochs_of, opened, what_changed
    from amulor.site import Site
    from amulor.view import site_report

    io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    check_ending("--output", output, (".html", ".htm"))
    visits = Site.from_toml(site)
    compared = len(visits.epoch) > 1 or first is not None
    epochs = epochs_of(visits, first, second) if compared else None
    change: Change | None = None
    places: tuple[Region, ...] = ()
    motions: dict[int, Motion] = {}
    with progress_bar() as advance:
        found = opened(site, poses)
        if epochs is not None:
            change, places, motions = what_changed(found, epochs)
        advance("drawing", 0.9)
        site_report.write(
            output,
            found.site,
            found.registration,
            found.cloud,
            change=change,
            places=places,
            motions=motions,
            overwrite=overwrite,
        )
    print(f"{output}: {len(found.site.scan)} scans, {len(places)} places that changed")
