"""Reads photon histograms from npz files, or says in one line why it cannot."""

from __future__ import annotations

import io
import math
import os
import struct
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.cube import provenance
from amulor.errors import FormatError
from amulor.io.files import read_bytes

#: Metre in an inch, by definition.
_INCH = 0.0254
#: Bytes that one array of a file may take: more is damage, or a scan to be cut.
_LARGEST = 2**32
#: How damage of a zip archive or of an array in it shows itself.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    tokenize.TokenError,  # of the text before the numbers, which is Python
)
#: What bins of photon counters last [s].
_NARROWEST, _WIDEST = 1e-15, 1e-3
#: Photons in one bin: no counter has so many [1].
_MOST_COUNTS = 10**15
_NEEDED = (
    "needed is an npz file with whole-number 'counts' (rows, columns, bins) and "
    "'bin_width_s'"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Histograms:
    """Photon counts against time, as a file holds them.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import io
    >>> np.savez(
    ...     "photons.npz", counts=np.ones((2, 3, 100), dtype=int), bin_width_s=4e-12
    ... )
    >>> found = io.read_histograms("photons.npz")
    >>> found.name, found.bin_width
    ('photons.npz', 4e-12)
    """

    path: Path
    """File that they come from."""
    digest: str
    """SHA-256 of that file."""
    counts: NDArray[Any]
    """Photons per bin, dimensions (scene, row, column, bin) [1]."""
    bin_width: float
    """Length of a time bin [s]."""
    labels: tuple[str, ...]
    """What the file calls its scenes; empty if it has no names for them."""
    thickness: NDArray[np.float64] | None
    """Thickness of the slab, over the columns, if these are slabs [m]."""
    direct_counts: NDArray[Any] | None
    """Photons per bin without a slab, if the file has them [1]."""

    @property
    def name(self) -> str:
        """Name of the file without its folder."""
        return self.path.name


def read_histograms(path: str | os.PathLike[str]) -> Histograms:
    """Read the photon histograms of an npz file.

    Parameters
    ----------
    path : path-like
        File with `bin_width_s` and with whole-number `counts` of one of the shapes
        (rows, columns, bins); (scenes, rows, columns, bins), with
        `distance_label` (scenes) or without; (slabs, bins), with `thickness_inch`
        (slabs) and, if there is one, the histogram `direct_counts` (bins) without a
        slab.

    Returns
    -------
    Histograms
        What it holds, checked.

    Raises
    ------
    FormatError
        If the file is missing, empty, damaged or foreign, or if a field is missing
        or not what it must be.

    Notes
    -----
    Arrays are read as plain numbers: Python objects in a file are refused, not
    loaded.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import io
    >>> np.savez(
    ...     "photons.npz", counts=np.ones((2, 3, 100), dtype=int), bin_width_s=4e-12
    ... )
    >>> io.read_histograms("photons.npz").counts.shape
    (1, 2, 3, 100)
    """
    path = Path(path)
    content = read_bytes(path)
    fields = _arrays(path, content)
    for name in ("counts", "bin_width_s"):
        if name not in fields:
            raise FormatError(f"{path}: field '{name}' is missing; {_NEEDED}")
    counts = _counts(path, fields, "counts")
    thickness = None
    if counts.ndim == 2:
        thickness = _thickness(path, fields, slabs=counts.shape[0])
        counts = counts[np.newaxis]
    elif counts.ndim not in (3, 4):
        raise FormatError(
            f"{path}: field 'counts' has shape {counts.shape}; needed is (rows, "
            "columns, bins), (scenes, rows, columns, bins), or (slabs, bins) with "
            "'thickness_inch'"
        )
    counts = counts if counts.ndim == 4 else counts[np.newaxis]
    if counts.shape[-1] < 2:
        raise FormatError(
            f"{path}: field 'counts' has {counts.shape[-1]} bin per histogram, needed "
            "are at least 2; its last dimension must be time"
        )
    direct = (
        _counts(path, fields, "direct_counts") if "direct_counts" in fields else None
    )
    if direct is not None and direct.shape != counts.shape[-1:]:
        raise FormatError(
            f"{path}: field 'direct_counts' has shape {direct.shape}, needed is one "
            f"histogram of {counts.shape[-1]} bins, as in 'counts'"
        )
    return Histograms(
        path=path,
        digest=provenance.digest(content),
        counts=counts,
        bin_width=_bin_width(path, fields["bin_width_s"]),
        labels=_labels(path, fields, scenes=counts.shape[0]),
        thickness=thickness,
        direct_counts=direct,
    )


def _arrays(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz file that this module knows."""
    known = (
        "counts",
        "bin_width_s",
        "distance_label",
        "thickness_inch",
        "direct_counts",
    )
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
        # The record at the end counts the entries of the directory (bytes 10 and 11).
        (entries,) = struct.unpack_from("<H", content, content.rfind(b"PK\5\6") + 10)
        if entries != len(archive.infolist()):
            raise ValueError("an entry of the directory is lost")
        for member in archive.infolist():
            # Compares the directory with the header: a damaged name would hide a field.
            archive.open(member).close()
    except _DAMAGE as error:
        raise FormatError(
            f"{path} is not an npz file, or is damaged; {_NEEDED}: copy it again"
        ) from error
    with archive:
        names = set(archive.namelist())
        return {
            name: _array(path, archive, name)
            for name in known
            if f"{name}.npy" in names
        }


def _array(path: Path, archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    try:
        if archive.getinfo(f"{name}.npy").file_size > _LARGEST:
            raise FormatError(
                f"{path}: field '{name}' claims more than {_LARGEST >> 30} GiB; copy "
                "the file again, or cut the scan into parts"
            )
        data = archive.read(f"{name}.npy")
        buffer = io.BytesIO(data)
        version = np.lib.format.read_magic(buffer)
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, fortran, dtype = read_header(buffer)
        if dtype.kind in "biuf":
            if math.prod(shape) * dtype.itemsize != len(data) - buffer.tell():
                raise ValueError("the size is not that of the shape")
            array = np.frombuffer(data, dtype=dtype, offset=buffer.tell())
            return array.reshape(shape, order="F" if fortran else "C")
    except _DAMAGE as error:
        raise FormatError(
            f"{path}: field '{name}' is damaged; copy the file again, or make it again"
        ) from error
    held = "Python objects" if dtype.hasobject else f"{dtype}"
    raise FormatError(
        f"{path}: field '{name}' holds {held}, needed are numbers; save it as an array "
        "of whole numbers, without pickle"
    )


def _counts(path: Path, fields: dict[str, NDArray[Any]], name: str) -> NDArray[Any]:
    counts = fields[name]
    if counts.size == 0:
        raise FormatError(f"{path}: field '{name}' has shape {counts.shape}: no counts")
    if counts.dtype.kind not in "iu":
        whole = counts.dtype.kind == "f" and bool(np.all(np.isfinite(counts)))
        if not (whole and bool(np.all(counts == np.floor(counts)))):
            raise FormatError(
                f"{path}: field '{name}' holds {counts.dtype} that are not all whole "
                "numbers; needed are photons per bin, neither scaled nor averaged"
            )
    if counts.min() < 0:
        raise FormatError(
            f"{path}: field '{name}' holds {counts.min():g}, but a number of photons "
            "is not negative; save the counts before a background is taken off"
        )
    if counts.max() > _MOST_COUNTS:
        raise FormatError(
            f"{path}: field '{name}' holds {counts.max():.3g} photons in one bin, more "
            f"than any counter ({_MOST_COUNTS:.0e}); the file is damaged"
        )
    return counts


def _bin_width(path: Path, value: NDArray[Any]) -> float:
    if value.size != 1 or not np.all((value >= _NARROWEST) & (value <= _WIDEST)):
        raise FormatError(
            f"{path}: field 'bin_width_s' is {value.tolist()!r:.60}, needed is one "
            f"time above 0 s, from {_NARROWEST:g} to {_WIDEST:g} s; a bin of 16 ps is "
            "1.6e-11"
        )
    return float(value.reshape(()))


def _labels(
    path: Path, fields: dict[str, NDArray[Any]], *, scenes: int
) -> tuple[str, ...]:
    if "distance_label" not in fields:
        return ()
    label = fields["distance_label"]
    if label.shape != (scenes,):
        raise FormatError(
            f"{path}: field 'distance_label' has shape {label.shape}, needed is one "
            f"label for each of the {scenes} scenes of 'counts'"
        )
    return tuple(f"{value:g}" for value in label.tolist())


def _thickness(
    path: Path, fields: dict[str, NDArray[Any]], *, slabs: int
) -> NDArray[np.float64]:
    thickness = fields.get("thickness_inch")
    if thickness is None or thickness.shape != (slabs,):
        found = "missing" if thickness is None else f"of shape {thickness.shape}"
        raise FormatError(
            f"{path}: field 'thickness_inch' is {found}; 'counts' has 2 dimensions, "
            f"(slabs, bins), so needed is one thickness for each of its {slabs} slabs"
        )
    if not bool(np.all(np.isfinite(thickness) & (thickness > 0))):
        raise FormatError(
            f"{path}: field 'thickness_inch' must be finite and above 0 inch, found "
            f"{thickness.min():g}"
        )
    return thickness.astype(float) * _INCH
