"""Tallies of photon transport in netCDF-4 files, to be merged or continued."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._hdf5 import SIGNATURE, check_size
from amulor.errors import AmulorError, FormatError
from amulor.io.files import atomic_output, load_hdf5, read_bytes
from amulor.io.netcdf import (
    _check_seal,
    _encoded,
    _opened,
    _reason,
    indexed_file,
)

if TYPE_CHECKING:
    from amulor.transport.tally import Tally

#: Version of the file format.
_VERSION = "1"
_DIMENSIONS = ("batch", "part", "component", "modulation_frequency")
_DERIVATIVE = ("batch", "derivative", "component", "modulation_frequency")
_PER_LIGHT = {"units": "1", "long_name": "light per launched light"}


def write_tally(
    tally: Tally, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write the result of a transport run to a netCDF-4 file.

    Parameters
    ----------
    tally : Tally
        Result of `amulor.transport.simulate` or `reflection_and_transmission`.
    path : path-like
        File to write, usually with the suffix `.nc`.
    overwrite : bool
        Whether an existing file is replaced.

    Raises
    ------
    FormatError
        If the file exists and `overwrite` is not set, or cannot be written.

    Notes
    -----
    All batches are stored, so that the result of `read_tally` can be merged and
    continued like the original; its numbers are equal to the last bit. Complex numbers
    are stored as real and imaginary part, in_phase and quadrature.

    Examples
    --------
    >>> from amulor import io, transport
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> water = transport.Medium.homogeneous(
    ...     absorption=0.1,
    ...     scattering=0.5,
    ...     group_index=1.34,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.9),
    ... )
    >>> disc = transport.DiscReceiver(
    ...     radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0)
    ... )
    >>> tally = transport.simulate(
    ...     water, transport.Source(), disc, [0.0, 50e6], histories=2_000, seed=1
    ... )
    >>> io.write_tally(tally, "run.nc")
    >>> io.read_tally("run.nc").histories
    2000
    """
    from amulor.transport.tally import ANALYSERS, LIGHT

    components = ["I", "Q", "U", "V"][: tally.batches.shape[2]]
    frequency = {"units": "Hz", "long_name": "modulation frequency"}
    histories = {"units": "1", "long_name": "histories in each batch"}
    coordinates: dict[str, Any] = {
        "part": ("part", np.array(tally.parts, dtype=object)),
        "component": ("component", np.array(components, dtype=object)),
        "modulation_frequency": (
            "modulation_frequency",
            tally.modulation_frequency,
            frequency,
        ),
    }
    variables: dict[str, Any] = {
        "in_phase": (_DIMENSIONS, tally.batches.real, _PER_LIGHT),
        "quadrature": (_DIMENSIONS, tally.batches.imag, _PER_LIGHT),
        "histories": ("batch", tally.histories_of, histories),
    }
    attributes: dict[str, Any] = {
        "title": "light of a photon transport run, as means of batches of histories",
        "amulor_tally_version": _VERSION,
        "problem": tally.problem,
        # Text, as there is no limit to the size of a seed.
        "seeds": " ".join(str(seed) for seed in (tally.seed, *tally.merged_seeds)),
        "batch_size": np.int64(tally.batch_size),
        "next_batch": np.int64(tally.next_batch),
        "groups": np.int64(tally.groups),
        "contribution_sum": np.float64(tally.contribution[0]),
        "contribution_sum_of_squares": np.float64(tally.contribution[1]),
        "largest_contribution": np.float64(tally.contribution[2]),
        "phase_function_integral": np.array(tally.phase_function_integral),
        "seconds": np.float64(tally.seconds),
        "interrupted": np.int8(tally.interrupted),
    }
    if tally.contributions is not None:
        kinds, analysers = tally.contributions.shape[:2]
        coordinates["light"] = ("light", np.array(LIGHT[:kinds], dtype=object))
        coordinates["analyser"] = (
            "analyser",
            np.array(ANALYSERS[:analysers], dtype=object),
        )
        variables["contributions"] = (
            ("light", "analyser", "statistic"),
            tally.contributions,
            {"units": "1", "long_name": "sum, sum of squares and largest of groups"},
        )
        attributes["unseen_contribution"] = np.float64(tally.unseen)
    if tally.derivative_batches is not None:
        names = [f"{name}, {k}" for name in tally.derivatives for k in LIGHT[1:]]
        coordinates["derivative"] = ("derivative", np.array(names, dtype=object))
        slope = {"long_name": "derivative of the light, per unit of the parameter"}
        for name, part in (("in_phase", np.real), ("quadrature", np.imag)):
            variables[f"derivative_{name}"] = (
                _DERIVATIVE,
                part(tally.derivative_batches),
                slope,
            )
    record = tally.record
    if record is not None:
        length = {"units": "m", "long_name": "length of the path"}
        coordinates["path_length"] = ("path_length", record.length, length)
        for name, light in (("water", record.water), ("target", record.target)):
            dimensions = ("path_length", "component")
            variables[f"{name}_by_path"] = (dimensions, light, _PER_LIGHT)
        attributes["beyond_record"] = np.float64(record.beyond)
    with atomic_output(path, overwrite=overwrite) as temporary:
        dataset = xr.Dataset(variables, coordinates, attributes)
        temporary.write_bytes(_encoded({"": dataset}))


def read_tally(path: str | os.PathLike[str]) -> Tally:
    """Read the result of a transport run.

    Parameters
    ----------
    path : path-like
        File from `write_tally`.

    Returns
    -------
    Tally
        Result of the transport run, with the same numbers.

    Raises
    ------
    FormatError
        If the file is missing, damaged, or of another kind.

    Examples
    --------
    >>> from amulor import io, transport
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> water = transport.Medium.homogeneous(
    ...     absorption=0.1,
    ...     scattering=0.5,
    ...     group_index=1.34,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.9),
    ... )
    >>> disc = transport.DiscReceiver(
    ...     radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0)
    ... )
    >>> tally = transport.simulate(
    ...     water, transport.Source(), disc, [0.0, 50e6], histories=2_000, seed=1
    ... )
    >>> io.write_tally(tally, "run.nc")
    >>> again = io.read_tally("run.nc")
    >>> again.batches.shape
    (125, 12, 1, 2)
    """
    path = Path(path)
    content = read_bytes(path)
    if not content.startswith(SIGNATURE):
        raise FormatError(
            f"{path} is no netCDF-4 file, it starts with {content[:8]!r}; name a tally "
            "that amulor wrote"
        )
    _check_seal(content, path)
    load_hdf5()
    try:
        return _tally(_loaded(content, path), path)
    except AmulorError:
        raise
    except Exception as error:  # h5py and what decodes the file raise many kinds
        raise FormatError(
            f"{path} cannot be read as a tally: {_reason(error)}; it is damaged, or "
            "another program wrote it: copy it again, or make it again"
        ) from error


def _loaded(content: bytes, path: Path) -> xr.Dataset:
    """Contents of a tally file as a dataset."""
    import h5netcdf

    with indexed_file(content) as storage:
        version = dict(storage.attrs).get("amulor_tally_version")
        if version is None:
            raise FormatError(
                f"{path} is no tally of amulor: it lacks the attribute "
                "'amulor_tally_version'; name a file that write_tally wrote"
            )
        check_size(storage, path)
        with h5netcdf.File(storage, "r", decode_vlen_strings=True) as file:
            dataset = _opened(file, None)
    if dataset.attrs["amulor_tally_version"] != _VERSION:
        raise FormatError(
            f"{path} has 'amulor_tally_version' "
            f"{dataset.attrs['amulor_tally_version']!r}, this version of amulor reads "
            f"{_VERSION!r}; read it with the version that wrote it"
        )
    return dataset


def _tally(dataset: xr.Dataset, path: Path) -> Tally:
    """Tally from the contents of a file; raise if its values are invalid."""
    # Imported here with its compiled loops, which other readers do not need.
    from amulor.transport.tally import PathRecord, Tally

    def real(name: str) -> NDArray[np.float64]:
        values: NDArray[np.float64] = np.array(dataset[name].values, dtype=np.float64)
        if not np.all(np.isfinite(values)):
            raise FormatError(
                f"{path}: '{name}' holds numbers that are not finite; make it again"
            )
        return values

    def number(name: str) -> float:
        return float(dataset.attrs[name])

    def whole(name: str) -> int:
        return int(dataset.attrs[name])

    def paired(in_phase: str, quadrature: str) -> NDArray[np.complex128]:
        values = np.empty(dataset[in_phase].shape, dtype=np.complex128)
        values.real, values.imag = real(in_phase), real(quadrature)
        return values

    batches = paired("in_phase", "quadrature")
    histories_of = np.array(dataset["histories"].values, dtype=np.int64)
    if dataset["in_phase"].dims != _DIMENSIONS or batches.shape[2] not in (1, 4):
        raise FormatError(
            f"{path}: 'in_phase' has {dict(dataset['in_phase'].sizes)}, needed are the "
            f"dimensions {', '.join(_DIMENSIONS)} with 1 or 4 components; make it again"
        )
    if histories_of.size == 0 or np.any(histories_of < 1):
        raise FormatError(f"{path} has a batch without histories; make it again")
    seed, *merged = (int(word) for word in str(dataset.attrs["seeds"]).split())
    derivatives: tuple[str, ...] = ()
    derivative_batches = None
    if "derivative" in dataset:
        rows = [str(name) for name in dataset["derivative"].values]
        derivatives = tuple(name.rpartition(", ")[0] for name in rows[::2])
        derivative_batches = paired("derivative_in_phase", "derivative_quadrature")
    record = None
    if "path_length" in dataset:
        record = PathRecord(
            length=real("path_length"),
            water=real("water_by_path"),
            target=real("target_by_path"),
            beyond=number("beyond_record"),
        )
    return Tally(
        modulation_frequency=real("modulation_frequency"),
        parts=tuple(str(name) for name in dataset["part"].values),
        batches=batches,
        histories_of=histories_of,
        groups=whole("groups"),
        contribution=(
            number("contribution_sum"),
            number("contribution_sum_of_squares"),
            number("largest_contribution"),
        ),
        seed=seed,
        merged_seeds=tuple(merged),
        next_batch=whole("next_batch"),
        batch_size=whole("batch_size"),
        problem=str(dataset.attrs["problem"]),
        seconds=number("seconds"),
        interrupted=bool(whole("interrupted")),
        record=record,
        phase_function_integral=tuple(
            float(value)
            for value in np.atleast_1d(dataset.attrs.get("phase_function_integral", ()))
        ),
        contributions=real("contributions") if "contributions" in dataset else None,
        unseen=number("unseen_contribution") if "contributions" in dataset else 0.0,
        derivatives=derivatives,
        derivative_batches=derivative_batches,
    )
