"""`amulor reject`: subtraction of the water signal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from amulor import _plugins

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import xarray as xr

    from amulor.rejection import Comparison

    Name = str
else:  # choices of the help, those of other packages among them
    Name = Literal[_plugins.names(_plugins.REJECTION)]


def reject(
    cube: Path,
    /,
    *,
    method: Name,
    output: Annotated[Path, Parameter(alias="-o")],
    open_water: Path | None = None,
    target_ratio: float | None = None,
    water_ratio: float | None = None,
    water_fluctuation: str | None = None,
    frequency: str | None = None,
    column_uncertainty: str | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    option: Annotated[list[str] | None, Parameter(negative="")] = None,
    tile_rows: int | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Subtract the water signal from a measurement cube.

    Parameters
    ----------
    cube
        Measurement cube (netCDF).
    method
        Rejection method. "auto" compares all methods that the data allow and uses the
        best; "none" keeps the water signal, for comparison.
    output
        File to write (netCDF).
    open_water
        Cube of the same water without a target, for cubes without open-water shots.
    target_ratio
        Cross- over co-polarized signal of the target, for polarization,
        polarization-difference and combined; estimated by default.
    water_ratio
        Cross- over co-polarized signal of the water, for polarization and
        polarization-difference; estimated by default.
    water_fluctuation
        Relative change of the water signal between samples, such as "5 %", for
        polarization without open-water shots.
    frequency
        Modulation frequency to keep, such as "39 MHz", for the method "frequency"; by
        default the best one.
    column_uncertainty
        Relative uncertainty of the survey's water behind the target, such as "20 %",
        for the method "open-water". By default it is estimated from the open-water
        shots.
    nearest
        Nearest possible slant range, such as "0.5 m"; with --farthest.
    farthest
        Farthest possible slant range, such as "3 m"; with --nearest.
    option
        Further option of the method, such as "surface=nearest" of range-profile; may be
        repeated.
    tile_rows
        Process this many rows at a time, with bounded memory. Files of more than 2.1
        million samples are always processed by rows. The file of --open-water is read
        whole.
    json
        Print the result as JSON.
    overwrite
        Replace an existing file.
    """
    from amulor.cli._arguments import (
        UsageError,
        check_cube_output,
        check_tile_rows,
        interval_of,
        quantity_of,
    )
    from amulor.cli._output import print_json, progress_bar
    from amulor.errors import CubeError

    interval = interval_of(nearest, farthest)
    check_tile_rows(tile_rows)
    options = {
        "interval": interval,
        "target_ratio": target_ratio,
        "water_ratio": water_ratio,
        "water_fluctuation": _fraction("--water-fluctuation", water_fluctuation),
        "column_uncertainty": _fraction("--column-uncertainty", column_uncertainty),
        "modulation_frequency": None
        if frequency is None
        else quantity_of("--frequency", frequency, "frequency"),
        **_stated(option or []),
    }
    inputs = [cube] if open_water is None else [cube, open_water]
    check_cube_output(output, overwrite=overwrite, inputs=inputs)

    from amulor import pipeline, rejection

    chosen = rejection.load(method)
    if unused := chosen.unknown(options):
        raise UsageError(
            f"{method} does not use {_as_options(unused)}; it uses "
            f"{_as_options(chosen.options)}"
        )
    with progress_bar(quiet=json):
        try:
            summary = pipeline.reject_file(
                cube, output, method, rows=tile_rows, overwrite=overwrite,
                open_water=open_water, **options,
            )  # fmt: skip
        except ValueError as error:
            # The formulas refuse their arguments; without options these come from the
            # cube.
            given_options = any(value is not None for value in options.values())
            kind = UsageError if given_options else CubeError
            raise kind(str(error)) from None
    share = summary.flagged / max(summary.count, 1)
    if json:
        figures = _figures(output, method, summary.head, summary.comparison)
        print_json(figures | {"flagged_share": share, "flags": summary.flags})
        return
    if summary.comparison is not None:
        _print_comparison(summary.comparison)
    else:
        _print_choice(summary.head)
    _print_flags(output, share, summary.flags, max(summary.count, 1))


def _print_flags(
    output: Path, share: float, counts: Mapping[str, int], total: int
) -> None:
    """Print the share of flagged samples, and the next command."""
    from amulor.cli._output import print_flags, print_next

    print(f"{output}: target signal, {share:.1%} of the samples flagged")
    print_flags(counts, total)
    print_next(f"amulor image {output} -o range.nc")


def _fraction(option: str, text: str | None) -> float | None:
    """Parse an option with a fraction, such as "5 %"."""
    from amulor.cli._arguments import quantity_of

    return None if text is None else quantity_of(option, text, "fraction")


def _as_options(names: Iterable[str]) -> str:
    """Return the command-line names of a method's options."""
    flags = {"modulation_frequency": "--frequency", "interval": "--nearest, --farthest"}
    words = [
        flags.get(name, f"--{name.replace('_', '-')}")
        for name in names
        if name in flags or name in reject.__annotations__
    ]
    return ", ".join(words) or "no option"


def _stated(texts: list[str]) -> dict[str, Any]:
    """Parse options "name=value"; convert numeric values to numbers."""
    from amulor.cli._arguments import UsageError

    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip().isidentifier():
            raise UsageError(f'--option must be "name=value", got {text!r}')
        try:
            values[name.strip()] = float(value)
        except ValueError:
            values[name.strip()] = value
    return values


def _print_choice(target: xr.Dataset) -> None:
    """Print the reason for the chosen modulation frequency, and warnings, if any."""
    if "frequency_choice" in target.attrs:
        print(target.attrs["frequency_choice"])
        for warning in filter(None, target.attrs["frequency_warnings"].split("; ")):
            print(f"note: {warning}")


def _figures(
    output: Path, method: str, target: xr.Dataset, comparison: Comparison | None
) -> dict[str, Any]:
    """Return method, channels and reasons of a rejection for JSON."""
    from dataclasses import asdict

    figures: dict[str, Any] = {
        "output": str(output),
        "method": method,
        "polarizations": [str(name) for name in target["polarization"].values],
        "modulation_frequencies_hz": target["modulation_frequency"].values,
    }
    for name in ("frequency_choice", "frequency_warnings", "target_ratio"):
        if name in target.attrs:
            figures[name] = target.attrs[name]
    if comparison is not None:
        figures |= {
            "method": comparison.method,
            "reason": comparison.reason,
            "comparison": [asdict(row) for row in comparison.rows],
        }
    return figures


def _print_comparison(comparison: Comparison) -> None:
    from amulor.cli._output import print_table

    rows = []
    for row in comparison.rows:
        mark = "->" if row.recommended else ""
        if not row.polarization:
            continue
        rows.append(
            [
                f"{mark}{row.method}",
                row.polarization,
                _millimetres(row.bias),
                _millimetres(row.noise),
                f"{row.usable:.0%}",
                f"{row.flagged:.0%}",
                f"{row.trusted:.0%}",
            ]
        )
    header = ["method", "channel", "bias", "noise", "usable", "flagged", "trusted"]
    print_table("Rejection methods", header, rows)
    notes: dict[str, list[str]] = {}
    for row in comparison.rows:
        if row.note and not row.recommended:
            name = f"{row.method} {row.polarization}".strip()
            notes.setdefault(row.note, []).append(name)
    for note, names in notes.items():
        print(f"{', '.join(names)}: {note}")
    print(f"recommended: {comparison.reason}")


def _millimetres(value: float) -> str:
    import math

    return f"{value * 1e3:.3g} mm" if math.isfinite(value) else "unknown"
