"""List of the sample data, their content, and copies of them."""

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
    """Set of sample data in the package.

    Examples
    --------
    >>> from amulor import samples
    >>> ladder = samples.sample("ladder")
    >>> print(ladder.title)
    A painted ladder in water with milk, at 39 MHz in the channels VV and VH
    >>> ladder.files
    ('ladder.nc',)
    """

    name: str
    """Name of the sample."""
    title: str
    """Title of the sample."""
    files: tuple[str, ...]
    """Names of the files."""
    origin: str
    """Origin: measured, simulated or acquired with simulated devices, with source."""
    licence: str
    """SPDX identifier of the license."""
    shows: str
    """Purpose of the sample data."""
    commands: tuple[str, ...]
    """Example commands, in the folder of the copies."""
    folder: str = ""
    """Folder of the files within the package data."""

    @property
    def size(self) -> int:
        """Total size of the files [bytes]."""
        return sum(len(self.read(name)) for name in self.files)

    def read(self, name: str) -> bytes:
        """Return the content of one of the files.

        Parameters
        ----------
        name : str
            File name, an item of `files`.

        Returns
        -------
        bytes
            Content of the file.

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
    """Return all sets of sample data by name.

    Returns
    -------
    dict of str to Sample
        Sample data by name, in the order of a course.

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
            title=sample["title"],
            files=tuple(sample["files"]),
            origin=sample["origin"],
            licence=sample["licence"],
            shows=sample["shows"],
            commands=tuple(sample["commands"]),
            folder=sample.get("folder", ""),
        )
        for name, sample in listed.items()
    }


def sample(name: str) -> Sample:
    """Return a set of sample data by its name.

    Parameters
    ----------
    name : str
        Name of the sample data, such as "ladder".

    Returns
    -------
    Sample
        Sample data, with files and suggestions.

    Raises
    ------
    ValueError
        If there are no sample data of this name; the message lists all names.

    Examples
    --------
    >>> from amulor import samples
    >>> samples.sample("foam-letter-u").licence
    'MIT'
    """
    try:
        return samples()[name]
    except KeyError:
        names = ", ".join(samples())
        raise ValueError(
            f"there are no sample data {name!r}; there are {names}"
        ) from None


def cube(name: str) -> xr.Dataset:
    """Load a sample cube.

    Parameters
    ----------
    name : str
        Name of sample data with a cube, such as "ladder".

    Returns
    -------
    xarray.Dataset
        New copy of the cube, as from `amulor.read_cube`.

    Raises
    ------
    ValueError
        If there are no sample data of this name, or they have no cube.

    Examples
    --------
    >>> from amulor import samples
    >>> samples.cube("ladder").sizes["column"]
    100
    """
    return _read(sample(name)).copy(deep=True)


@cache
def _read(sample: Sample) -> xr.Dataset:
    from amulor.io import read_cube

    file = sample.files[0]
    if not file.endswith(".nc"):
        raise ValueError(
            f"sample data {sample.name!r} are not a cube but "
            f"{', '.join(sample.files)}; write them by amulor.samples.copy "
            "and import them as their commands say"
        )
    with resources.as_file(_data().joinpath(sample.folder, file)) as path:
        return read_cube(path)


def copy(
    name: str, folder: str | os.PathLike[str] = ".", *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Copy the files of a set of sample data into a folder.

    Parameters
    ----------
    name : str
        Name of the sample data, such as "ladder".
    folder : path-like
        Folder for the files; it is created if it does not exist.
    overwrite : bool
        Whether existing files are replaced.

    Returns
    -------
    tuple of pathlib.Path
        Paths of the written files.

    Raises
    ------
    ValueError
        If there are no sample data of this name.
    FormatError
        If a file is there already, and nothing is written then, or the folder cannot be
        written.

    Examples
    --------
    >>> from amulor import read_cube, samples
    >>> [path] = samples.copy("ladder", "course")  # doctest: +SKIP
    >>> cube = read_cube(path)  # doctest: +SKIP
    """
    chosen = sample(name)
    place = Path(folder)
    paths = tuple(place / file for file in chosen.files)
    existing = [str(path) for path in paths if path.exists()]
    if existing and not overwrite:
        raise FormatError(
            f"{', '.join(existing)} is there already; choose another folder, or allow "
            "to overwrite it"
        )
    make_folder(place)
    for path in paths:
        with atomic_output(path, overwrite=overwrite) as temporary:
            temporary.write_bytes(chosen.read(path.name))
    return paths
