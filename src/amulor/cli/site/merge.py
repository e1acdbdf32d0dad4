"""`amulor site merge`: one cloud of all scans, with errors, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


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
        Registration (JSON), from `amulor site register`.
    output
        Folder of LAZ tiles to make, or a file with the ending .e57.
    tile
        Side of a tile, such as "5 m".
    json
        Print the figures as JSON.
    overwrite
        Replace files that are there.
    """
    from amulor import io
    from amulor._extras import require
    from amulor.cli._arguments import quantity_of
    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.cli.site._results import opened
    from amulor.site.merging.clouds import scan_clouds
    from amulor.site.merging.tiles import write_tiles

    as_e57 = output.suffix.lower() == ".e57"
    require("e57" if as_e57 else "export", purpose="merging")
    size = quantity_of("--tile", tile, "length")
    if as_e57:
        io.check_output(output, overwrite=overwrite, inputs=[site, poses])
    with progress_bar(quiet=json) as advance:
        found = opened(site, poses)
        advance(f"writing {output}", 0.8)
        if as_e57:
            clouds = scan_clouds(found.cloud, found.registration, found.images)
            io.write_e57_scans(clouds, output, overwrite=overwrite)
            files = [output]
        else:
            files = write_tiles(found.cloud, output, size=size, overwrite=overwrite)
    cloud = found.cloud
    moving = {
        one.name: int(cloud.moving[cloud.scan == number].sum())
        for number, one in enumerate(found.site.scan)
    }
    if json:
        print_json(
            {
                "files": files,
                "points": len(cloud.position),
                "moving_points": moving,
                "median_uncertainty_m": _median(cloud.sigma),
                "seen_by_several": float((cloud.confirmed > 0).mean()),
            }
        )
        return
    for name, count in moving.items():
        if count:
            print(f"{name}: {count} points that other scans see through, marked")
    east, north, up = (1e3 * v for v in _median(cloud.sigma))
    print(
        f"{output}: {len(cloud.position)} points in {len(files)} "
        f"file{'s' if len(files) > 1 else ''}, {(cloud.confirmed > 0).mean():.0%} seen "
        f"by several scans, median uncertainty {east:.2f}, {north:.2f}, {up:.2f} mm"
    )
    print_next(f"amulor view {files[0]}")


def _median(values: object) -> list[float]:
    import numpy as np

    return [float(v) for v in np.median(np.asarray(values), axis=0)]
