"""What several site commands begin with: the site, its scans, its registration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from amulor.site import Site
    from amulor.site.change.distances import Change
    from amulor.site.change.moved import Motion
    from amulor.site.change.regions import Region
    from amulor.site.merging.cloud import Merged
    from amulor.site.registration.result import Registration
    from amulor.site.registration.surface import ScanSurface


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A site with all that was read of it."""

    site: Site
    registration: Registration
    surfaces: dict[str, ScanSurface]
    images: dict[str, xr.Dataset]
    cloud: Merged


def opened(path: Path, poses: Path) -> Opened:
    """Read a site and its registration, and merge its scans.

    Parameters
    ----------
    path : pathlib.Path
        Site file.
    poses : pathlib.Path
        Its registration.

    Returns
    -------
    Opened
        All of it.

    Raises
    ------
    CubeError
        If the registration lacks a scan of the site.
    """
    from amulor import _progress
    from amulor.errors import CubeError
    from amulor.site import Site
    from amulor.site.merging.cloud import merge
    from amulor.site.registration.register import surfaces_of
    from amulor.site.registration.result import read_registration

    site = Site.from_toml(path)
    registration = read_registration(poses)
    lacking = [one.name for one in site.scan if one.name not in registration.poses]
    if lacking:
        raise CubeError(
            f"{poses}: has no pose of scan {lacking[0]!r}; register the site again: "
            f"amulor site register {path} -o {poses} --overwrite"
        )
    with _progress.part(0.0, 0.3):
        surfaces, images = surfaces_of(site)
    with _progress.part(0.3, 0.6):
        cloud = merge(site, registration, surfaces, images)
    return Opened(
        site=site,
        registration=registration,
        surfaces=surfaces,
        images=images,
        cloud=cloud,
    )


def epochs_of(site: Site, first: str | None, second: str | None) -> tuple[str, str]:
    """Return the names of two visits that options name, or the first and the last.

    Parameters
    ----------
    site : Site
        Its visits.
    first, second : str, optional
        Names; both or none.

    Returns
    -------
    tuple of str
        Earlier and later visit.

    Raises
    ------
    UsageError
        If only one is named, or one is no visit of the site.
    """
    from amulor.cli._arguments import UsageError

    names = [one.name for one in site.epoch]
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
            listed = ", ".join(repr(one) for one in names)
            raise UsageError(f"{name!r} is no epoch of the site; there are {listed}")
    return first, second


def what_changed(
    found: Opened, epochs: tuple[str, str]
) -> tuple[Change, tuple[Region, ...], dict[int, Motion]]:
    """Return the change between two visits, its regions, and what moved in them.

    Parameters
    ----------
    found : Opened
        The site.
    epochs : tuple of str
        Earlier and later visit.

    Returns
    -------
    change : Change
        Point by point.
    regions : tuple of Region
        Places that changed.
    motions : dict of int to Motion
        By number of the region, where a rigid motion explains it.
    """
    import numpy as np

    from amulor import _progress
    from amulor.site.change.distances import change
    from amulor.site.change.moved import motion_of
    from amulor.site.change.regions import regions

    with _progress.part(0.6, 0.8):
        result = change(
            found.site, found.registration, found.surfaces, found.cloud, epochs=epochs
        )
    places = regions(result)
    motions = {}
    for number, place in enumerate(places):
        _progress.tell("fitting what moved", 0.8 + 0.1 * number / len(places))
        motion = motion_of(
            found.site,
            found.registration,
            found.surfaces,
            epochs=epochs,
            centre=place.centre,
            reach=float(np.clip(1.5 * place.reach, 0.05, 1.0)),
        )
        if motion is not None:
            motions[number] = motion
    return result, places, motions
