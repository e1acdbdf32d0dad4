"""`amulor run`: all scans of a site, on this computer or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def run(
    site: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    scheduler: str | None = None,
    workers: int | None = None,
    tile_rows: int | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Process all scans of a site to range images and clouds, here or on a cluster.

    Parameters
    ----------
    site
        Site file (TOML).
    output
        Folder for the results, with a folder for each scan. Results of earlier runs
        from the same files are used again.
    scheduler
        Address of a dask scheduler, such as tcp://node1:8786, or "local" for processes
        on this computer. By default scans are processed one after the other. Workers
        need access to the site's files and to the output folder.
    workers
        Number of processes for "--scheduler local"; by default one per processor.
    tile_rows
        Process this many rows at a time, on a cluster as one task. By default a cluster
        divides scans of more than 2.1 million samples.
    json
        Print the digests of all files as JSON.
    """
    from dataclasses import asdict

    from amulor.cli._arguments import UsageError, check_tile_rows
    from amulor.cli._output import print_json, progress_bar
    from amulor.errors import CubeError
    from amulor.scale.site_run import run_site
    from amulor.scale.tasks import LOCAL

    if workers is not None and (workers < 1 or scheduler != LOCAL):
        raise UsageError("--workers is a number from 1 on, with --scheduler local")
    check_tile_rows(tile_rows)
    with progress_bar(quiet=json):
        results = run_site(
            site, output, scheduler=scheduler, workers=workers, tile_rows=tile_rows
        )
    if json:
        print_json({"output": str(output), "scans": [asdict(scan) for scan in results]})
    else:
        for scan in results:
            unchanged = len(scan.files) - len(scan.made)
            print(f"{scan.name}: {len(scan.made)} files made, {unchanged} were there")
    wrong = [f"{scan.name}: {scan.error}" for scan in results if scan.error]
    if wrong:
        raise CubeError(
            f"{len(wrong)} of {len(results)} scans stopped: {'; '.join(wrong)}"
        )
