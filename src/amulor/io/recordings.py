"""Recordings that other software made become measurement cubes."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import FormatError
from amulor.io.recording_map import RecordingMap
from amulor.io.recording_samples import (
    Samples,
    distinct,
    of_one_temperature,
    pixels,
    samples_of,
    turn,
)
from amulor.io.recording_table import read_table
from amulor.optics import detection
from amulor.survey import Survey, water_properties
from amulor.survey.counting import (
    counting_variance,
    integration_time,
    photon_noise_volt,
)
from amulor.survey.directions import scan_directions
from amulor.survey.view import geometry_attributes, medium

__all__ = ["read_recordings"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Bits of `user_sample_flag`.
ZERO, BREAKDOWN, NO_NUMBER = 1, 2, 4
_WORDS = "zero_output breakdown no_number"
#: A sample is a breakdown that is farther from each of its neighbours than so many
#: typical distances, and than so many of its standard uncertainties [1].
_BREAKDOWN, _SURE = 12.0, 8.0
#: And farther from all mixtures of two of them than so often they differ [1].
_SPREAD = 2.0
#: What lock-ins put out for no number is above this [V].
_NO_VOLTAGE = 1e6
_SAMPLE = ("modulation_frequency", "polarization", "row", "column")
_PIXEL = ("row", "column")


@dataclass(frozen=True, kw_only=True)
class _Gathered:
    """Means of the samples of one channel and place, of which some may be marked."""

    signal: Complex
    mean: Floats
    temperature: Floats
    takes: NDArray[np.int32]
    flag: NDArray[np.int16]


def read_recordings(
    path: str | Path,
    described: RecordingMap,
    survey: Survey,
    *,
    temperature: float | None = None,
) -> xr.Dataset:
    """Turn a recording of other software into a measurement cube.

    Parameters
    ----------
    path : str or pathlib.Path
        CSV or HDF5 file.
    described : RecordingMap
        Which column means what.
    survey : Survey
        Instrument and scan. Its frequencies and polarizations need not be those of the
        recording, unless no column and no constant of the map states them.
    temperature : float, optional
        Which temperature, where there are several [degC].

    Returns
    -------
    xarray.Dataset
        Cube of level `samples`, with open-water shots where the map tells them. Places
        that were not recorded are no numbers. Zero outputs, what is no number, and
        breakdowns are marked in `user_sample_flag`; breakdowns are `saturated`, the
        others no numbers. Samples of one place are averaged, without those that are no
        numbers; `user_takes` counts them.

    Raises
    ------
    FormatError
        If the file or the map does not fit, a sample lies beyond the scan, or the
        recording has several temperatures and none is chosen.

    Notes
    -----
    A breakdown of the detector stands alone: it is farther from each of its eight
    neighbours, and from each mixture of two of them, which a beam on an edge sees, than
    12 typical distances, than 8 of its standard uncertainties, and than twice what its
    neighbours differ among each other. Two breakdowns side by side are not seen, and a
    bright object of one pixel looks like one. A shot is a breakdown if it is so many
    typical distances and uncertainties off the median of its channel.
    """
    path = Path(path)
    samples = samples_of(read_table(path, described), described, survey)
    samples = of_one_temperature(path, samples, temperature)
    frequencies, frequency = distinct(samples.frequency)
    pairs = list(dict.fromkeys(map(str, samples.polarization)))
    polarization = np.array([pairs.index(str(pair)) for pair in samples.polarization])
    scan, shots = ~samples.water, samples.water
    if not scan.any():
        raise FormatError(
            f"{path}: holds open-water shots and no sample of the scan; check "
            "constants.open_water of the map"
        )
    seen = samples.part(scan)
    channel = frequency[scan], polarization[scan]
    shape = len(frequencies), len(pairs), survey.scan.rows, survey.scan.columns
    at = (*channel, *pixels(path, seen, channel, survey))
    found = _gathered(seen, at, shape)
    uncertainty = _uncertainty(described, survey, found)
    broken = _breakdowns(found.signal, uncertainty)
    azimuth, elevation, _ = scan_directions(survey)
    cube = cubes.build(
        "samples",
        {
            **_outputs(found, uncertainty, survey, described),
            "saturated": broken.astype(np.int8),
        },
        {
            "modulation_frequency": frequencies,
            "polarization": pairs,
            "azimuth": _direction(seen.azimuth, at, azimuth),
            "elevation": _direction(seen.elevation, at, elevation),
        },
        geometry=geometry_attributes(survey, medium(survey, water_properties(survey))),
        attributes=_attributes(path, survey, frequencies, pairs),
    )
    if shots.any():
        part = samples.part(shots)
        without = sorted(
            set(zip(frequency[scan], polarization[scan], strict=True))
            - set(zip(frequency[shots], polarization[shots], strict=True))
        )
        if without:
            f, p = without[0]
            raise FormatError(
                f"{path}: the scan has {frequencies[f] / 1e6:g} MHz {pairs[p]}, of "
                "which there is no open-water shot; record shots in all channels, or "
                "take out constants.open_water of the map"
            )
        group = _shots(part, (frequency[shots], polarization[shots]), survey, described)
        cube = cubes.attach(cube, group, "open_water")
    cube = cube.assign(_user_variables(found, broken))
    return cubes.note(cube, "import recordings")


def _gathered(
    samples: Samples, at: tuple[NDArray[np.intp], ...], shape: tuple[int, ...]
) -> _Gathered:
    """Return the mean of all samples of a place, but for those without a number."""
    zero = samples.signal == 0
    none = ~(np.abs(np.nan_to_num(samples.signal, nan=np.inf)) < _NO_VOLTAGE)
    good = ~(zero | none)
    flat = np.ravel_multi_index(at, shape)
    size = int(np.prod(shape))

    def mean_of(values: Floats, of: NDArray[np.bool_]) -> Floats:
        of = of & np.isfinite(values)
        count = np.bincount(flat[of], minlength=size)
        total = np.bincount(flat[of], values[of], minlength=size)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(shape)

    flag = np.zeros(size, dtype=np.int16)
    np.bitwise_or.at(flag, flat[zero], np.int16(ZERO))
    np.bitwise_or.at(flag, flat[none], np.int16(NO_NUMBER))
    real = mean_of(samples.signal.real, good)
    imaginary = mean_of(samples.signal.imag, good)
    return _Gathered(
        signal=real + 1j * imaginary,
        mean=mean_of(samples.mean, good),
        temperature=mean_of(samples.temperature, np.ones(len(flat), dtype=bool)),
        takes=np.bincount(flat[good], minlength=size).astype(np.int32).reshape(shape),
        flag=flag.reshape(shape),
    )


def _direction(
    angle: Floats, at: tuple[NDArray[np.intp], ...], planned: Floats
) -> Floats:
    """Return where the beam stood, in the mean of all channels; or was to stand."""
    flat = np.ravel_multi_index(at[2:], planned.shape)
    there = np.isfinite(angle)
    count = np.bincount(flat[there], minlength=planned.size)
    total = np.bincount(flat[there], angle[there], minlength=planned.size)
    mean = (total / np.maximum(count, 1)).reshape(planned.shape)
    return np.where(count.reshape(planned.shape) > 0, mean, planned)


def _uncertainty(described: RecordingMap, survey: Survey, found: _Gathered) -> Floats:
    """Return the standard uncertainty of either output but for the phase floor [V]."""
    takes = np.maximum(found.takes, 1)
    if described.constants.uncertainty is not None:
        return described.constants.uncertainty / np.sqrt(takes)
    detector = survey.instrument.detector
    volt = detector.volt_per_photoelectron_rate
    # Without a mean output the amplitude tells how much light there is at least.
    lower = np.abs(found.signal) / (survey.instrument.modulation_depth * volt)
    seen = np.maximum(found.mean / volt - detector.dark_rate, 0.0)
    rate = np.where(np.isfinite(found.mean), seen, lower)
    variance = counting_variance(
        survey, rate=np.nan_to_num(rate), integration_time=integration_time(survey)
    )
    return np.asarray(np.sqrt(variance / takes))


def _outputs(
    found: _Gathered, uncertainty: Floats, survey: Survey, described: RecordingMap
) -> dict[str, Floats]:
    """Return the outputs and their errors, under the names of the schema."""
    floor = survey.instrument.lock_in.phase_floor
    if described.constants.uncertainty is not None:
        floor = 0.0  # what is stated holds for all of it
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        found.signal, phase_floor=floor
    )
    return {
        "in_phase": found.signal.real,
        "quadrature": found.signal.imag,
        "in_phase_uncertainty": np.sqrt(uncertainty**2 + in_phase),
        "quadrature_uncertainty": np.sqrt(uncertainty**2 + quadrature),
        "in_phase_quadrature_covariance": covariance,
    }


def _breakdowns(signal: Complex, uncertainty: Floats) -> NDArray[np.bool_]:
    """Return which pixels stand alone, far from all that their neighbours explain."""
    wide = np.pad(
        signal, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=complex(np.nan)
    )
    rows, columns = signal.shape[2:]
    around = [
        wide[:, :, down : down + rows, right : right + columns]
        for down, right in itertools.product(range(3), repeat=2)
        if (down, right) != (1, 1)
    ]
    nearest = np.full(signal.shape, np.inf)
    for other in around:
        nearest = np.fmin(nearest, np.abs(signal - other))
    nearest[~np.isfinite(signal) | ~np.isfinite(nearest)] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # channels without a number
        typical = np.nanmedian(nearest, axis=(2, 3), keepdims=True)
    far = np.maximum(_BREAKDOWN * typical, _SURE * uncertainty)
    broken = np.asarray(nearest > far)
    beside = np.stack([other[broken] for other in around])
    off, spread = _off_mixtures(signal[broken], beside)
    broken[broken] = off > np.maximum(far[broken], _SPREAD * spread)
    return broken


def _off_mixtures(signal: Complex, beside: Complex) -> tuple[Floats, Floats]:
    """Return the distance of samples from mixtures of two neighbours, and their spread.

    A beam on an edge sees a mixture of both sides. `beside` has the neighbours of each
    sample along its first axis, no numbers where there are none.
    """
    off, spread = np.full(signal.shape, np.inf), np.zeros(signal.shape)
    for one, other in itertools.combinations_with_replacement(beside, 2):
        span = other - one
        length = np.abs(span)
        along = ((signal - one) * span.conj()).real
        share = np.clip(along / np.where(length > 0, length, 1) ** 2, 0, 1)
        off = np.fmin(off, np.abs(signal - one - share * span))
        spread = np.fmax(spread, length)
    return off, spread


def _shots(
    samples: Samples,
    channel: tuple[NDArray[np.intp], NDArray[np.intp]],
    survey: Survey,
    described: RecordingMap,
) -> xr.Dataset:
    """Return the open-water shots; a breakdown among them is no number."""
    number = turn(channel).astype(np.intp)
    sizes = channel[0].max() + 1, channel[1].max() + 1, number.max() + 1
    at = (*channel, np.zeros_like(number), number)
    shape = (*sizes[:2], 1, sizes[2])
    found = _gathered(samples, at, shape)
    uncertainty = _uncertainty(described, survey, found)
    middle = np.nanmedian(found.signal.real, axis=3, keepdims=True) + 1j * np.nanmedian(
        found.signal.imag, axis=3, keepdims=True
    )
    off = np.abs(found.signal - middle)
    typical = np.nanmedian(off, axis=3, keepdims=True)
    broken = off > np.maximum(_BREAKDOWN * typical, _SURE * uncertainty)
    found.signal[broken] = complex(np.nan, np.nan)
    outputs = {
        name: values[:, :, 0]
        for name, values in _outputs(found, uncertainty, survey, described).items()
    }
    where = {}
    for name in ("azimuth", "elevation"):
        angle = getattr(samples, name)
        if np.isfinite(angle).all():
            total = np.bincount(number, angle) / np.bincount(number)
            where[name] = np.asarray(total)
    return cubes.open_water({**outputs, **where})


def _user_variables(
    found: _Gathered, broken: NDArray[np.bool_]
) -> dict[str, xr.Variable]:
    flag = (found.flag | np.int16(BREAKDOWN) * broken).astype(np.int16)
    masks = np.array([ZERO, BREAKDOWN, NO_NUMBER], dtype=np.int16)
    about = "what stood in the way of a sample, 0 if nothing did"
    result = {
        "user_sample_flag": xr.Variable(
            _SAMPLE,
            flag,
            {
                "long_name": about,
                "units": "1",
                "flag_masks": masks,
                "flag_values": masks,
                "flag_meanings": _WORDS,
            },
        ),
        "user_takes": xr.Variable(
            _SAMPLE,
            found.takes,
            {"long_name": "samples that were averaged", "units": "1"},
        ),
    }
    for name, values, unit in (
        ("mean output of the detector", found.mean, "V"),
        ("temperature of the water", found.temperature, "degC"),
    ):
        if np.isfinite(values).any():
            short = "user_mean_output" if unit == "V" else "user_temperature"
            result[short] = xr.Variable(
                _SAMPLE, values, {"long_name": name, "units": unit}
            )
    return result


def _attributes(
    path: Path, survey: Survey, frequencies: Floats, pairs: list[str]
) -> dict[str, Any]:
    recorded = survey.with_(
        {
            "instrument.modulation_frequencies": frequencies.tolist(),
            "instrument.polarizations": pairs,
        }
    )
    return cubes.attributes(
        "samples",
        title=survey.name,
        source=f"recording {path.name}",
        simulated=np.int32(0),
        survey=recorded.to_toml(),
        input_digests=f"survey {cubes.digest(survey.to_toml())}",
        modulation_depth=survey.instrument.modulation_depth,
        photon_noise_volt=photon_noise_volt(survey),
    )
