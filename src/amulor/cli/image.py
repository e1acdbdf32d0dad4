"""`amulor image`: range image of a target signal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter


def image(
    cube: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    polarization: str | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compute a range image from a target signal.

    Parameters
    ----------
    cube
        Target signal (netCDF), from "amulor reject".
    output
        File to write (netCDF).
    polarization
        Channel to use, such as VH; needed if there are several.
    nearest
        Nearest possible slant range, such as "0.5 m"; with --farthest.
    farthest
        Farthest possible slant range, such as "3 m"; with --nearest.
    tile_rows
        Process this many rows at a time, with bounded memory. Files of more than 2.1
        million samples are always processed by rows.
    overwrite
        Replace an existing file.
    """
    from amulor.cli._arguments import (
        channel_of,
        check_cube_output,
        check_tile_rows,
        interval_of,
    )
    from amulor.cli._output import print_flags, print_next, progress_bar

    interval = interval_of(nearest, farthest)
    check_tile_rows(tile_rows)
    check_cube_output(output, overwrite=overwrite, inputs=[cube])

    from amulor import pipeline
    from amulor.cube import error_unknown
    from amulor.imaging.instrument_tests import instrument_tests

    with progress_bar():
        summary = pipeline.image_file(
            cube, output, rows=tile_rows, overwrite=overwrite,
            polarization=channel_of(polarization), interval=interval,
        )  # fmt: skip
    if not summary.usable:
        print(
            f"{output}: range image without a usable pixel; see: amulor info {output}"
        )
        return
    if "interval_unsettled" in summary.head.attrs:
        print(_unsettled(output, summary.head.attrs))
        return
    words = str(summary.head.attrs.get("error_unknown", ""))
    if summary.whole is not None:
        median = float(summary.whole["slant_range_uncertainty"].median())
        words = (
            error_unknown(summary.whole) or f"median uncertainty {median * 1e3:.2f} mm"
        )
    print(
        f"{output}: range image, {summary.usable / summary.count:.1%} of the pixels "
        f"usable ({summary.doubtful / summary.count:.1%} flagged)"
        + (f", {words}" if words else "")
    )
    print_flags(summary.flags, summary.count)
    for test in instrument_tests(summary.head):
        print(f"  instrument: {test.result}; see: amulor info {output}")
    print_next(f"amulor view {output}")


def _unsettled(output: Path, attributes: Mapping[Any, Any]) -> str:
    from amulor.cube import WATER_NOT_REMOVED

    water = str(attributes.get("error_unknown", "")).startswith(WATER_NOT_REMOVED)
    return (
        f"{output}: ranges relative to an unknown number of intervals, all pixels "
        f"flagged: {attributes['interval_unsettled']}; state --nearest and --farthest, "
        "no farther apart than the phases repeat"
        + (f"; {WATER_NOT_REMOVED}" if water else "")
    )
