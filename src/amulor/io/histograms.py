"""Photon histograms and waveforms: reading, Fourier coefficients, and their noise."""

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
from numpy.typing import ArrayLike, NDArray

from amulor.cube import provenance
from amulor.errors import FormatError
from amulor.io.dead_time import Counter
from amulor.io.files import read_bytes
from amulor.io.ptu import ptu_fields

#: Meter in an inch, by definition.
_INCH = 0.0254
#: Largest size of an array in a file; a larger one is damage, or must be cut [byte].
_LARGEST = 2**32
#: Exceptions raised for a damaged zip archive, or a damaged array in it.
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
#: Narrowest and widest possible bin of a photon counter [s].
_NARROWEST, _WIDEST = 1e-15, 1e-3
#: Largest number of photons in a bin; no counter reaches it [1].
_MOST_COUNTS = 10**15
_NEEDED = (
    "needed is an npz file with whole-number 'counts' (rows, columns, bins) and "
    "'bin_width_s'"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Histograms:
    """Photon counts against time, as stored in a file.

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
    """Source file."""
    digest: str
    """SHA-256 digest of that file."""
    counts: NDArray[Any]
    """Photons per bin, dimensions (scene, row, column, bin) [1]."""
    bin_width: float
    """Length of a time bin [s]."""
    labels: tuple[str, ...]
    """Scene names in the file; empty if it has none."""
    thickness: NDArray[np.float64] | None
    """Slab thickness by column, if the columns are slabs [m]."""
    direct_counts: NDArray[Any] | None
    """Photons per bin without a slab, if the file has them [1]."""
    counter: Counter | None = None
    """Pulses and dead time of the photon counter, if the file has them."""
    reference: NDArray[Any] | None = None
    """Recorded pulse of the instrument, dimension (bin), if the file has it."""
    noise: float | None = None
    """Standard deviation of a sample of a waveform; None for photons [V]."""
    start: float | None = None
    """Time of the first sample of a waveform; None for photons, whose first bin starts
    at zero [s]."""
    water: NDArray[Any] | None = None
    """Record without a target, up to a factor, dimension (bin), if the file has it."""
    coded: bool = False
    """Whether the pulse is a stated code, without noise."""
    periodic: bool = False
    """Whether record and pulse are one period of a signal without a pause."""

    @property
    def name(self) -> str:
        """File name without folder."""
        return self.path.name


def read_histograms(path: str | os.PathLike[str]) -> Histograms:
    """Read the photon histograms of an npz file.

    Parameters
    ----------
    path : path-like
        File with `bin_width_s` and integer `counts`. Shapes of `counts`: (rows,
        columns, bins); (scenes, rows, columns, bins), optionally with `distance_label`
        (scenes); or (slabs, bins), with `thickness_inch` (slabs) and optionally
        `direct_counts` (bins), the histogram without a slab.

        Optional fields for the dead time of the counter: `cycles`, the number of laser
        pulses of a histogram, `dead_time_s`, by default until the next pulse, and
        `dead_time_uncertainty_s`. `reference_counts` (bins) is the recorded pulse of
        the instrument. Instead of it, `code` and `chip_s` state a code of chips that
        starts at time zero, and `periodic` is 1 if it repeats without a pause and the
        record is one period. `water_counts` (bins) is a record without a target.

        Waveforms of a digitizer have `waveform` (rows, columns, samples) [V],
        `sample_interval_s`, `noise_v`, and optionally `start_s`, `reference_waveform`
        or `code`, and `water_waveform` (samples). A CSV file of waveforms has the
        columns `row,column,time_s,voltage_v,noise_v`. PTU files of PicoQuant are read
        with the package ptufile; detector channels become scenes.

    Returns
    -------
    Histograms
        Content of the file, checked.

    Raises
    ------
    FormatError
        If the file is missing, empty, damaged or of another kind, or if a field is
        missing or invalid.
    MissingExtraError
        If the package that reads PTU files is not installed.

    Notes
    -----
    Arrays are read as plain numbers. Files with Python objects are refused.

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
    if path.suffix.lower() == ".csv":
        return _waveforms(path, content, _columns(path, content))
    fields = (
        ptu_fields(path) if path.suffix.lower() == ".ptu" else _arrays(path, content)
    )
    if "waveform" in fields:
        return _waveforms(path, content, fields)
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
        counter=_counter(path, fields, shape=counts.shape[:-1]),
        reference=_pulse(
            path,
            fields,
            "reference_counts",
            times=(np.arange(counts.shape[-1] + 1.0))
            * _bin_width(path, fields["bin_width_s"]),
        ),
        water=_reference(path, fields, "water_counts", bins=counts.shape[-1]),
        coded="code" in fields,
        periodic=_periodic(fields),
    )


def _counter(
    path: Path, fields: dict[str, NDArray[Any]], *, shape: tuple[int, ...]
) -> Counter | None:
    if "cycles" not in fields:
        if "dead_time_s" in fields:
            raise FormatError(
                f"{path}: field 'dead_time_s' needs 'cycles', the number of laser "
                "pulses of a histogram"
            )
        return None
    cycles = fields["cycles"]
    if cycles.dtype.kind not in "iu" or not (cycles > 0).all():
        raise FormatError(
            f"{path}: field 'cycles' must hold whole numbers of pulses above 0"
        )
    try:
        cycles = np.broadcast_to(cycles, shape)
    except ValueError:
        raise FormatError(
            f"{path}: field 'cycles' has shape {cycles.shape}, needed is one number, "
            f"or one for each histogram, {shape[1:]}"
        ) from None
    dead_time, uncertainty = (
        float(fields[name].reshape(-1)[0]) if name in fields else default
        for name, default in (
            ("dead_time_s", math.inf),
            ("dead_time_uncertainty_s", 0.0),
        )
    )
    if not dead_time > 0 or not 0 <= uncertainty < dead_time:
        raise FormatError(
            f"{path}: 'dead_time_s' must be above 0 s and above its uncertainty, got "
            f"{dead_time:g} s and {uncertainty:g} s"
        )
    return Counter(
        cycles=cycles, dead_time=dead_time, dead_time_uncertainty=uncertainty
    )


def _reference(
    path: Path, fields: dict[str, NDArray[Any]], name: str, *, bins: int
) -> NDArray[Any] | None:
    reference = fields.get(name)
    if reference is None:
        return None
    if reference.shape != (bins,) or not np.isfinite(reference).all():
        raise FormatError(
            f"{path}: field '{name}' has shape {reference.shape}, needed are {bins} "
            "finite numbers, one for each bin of a record"
        )
    return reference


def _pulse(
    path: Path, fields: dict[str, NDArray[Any]], name: str, *, times: NDArray[Any]
) -> NDArray[Any] | None:
    """Return the recorded pulse, or that of a code, averaged between the times."""
    if "code" not in fields:
        return _reference(path, fields, name, bins=times.size - 1)
    code, chip = fields["code"].astype(float).ravel(), fields.get("chip_s")
    if name in fields or chip is None or chip.size != 1 or not (chip > 0).all():
        raise FormatError(
            f"{path}: a 'code' needs 'chip_s', the length of a chip in seconds, and no "
            f"'{name}' beside it"
        )
    if code.size < 2 or np.ptp(code) == 0 or not np.isfinite(code).all():
        raise FormatError(
            f"{path}: field 'code' must be chips that differ, such as 0 and 1"
        )
    ends = np.arange(code.size + 1) * float(chip.reshape(()))
    total = np.concatenate([[0.0], np.cumsum(code)]) * float(chip.reshape(()))
    if _periodic(fields) and abs(ends[-1] / (times[-1] - times[0]) - 1) > _UNEVEN:
        raise FormatError(
            f"{path}: a periodic code of {ends[-1]:g} s needs a record of one period, "
            f"got {times[-1] - times[0]:g} s"
        )
    return np.asarray(np.diff(np.interp(times, ends, total)) / np.diff(times))


def _periodic(fields: dict[str, NDArray[Any]]) -> bool:
    return "periodic" in fields and bool(fields["periodic"].any())


_WAVEFORM = (
    "needed are 'waveform' (rows, columns, samples) in volts, 'sample_interval_s' and "
    "'noise_v', the standard deviation of a sample"
)


def _waveforms(
    path: Path, content: bytes, fields: dict[str, NDArray[Any]]
) -> Histograms:
    """Return waveforms of a digitizer; FormatError if a field cannot be used."""
    waveform = fields["waveform"]
    if waveform.ndim != 3 or waveform.shape[-1] < 2 or waveform.size == 0:
        raise FormatError(
            f"{path}: field 'waveform' has shape {waveform.shape}; {_WAVEFORM}"
        )
    if not np.isfinite(waveform).all():
        raise FormatError(f"{path}: field 'waveform' holds numbers that are not finite")
    numbers = {}
    for name in ("sample_interval_s", "noise_v"):
        value = fields.get(name)
        if value is None or value.size != 1 or not (value > 0).all():
            raise FormatError(
                f"{path}: field '{name}' is not one number above 0; {_WAVEFORM}"
            )
        numbers[name] = float(value.reshape(()))
    start = fields.get("start_s", np.zeros(()))
    return Histograms(
        path=path,
        digest=provenance.digest(content),
        counts=waveform[np.newaxis].astype(float),
        bin_width=_bin_width(path, np.array(numbers["sample_interval_s"])),
        labels=(),
        thickness=None,
        direct_counts=None,
        reference=_pulse(
            path,
            fields,
            "reference_waveform",
            times=float(start.reshape(-1)[0])
            + (np.arange(waveform.shape[-1] + 1) - 0.5) * numbers["sample_interval_s"],
        ),
        noise=numbers["noise_v"],
        start=float(start.reshape(-1)[0]),
        water=_reference(path, fields, "water_waveform", bins=waveform.shape[-1]),
        coded="code" in fields,
        periodic=_periodic(fields),
    )


_COLUMNS = ["row", "column", "time_s", "voltage_v", "noise_v"]
#: Largest departure of the times of a table from equal steps, in steps [1].
_UNEVEN = 1e-3


def _columns(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """Return the fields of a table of waveforms; FormatError for another table."""
    try:
        head, *lines = content.decode("utf-8").strip().splitlines()
        if [name.strip() for name in head.split(",")] != _COLUMNS:
            raise ValueError(f"its first line is {head[:60]!r}")
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
        row, column = (table[:, k].astype(int) for k in (0, 1))
        order = np.lexsort((table[:, 2], column, row))
        shape = (row.max() + 1, column.max() + 1, -1)
        waveform, times, noise = (table[order, k].reshape(shape) for k in (3, 2, 4))
    except ValueError as error:
        raise FormatError(
            f"{path} is no table of waveforms ({error}); needed are the columns "
            f"{','.join(_COLUMNS)}, with all samples of every row and column"
        ) from error
    step = (times[0, 0, -1] - times[0, 0, 0]) / max(times.shape[-1] - 1, 1)
    even = times[0, 0, 0] + step * np.arange(times.shape[-1])
    if not step > 0 or np.abs(times - even).max() > _UNEVEN * step:
        raise FormatError(
            f"{path}: the column time_s has no equal steps, the same in all waveforms; "
            "resample the record"
        )
    return {
        "waveform": waveform,
        "sample_interval_s": np.array(step),
        "noise_v": np.array(np.sqrt(np.mean(noise**2))),
        "start_s": np.array(even[0]),
    }


def _arrays(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """Arrays of the supported fields of an npz file, by name."""
    fields = (
        "counts",
        "bin_width_s",
        "distance_label",
        "thickness_inch",
        "direct_counts",
        "cycles",
        "dead_time_s",
        "dead_time_uncertainty_s",
        "reference_counts",
        "waveform",
        "sample_interval_s",
        "noise_v",
        "start_s",
        "reference_waveform",
        "code",
        "chip_s",
        "periodic",
        "water_counts",
        "water_waveform",
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
            for name in fields
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
    kind = "Python objects" if dtype.hasobject else f"{dtype}"
    raise FormatError(
        f"{path}: field '{name}' holds {kind}, needed are numbers; save it as an array "
        "of whole numbers, without pickle"
    )


def _counts(path: Path, fields: dict[str, NDArray[Any]], name: str) -> NDArray[Any]:
    counts = fields[name]
    if counts.size == 0:
        raise FormatError(f"{path}: field '{name}' has shape {counts.shape}: no counts")
    if counts.dtype.kind not in "iu":
        integral = counts.dtype.kind == "f" and bool(np.all(np.isfinite(counts)))
        if not (integral and bool(np.all(counts == np.floor(counts)))):
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
        state = "missing" if thickness is None else f"of shape {thickness.shape}"
        raise FormatError(
            f"{path}: field 'thickness_inch' is {state}; 'counts' has 2 dimensions, "
            f"(slabs, bins), so needed is one thickness for each of its {slabs} slabs"
        )
    if not bool(np.all(np.isfinite(thickness) & (thickness > 0))):
        raise FormatError(
            f"{path}: field 'thickness_inch' must be finite and above 0 inch, found "
            f"{thickness.min():g}"
        )
    return thickness.astype(float) * _INCH


#: Values in one step of the transform, about 16 MiB of float64.
BLOCK = 2**21


def checked_frequency(
    histograms: Histograms, modulation_frequency: ArrayLike
) -> NDArray[np.float64]:
    """Return modulation frequencies; raise if invalid or too high for the bin width."""
    path = histograms.path
    try:
        frequency = np.atleast_1d(np.asarray(modulation_frequency, dtype=float))
    except (TypeError, ValueError) as error:
        raise FormatError(
            f"{path}: modulation_frequency {modulation_frequency!r} is not a list of "
            "numbers; state frequencies in Hz"
        ) from error
    if frequency.ndim != 1 or frequency.size == 0:
        raise FormatError(
            f"{path}: modulation_frequency has shape {frequency.shape}; state a list "
            "of at least one frequency in Hz"
        )
    wrong = frequency[~(np.isfinite(frequency) & (frequency > 0))]
    if wrong.size:
        raise FormatError(
            f"{path}: modulation_frequency must be finite and above 0 Hz, found "
            f"{wrong[0]:g} Hz; take it off the list"
        )
    highest = 0.5 / histograms.bin_width
    if frequency.max() > highest:
        raise FormatError(
            f"{path}: modulation_frequency {frequency.max():g} Hz is too high for "
            f"bin_width_s {histograms.bin_width:g} s; stay at or below {highest:g} Hz, "
            "half a period per bin"
        )
    if np.any(np.diff(frequency) <= 0):
        raise FormatError(
            f"{path}: modulation_frequency must increase; sort the list and drop what "
            "stands there twice"
        )
    return frequency


def weights(
    histograms: Histograms,
    frequency: NDArray[np.float64],
    *,
    time_of_emission: float = 0.0,
    background_bins: tuple[int, int] | None = None,
    gate: tuple[float, float] | None = None,
) -> NDArray[np.complex128]:
    r"""Fourier weights of the time bins, for each modulation frequency.

    Bins outside of a gate have the weight 0.

    :math:`g_k = e^{2 \pi i f t_k}` with :math:`t_k` the center of bin k. With a
    background it is :math:`g_k - [k \in B] \sum_j g_j / |B|`: taking a mean off is
    linear in the counts, so the counting noise of the background needs no term of
    its own.
    """
    bins = histograms.counts.shape[-1]
    start = 0.5 * histograms.bin_width if histograms.start is None else histograms.start
    time = start + np.arange(bins) * histograms.bin_width - time_of_emission
    weight: NDArray[np.complex128] = np.exp(2j * np.pi * np.outer(frequency, time))
    if gate is not None:
        weight[:, ~within_gate(histograms, gate)] = 0.0
    if background_bins is not None:
        first, end = background_bins
        if not 0 <= first < end <= bins:
            raise FormatError(
                f"{histograms.path}: background_bins ({first}, {end}) are not bins of "
                f"'counts'; state 0 <= first < end <= {bins}"
            )
        weight[:, first:end] -= weight.sum(axis=1, keepdims=True) / (end - first)
    return weight


def within_gate(histograms: Histograms, gate: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the bins whose centers are in a gate; FormatError for a wrong gate."""
    start = 0.5 * histograms.bin_width if histograms.start is None else histograms.start
    time = start + np.arange(histograms.counts.shape[-1]) * histograms.bin_width
    inside = (time > gate[0]) & (time < gate[1])
    if inside.sum() < 2:
        raise FormatError(
            f"{histograms.path}: the gate from {gate[0]:g} s to {gate[1]:g} s has "
            f"{inside.sum()} bins; the record is from {time[0]:g} s to {time[-1]:g} s"
        )
    return inside


@dataclass(frozen=True, kw_only=True, eq=False)
class Coefficients:
    """Fourier coefficients of photon counts, with their counting covariance."""

    signal: NDArray[np.complex128]
    """Fourier coefficient of the counts, shape (frequencies, ...) [1]."""
    variance_in_phase: NDArray[np.float64]
    """Variance of its real part [1]."""
    variance_quadrature: NDArray[np.float64]
    """Variance of its imaginary part [1]."""
    covariance: NDArray[np.float64]
    """Covariance of real and imaginary part [1]."""

    def times(self, factor: NDArray[np.complex128]) -> Coefficients:
        """Return the coefficients after multiplication by a factor per frequency."""
        shape = (-1, *[1] * (self.signal.ndim - 1))
        a, b = factor.real.reshape(shape), factor.imag.reshape(shape)
        product = 2 * a * b * self.covariance
        return Coefficients(
            signal=self.signal * factor.reshape(shape),
            variance_in_phase=a**2 * self.variance_in_phase
            + b**2 * self.variance_quadrature
            - product,
            variance_quadrature=b**2 * self.variance_in_phase
            + a**2 * self.variance_quadrature
            + product,
            covariance=a * b * (self.variance_in_phase - self.variance_quadrature)
            + (a**2 - b**2) * self.covariance,
        )

    def with_error(self, shift: NDArray[np.complex128]) -> Coefficients:
        """Return the coefficients with a further standard error along a shift."""
        return Coefficients(
            signal=self.signal,
            variance_in_phase=self.variance_in_phase + shift.real**2,
            variance_quadrature=self.variance_quadrature + shift.imag**2,
            covariance=self.covariance + shift.real * shift.imag,
        )


def transform(
    counts: NDArray[Any],
    weight: NDArray[np.complex128],
    variance: NDArray[np.float64] | None = None,
) -> Coefficients:
    r"""Fourier coefficients of histograms, with their Poisson covariance.

    Notes
    -----
    With counts :math:`n_k` that are Poisson and independent, the signal
    :math:`\sum_k n_k g_k` has the variances :math:`\sum_k n_k (\Re g_k)^2` and
    :math:`\sum_k n_k (\Im g_k)^2` and the covariance
    :math:`\sum_k n_k \Re g_k \Im g_k`; the observed counts stand for their means,
    which leaves the estimates unbiased. A stated `variance` of each bin replaces them.
    Done as matrix products over blocks of
    histograms and frequencies, so that memory stays bounded.

    Examples
    --------
    >>> found = transform(np.array([3, 4]), np.array([[1.0, 1j]]))
    >>> print(found.signal[0], found.variance_in_phase[0], found.covariance[0])
    (3+4j) 3.0 0.0
    """
    frequencies, bins = weight.shape
    if variance is not None:
        values, squares = transform(counts, weight), transform(variance, weight)
        return Coefficients(
            signal=values.signal,
            variance_in_phase=squares.variance_in_phase,
            variance_quadrature=squares.variance_quadrature,
            covariance=squares.covariance,
        )
    flat = counts.reshape(-1, bins)
    sums = np.empty((5, frequencies, flat.shape[0]))
    rows = max(1, BLOCK // bins)
    step = max(1, BLOCK // (5 * bins))
    for start in range(0, frequencies, step):
        part = slice(start, start + step)
        real, imaginary = weight[part].real, weight[part].imag
        matrix = np.concatenate(
            [real, imaginary, real**2, imaginary**2, real * imaginary]
        )
        for row in range(0, flat.shape[0], rows):
            block = flat[row : row + rows].astype(float)
            product = (matrix @ block.T).reshape(5, -1, block.shape[0])
            sums[:, part, row : row + rows] = product
    sums = sums.reshape(5, frequencies, *counts.shape[:-1])
    return Coefficients(
        signal=sums[0] + 1j * sums[1],
        variance_in_phase=sums[2],
        variance_quadrature=sums[3],
        covariance=sums[4],
    )
