"""What sample data there are, where they are, and copies of them."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from amulor.errors import FormatError
from amulor.io.files import atomic_output, make_folder

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Sample", "copy", "cube", "sample", "samples"]

_LISTING = "samples.toml"


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Data that come with the package.

    Examples
    --------
    >>> from amulor import samples
    >>> ladder = samples.sample("ladder")
    >>> print(ladder.title)
    A painted ladder in milky water, 39 MHz, VV and VH
    >>> ladder.files
    ('ladder.nc',)
    """

    name: str
    """What it is asked for by."""
    title: str
    """What it is."""
    files: tuple[str, ...]
    """Names of its files."""
    origin: str
    """Measured, simulated or acquired with simulated devices, and how or by whom."""
    licence: str
    """SPDX identifier."""
    shows: str
    """What can be learned from it."""
    commands: tuple[str, ...]
    """What to try, in the folder of the copies."""
    folder: str = ""
    """Folder of its files inside the data of the package."""

    @property
    def size(self) -> int:
        """Size of all its files [bytes]."""
        return sum(len(self.read(name)) for name in self.files)

    def read(self, name: str) -> bytes:
        """Return the content of one of its files.

        Parameters
        ----------
        name : str
            One of `files`.

        Returns
        -------
        bytes
            As the file has them.

        Raises
        ------
        ValueError
            If the sample has no such file.
        """
        if name not in self.files:
            raise ValueError(
                f"sample {self.name!r} has no file {name!r}; it has "
                f"{', '.join(self.files)}"
            )
        return self._place().joinpath(name).read_bytes()

    def _place(self) -> Traversable:
        place = _data()
        return place.joinpath(self.folder) if self.folder else place


def _data() -> Traversable:
    return resources.files("amulor.samples").joinpath("data")


@cache
def samples() -> dict[str, Sample]:
    """Return all sample data by their names.

    Returns
    -------
    dict of str to Sample
        In the order in which a course would use them.

    Examples
    --------
    >>> from amulor.samples import samples
    >>> list(samples())[0]
    'ladder'
    """
    listed = tomllib.loads(_data().joinpath(_LISTING).read_text("utf-8"))
    return {
        name: Sample(
            name=name,
            title=one["title"],
            files=tuple(one["files"]),
            origin=one["origin"],
            licence=one["licence"],
            shows=one["shows"],
            commands=tuple(one["commands"]),
            folder=one.get("folder", ""),
        )
        for name, one in listed.items()
    }


def sample(name: str) -> Sample:
    """Return sample data by name.

    Parameters
    ----------
    name : str
        Such as "ladder".

    Returns
    -------
    Sample
        With the files and what to try.

    Raises
    ------
    ValueError
        If there is none of that name; the message lists all.

    Examples
    --------
    >>> from amulor import samples
    >>> samples.sample("foam-letter-u").licence
    'MIT'
    """
    try:
        return samples()[name]
    except KeyError:
        known = ", ".join(samples())
        raise ValueError(
            f"there are no sample data {name!r}; there are {known}"
        ) from None


def cube(name: str) -> xr.Dataset:
    """Return a sample cube, ready to work with; nothing is written.

    Parameters
    ----------
    name : str
        Sample data that are a cube, such as "ladder".

    Returns
    -------
    xarray.Dataset
        A copy of its own for each call, as `amulor.read_cube` gives it.

    Raises
    ------
    ValueError
        If there is none of that name, or if it is no cube.

    Examples
    --------
    >>> from amulor import samples
    >>> samples.cube("ladder").sizes["column"]
    100
    """
    return _read(sample(name)).copy(deep=True)


@cache
def _read(found: Sample) -> xr.Dataset:
    from amulor.io import read_cube

    file = found.files[0]
    if not file.endswith(".nc"):
        raise ValueError(
            f"sample data {found.name!r} are not a cube but {', '.join(found.files)}; "
            "write them by amulor.samples.copy and import them as their commands say"
        )
    with resources.as_file(_data().joinpath(found.folder, file)) as path:
        return read_cube(path)


def copy(
    name: str, folder: str | os.PathLike[str] = ".", *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write the files of sample data into a folder.

    Parameters
    ----------
    name : str
        Such as "ladder".
    folder : path-like
        Made if it is not there.
    overwrite : bool
        Replace files that are there.

    Returns
    -------
    tuple of pathlib.Path
        What was written.

    Raises
    ------
    ValueError
        If there are no such data.
    FormatError
        If a file is there already, and nothing is written then, or the folder cannot be
        written.

    Examples
    --------
    >>> from amulor import read_cube, samples
    >>> [path] = samples.copy("ladder", "course")  # doctest: +SKIP
    >>> cube = read_cube(path)  # doctest: +SKIP
    """
    found = sample(name)
    place = Path(folder)
    paths = tuple(place / file for file in found.files)
    there = [str(path) for path in paths if path.exists()]
    if there and not overwrite:
        raise FormatError(
            f"{', '.join(there)} is there already; choose another folder, or allow to "
            "overwrite it"
        )
    make_folder(place)
    for path in paths:
        with atomic_output(path, overwrite=overwrite) as temporary:
            temporary.write_bytes(found.read(path.name))
    return paths
