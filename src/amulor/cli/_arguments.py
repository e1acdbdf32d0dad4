"""Options shared by several commands, and usage errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from cyclopts import validators

from amulor._hdf5 import check_small
from amulor._las import check_counts
from amulor.errors import AmulorError, FormatError

#: Seeds that a generator takes and a file keeps.
SEED = validators.Number(gte=0, lt=2**63)


class UsageError(AmulorError):
    """Wrong value or combination of options; exit code 2."""


@contextmanager
def refusing(option: str = "") -> Iterator[None]:
    """Convert a `ValueError` of a public function to a usage error.

    Parameters
    ----------
    option : str
        Name of the option, such as "--distance", to put before the message; empty if
        the message names the argument.

    Raises
    ------
    UsageError
        If the block raises a `ValueError`.
    """
    try:
        yield
    except ValueError as error:
        raise UsageError(f"{option}: {error}" if option else str(error)) from None


def quantity_of(option: str, text: str, quantity: str) -> float:
    """Parse an option with a number and a unit; return the value in SI units.

    Parameters
    ----------
    option : str
        Name of the option, such as "--distance".
    text : str
        Text that the user gave.
    quantity : str
        Physical quantity, a key of `amulor.units.SI_UNITS`.

    Returns
    -------
    float
        Value in SI units.

    Raises
    ------
    UsageError
        If the text is not a number with a unit of this quantity.
    """
    from amulor import units

    with refusing(option):
        return units.parse(text, quantity)


def frequencies_of(option: str, text: str) -> list[float]:
    """Parse an option with modulation frequencies, a list or a range [Hz].

    Parameters
    ----------
    option : str
        Name of the option.
    text : str
        List of frequencies, or first, last and number; see
        `amulor.units.parse_frequencies`.

    Returns
    -------
    list of float
        Frequencies [Hz].

    Raises
    ------
    UsageError
        If the text is invalid, or a frequency is below 0 Hz.
    """
    from amulor import units

    with refusing(option):
        frequencies = units.parse_frequencies(text)
        if min(frequencies) < 0:
            raise ValueError(
                f"modulation_frequency must be at least 0 Hz, got {min(frequencies):g}"
                " Hz"
            )
    return frequencies


def row_and_column(
    pixel: str, *, error: type[AmulorError] = UsageError
) -> tuple[int, int]:
    """Parse the option --pixel; raise `error` for another form."""
    try:
        row, column = (int(part) for part in pixel.split(","))
    except ValueError:
        raise error(
            f"--pixel: {pixel!r} is no row and column; state two whole numbers with a "
            "comma between them, such as 20,50"
        ) from None
    return row, column


def interval_of(
    nearest: str | None, farthest: str | None
) -> tuple[float, float] | None:
    """Parse the options --nearest and --farthest; None without them [m].

    Parameters
    ----------
    nearest, farthest : str, optional
        Lengths with a unit; both or none.

    Returns
    -------
    tuple of float, or None
        Nearest and farthest slant range [m].

    Raises
    ------
    UsageError
        If one option is missing, is not a length, or the range is not above 0 m.
    """
    if (nearest is None) != (farthest is None):
        raise UsageError("--nearest and --farthest must be given together")
    if nearest is None or farthest is None:
        return None
    near = quantity_of("--nearest", nearest, "length")
    far = quantity_of("--farthest", farthest, "length")
    if not 0 <= near < far:
        raise UsageError(
            "--nearest, --farthest: the interval must run from at least 0 m to a "
            f"larger range, got {near:g} to {far:g} m"
        )
    return near, far


def gate_of(text: str | None) -> tuple[float, float] | None:
    """Parse the option --gate, two increasing times; None without it [s].

    Parameters
    ----------
    text : str, optional
        Two times with units and a comma between them.

    Returns
    -------
    tuple of float, or None
        First and last time [s].

    Raises
    ------
    UsageError
        If the text is not two increasing times.
    """
    if text is None:
        return None
    times = [quantity_of("--gate", part, "time") for part in text.split(",")]
    if len(times) != 2 or not times[0] < times[1]:
        raise UsageError(
            f'--gate must be two increasing times, such as "10ns,40ns", got {text!r}'
        )
    return times[0], times[1]


def check_inputs(*paths: Path | None) -> None:
    """Raise if an input does not exist, or declares too much, before slow imports.

    Parameters
    ----------
    *paths : pathlib.Path, optional
        Input files or folders.

    Raises
    ------
    FormatError
        If an input does not exist, or declares more than it can hold.
    """
    for path in filter(None, paths):
        if not path.exists():
            raise FormatError(f"{path} does not exist; check the name and the folder")
        if path.suffix.lower() in CUBE_ENDINGS:
            check_small(path)
        elif path.suffix.lower() in (".las", ".laz"):
            check_counts(path)


#: Endings of netCDF files, which cubes are written to.
CUBE_ENDINGS = (".nc", ".nc4")


def check_cube_output(path: Path, *, overwrite: bool, inputs: Sequence[Path]) -> None:
    """Raise if an output file cannot be written as a cube, before a computation.

    Parameters
    ----------
    path : pathlib.Path
        Value of the option `--output`.
    overwrite : bool
        Whether an existing file may be replaced.
    inputs : sequence of pathlib.Path
        Input files, which must never be replaced.

    Raises
    ------
    FormatError
        As `amulor.io.check_output`, or if a file to be read does not exist.
    UsageError
        If the ending is not that of netCDF.
    """
    if path.suffix.lower() in CUBE_ENDINGS:
        check_inputs(*inputs)

    from amulor import io

    io.check_output(path, overwrite=overwrite, inputs=inputs)
    check_ending("--output", path, CUBE_ENDINGS)


def check_tile_rows(rows: int | None) -> None:
    """Raise if the number of rows of a tile is below 1."""
    if rows is not None and rows < 1:
        raise UsageError(f"--tile-rows must be 1 or more, got {rows}")


def check_ending(option: str, path: Path, endings: Sequence[str]) -> None:
    """Raise if a file name does not end in one of the supported formats.

    Parameters
    ----------
    option : str
        Name of the option with the file name.
    path : pathlib.Path
        File name.
    endings : sequence of str
        Allowed endings with their dot, in lower case.

    Raises
    ------
    UsageError
        If the file name has another ending.
    """
    if path.suffix.lower() not in endings:
        raise UsageError(
            f"{option} {path}: the ending says the format; use one of "
            f"{', '.join(endings)}"
        )


def channel_of(text: str | None) -> str | None:
    """Return a channel name in capitals; "none" (unpolarized) stays as it is."""
    return text.upper() if text and text != "none" else text
