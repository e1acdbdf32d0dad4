"""Reading and writing of whole files, with one-line messages on failure."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from amulor.errors import FormatError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a file into memory."""
    path = Path(path)
    try:
        if path.is_dir():
            raise FormatError(f"{path} is a folder; name a file in it")
        if not path.exists():
            raise FormatError(f"{path} does not exist; check the name and the folder")
        if not path.is_file():
            raise FormatError(f"{path} is a device or a pipe; name a regular file")
        content = path.read_bytes()
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {_reason(error)}; check its permissions and "
            "the disk, or take a copy of it"
        ) from error
    if not content:
        raise FormatError(f"{path} is empty; copy it again, or make it again")
    return content


def make_folder(path: str | os.PathLike[str]) -> None:
    """Create a folder for output unless it exists.

    Parameters
    ----------
    path : path-like
        Folder to create; its parent folder must exist.

    Raises
    ------
    FormatError
        If a file has this name, or if the folder cannot be created or written to.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor import io
    >>> io.make_folder("clouds")
    >>> list(Path("clouds").iterdir())
    []
    """
    path = Path(path)
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be made: {_reason(error)}; name a folder that can be "
            "written, inside one that exists"
        ) from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise FormatError(f"{path} cannot be written; name another folder")


@contextlib.contextmanager
def atomic_output(
    path: str | os.PathLike[str], *, overwrite: bool = False
) -> Iterator[Path]:
    """Write a file under a temporary name; rename it when it is complete.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_output(Path(folder) / "note.txt") as temporary:
    ...         _ = temporary.write_text("whole")
    ...     print((Path(folder) / "note.txt").read_text())
    whole
    """
    path = Path(path)
    target = _target(path, overwrite=overwrite)
    temporary = target.with_name(f".amulor-{secrets.token_hex(8)}{target.suffix}")
    try:
        # Created here, so that its permissions follow the umask, whatever library
        # writes it.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        _synchronise(temporary)
        if target.exists():
            shutil.copymode(target, temporary)
        os.replace(temporary, target)
        synchronise_folder(target.parent)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be written: {_reason(error)}; free some space or choose "
            "another folder"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_output(
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    inputs: Sequence[str | os.PathLike[str]] = (),
) -> None:
    """Check that an output file can be written, before a long computation.

    Parameters
    ----------
    path : path-like
        File to be written.
    overwrite : bool
        Whether an existing file may be replaced.
    inputs : sequence of path-like
        Input files, which are never replaced.

    Raises
    ------
    FormatError
        If the file exists and must not be replaced, is an input, or has no folder.

    Examples
    --------
    >>> from amulor import io
    >>> io.check_output("scan.nc", inputs=["scan.nc"])  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    amulor.errors.FormatError: scan.nc is what is read; choose another name for ...
    """
    path = Path(path)
    for source in inputs:
        if os.path.realpath(source) == os.path.realpath(path):
            raise FormatError(
                f"{path} is what is read; choose another name for what is written"
            )
    _target(path, overwrite=overwrite)


def _target(path: Path, *, overwrite: bool) -> Path:
    try:
        target = Path(os.path.realpath(path))
        if target.is_dir():
            raise FormatError(f"{path} is a folder; name a file in it")
        if path.is_symlink() and not os.path.lexists(target):
            raise FormatError(
                f"{path} is a link to {target}, which does not exist; remove the link, "
                "or choose another name"
            )
        if not target.parent.is_dir():
            raise FormatError(
                f"{path} cannot be written: there is no folder {path.parent}; make it "
                "first"
            )
        if os.path.lexists(target):
            if not target.is_file():
                raise FormatError(
                    f"{path} is a device, a pipe or a link to itself; name a regular "
                    "file"
                )
            if not overwrite:
                raise FormatError(
                    f"{path} exists already; choose another name, or replace it with "
                    "--overwrite"
                )
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise FormatError(f"{str(path)!r} is no name for a file: {error}") from error
    return target


def _synchronise(path: Path) -> None:
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def synchronise_folder(folder: Path) -> None:
    """Flush a folder's list of files to disk, if the operating system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _reason(error: OSError) -> str:
    return error.strerror or " ".join(str(error).split()) or type(error).__name__


def load_hdf5() -> None:
    """Import the netCDF library; raise a `FormatError` with the reason if it fails."""
    try:
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
    except Exception as error:  # compiled parts that do not fit raise many kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(
            "h5py, which reads and writes netCDF, does not run in this Python with "
            f"numpy {version('numpy')}: {reason}; the file is not to blame: install "
            "both again, pip install --upgrade --force-reinstall numpy h5py h5netcdf"
        ) from error
