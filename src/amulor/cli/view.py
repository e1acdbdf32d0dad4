"""`amulor view`: a file or a running scan in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from amulor.view.page import Live, Recording
    from amulor.view.page.space import Space


def view(
    path: Path,
    /,
    *,
    samples: Path | None = None,
    unit: Literal["m", "cm", "mm", "inch"] | None = None,
    against: Path | None = None,
    poses: Path | None = None,
    save: Path | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    host: str = "127.0.0.1",
    port: Annotated[int, Parameter(validator=validators.Number(gte=0, lt=65536))] = 0,
    browser: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Show a file or scan in a browser: maps, 3D, measurements with uncertainties.

    Parameters
    ----------
    path
        File or folder to show. Range image, target signal or samples (netCDF); folder
        of a running scan; point cloud (.ply, .laz, .las, .e57, .xyz, .csv, .txt, .asc,
        .pts, .nc); mesh (.ply, .stl, .obj, .off, .glb); or site of several scans
        (.toml).
    samples
        Samples or target signal from which a range image was made, to show it before
        rejection, too.
    unit
        Unit of the coordinates of a mesh, which most formats do not state, or of a
        cloud that is not in meters.
    against
        Reference of which the page shows deviations: a mesh (.ply, .stl, .obj, .off,
        .glb; state --unit) in the axes of the instrument, or the range image (.nc) of
        another scan, placed by the poses of both surveys.
    poses
        Registration of a site (JSON), from "amulor site register". By default the site
        is registered first.
    save
        Save the page as one file (HTML), which opens without this program, and exit.
    nearest
        Nearest possible slant range, such as "0.5 m"; with --farthest.
    farthest
        Farthest possible slant range, such as "3 m"; with --nearest.
    host
        Network address on which the page listens. Any address except 127.0.0.1 admits
        other computers that know the page's URL with its token; nothing is encrypted.
    port
        Port of the page; by default any free port.
    browser
        Open the page in the browser of this computer.
    overwrite
        With --save: replace an existing file.
    """
    from amulor import _extras
    from amulor.cli._arguments import (
        UsageError,
        check_ending,
        check_inputs,
        interval_of,
    )

    if save is None:  # a page saved as one file has no server
        _extras.require("view", purpose="the page")
    if save is not None:
        check_ending("--save", save, (".html", ".htm"))
    if all(
        option is None for option in (samples, nearest, farthest, against, unit, poses)
    ):
        check_inputs(path)

    from amulor import handover, io
    from amulor.survey.target import METRES
    from amulor.view import page
    from amulor.view.page import space

    interval = interval_of(nearest, farthest)
    is_site = path.suffix.lower() == ".toml" and not path.is_dir()
    if poses is not None and not is_site:
        raise UsageError("--poses goes with a site file (.toml)")
    in_space = is_site or space.is_space(path)
    if in_space and not (samples is None and interval is None and against is None):
        raise UsageError(
            "--samples, --against, --nearest and --farthest go with a range image or a "
            "cube, not with a cloud or a mesh"
        )
    in_meters = against is None or against.suffix.lower() == ".nc"
    if unit is not None and not in_space and in_meters:
        raise UsageError("--unit goes with a mesh or a cloud; scans are in meters")
    if unit is not None and is_site:
        raise UsageError("--unit goes with a mesh or a cloud; sites are in meters")
    options = (path, samples, against, poses)
    inputs = [option for option in options if option is not None]
    check_inputs(against, poses)
    if save is not None:
        io.check_output(save, overwrite=overwrite, inputs=inputs)
    shown: Recording | Live | Space
    if is_site:
        shown = _site(path, poses)
    elif in_space:
        shown = space.opened(path, unit=None if unit is None else METRES[unit])
    else:
        shown = _shown(path, samples, interval)
        if against is not None:
            shown.against = handover.comparison(against, unit=unit or "m")
        if isinstance(shown, page.Live):
            shown.look()
    if save is not None:
        recording = shown.recording if isinstance(shown, page.Live) else shown
        page.save_page(recording, save, overwrite=overwrite)
        print(f"{save}: one page, {save.stat().st_size / 1e6:.1f} MB")
        return

    from amulor.cli._output import announcing

    products = handover.PageProducts(against=against, unit=unit or "m")
    page.serve(
        shown, host=host, port=port, products=products,
        announce=announcing(f"{path}: ", browser=browser),
    )  # fmt: skip


def _site(path: Path, poses: Path | None) -> Space:
    """Open a site: register it if needed, merge its scans, compare its visits."""
    from amulor.cli._output import progress_bar
    from amulor.cli.site import changes_between, epochs_of, opened, region_sentence
    from amulor.view.page.sites import site_space

    with progress_bar():
        merged = opened(path, poses)
        change, sentences = None, []
        if len(merged.site.epoch) > 1:
            epochs = epochs_of(merged.site, None, None)
            change, places, motions = changes_between(merged, epochs)
            sentences = [
                region_sentence(number, place, motions)
                for number, place in enumerate(places)
            ]
    shown = site_space(
        merged.cloud, merged.registration, change=change, regions=sentences
    )
    shown.path = path
    return shown


def _shown(
    path: Path, samples: Path | None, interval: tuple[float, float] | None
) -> Recording | Live:
    """Open a file or a running scan for the page."""
    from amulor.view import page

    if not path.is_dir():
        return page.opened(path, samples=samples, interval=interval)
    return page.Live(path)
