"""Import of recordings from other software as measurement cubes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.errors import FormatError
from amulor.io.recording_samples import (
    Samples,
    around,
    distinct,
    median_of,
    nearest_distance,
    of_one_temperature,
    off_mixtures,
    pixels,
    samples_of,
    turn,
)
from amulor.io.recording_table import RecordingMap, read_table
from amulor.optics import detection
from amulor.survey import Survey
from amulor.survey.counting import (
    counting_variance,
    integration_time,
    photon_noise_volt,
)
from amulor.survey.directions import refuse_scans_beyond_memory, scan_directions
from amulor.survey.view import geometry_attributes

__all__ = ["read_recordings"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Bits of `user_sample_flag`.
ZERO, BREAKDOWN, NO_NUMBER = 1, 2, 4
_WORDS = "zero_output breakdown no_number"
#: A sample is a breakdown if it differs from each neighbor by more than this many
#: typical differences, and this many of its standard uncertainties [1].
_BREAKDOWN, _SURE = 12.0, 8.0
#: It must also differ from all mixtures of two neighbors by this factor times their
#: difference [1].
_SPREAD = 2.0
#: Values above this are codes of lock-ins for a missing number [V].
_NO_VOLTAGE = 1e6
_SAMPLE = ("modulation_frequency", "polarization", "row", "column")
_PIXEL = ("row", "column")


@dataclass(frozen=True, kw_only=True)
class _Gathered:
    """Mean signal of each channel and pixel, with its sample count and flags."""

    signal: Complex
    mean: Floats
    temperature: Floats
    takes: NDArray[np.int32]
    flag: NDArray[np.int16]

    def rows(self, rows: slice) -> _Gathered:
        """Return the mean signals in a range of rows."""
        return _Gathered(**{key: v[:, :, rows] for key, v in vars(self).items()})


def read_recordings(
    path: str | Path,
    described: RecordingMap,
    survey: Survey,
    *,
    temperature: float | None = None,
) -> xr.Dataset:
    """Convert a recording of other software to a measurement cube.

    A breakdown of the detector is an isolated outlier. It differs from each of its
    eight neighbors, and from each mixture of two of them (as of a beam on an edge), by
    more than three limits: 12 typical differences, 8 standard uncertainties, and twice
    the difference among the neighbors. Two breakdowns side by side are not detected,
    and a bright object of one pixel counts as a breakdown. A shot is a breakdown if it
    differs as much from the median of its channel.
    """
    path = Path(path)
    samples = samples_of(read_table(path, described), described, survey)
    samples = of_one_temperature(path, samples, temperature)
    frequencies, frequency = distinct(samples.frequency)
    pairs = list(dict.fromkeys(map(str, samples.polarization)))
    polarization = np.array([pairs.index(str(pair)) for pair in samples.polarization])
    scan, shots = ~samples.water, samples.water
    refuse_no_scan(path, any_scan=bool(scan.any()))
    scan_samples = samples.part(scan)
    channel = frequency[scan], polarization[scan]
    at = (*channel, *pixels(path, scan_samples, channel, survey))
    recording = Recording(
        path=path,
        survey=survey,
        described=described,
        frequencies=frequencies,
        pairs=pairs,
        shots=shots_of(
            path, samples.part(shots), (frequency[shots], polarization[shots]),
            survey, described, names=(frequencies, pairs), scanned=channel,
        ),
    )  # fmt: skip
    refuse_scans_beyond_memory(survey)
    band = gathered_band(recording, scan_samples, at, (0, survey.scan.rows))
    typical = np.stack(
        [[median_of(near) for near in plane] for plane in band.nearest],
    )
    return cube_of(
        recording, band, typical[..., None, None],
        mean=bool(np.isfinite(band.means.mean).any()),
        temperature=bool(np.isfinite(band.means.temperature).any()),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Survey, channels and open-water references of a recording, common to all rows."""

    path: Path
    survey: Survey
    described: RecordingMap
    frequencies: Floats
    pairs: list[str]
    shots: xr.Dataset | None


@dataclass(frozen=True, kw_only=True)
class Band:
    """Mean signals in a band of rows and its neighbor rows, with outliers unflagged."""

    means: _Gathered
    uncertainty: Floats
    nearest: Floats
    azimuth: Floats
    elevation: Floats
    rows: tuple[int, int]
    """First row, and the row behind the last."""
    inner: slice
    """Slice of these rows in the arrays."""


def band_with_neighbours(survey: Survey, rows: tuple[int, int]) -> tuple[int, int]:
    """Range of rows, widened by the neighbors that outlier tests need."""
    return max(rows[0] - 1, 0), min(rows[1] + 1, survey.scan.rows)


def gathered_band(
    recording: Recording,
    samples: Samples,
    at: tuple[NDArray[np.intp], ...],
    rows: tuple[int, int],
) -> Band:
    """Average the samples in a band of rows: signals, uncertainties, directions.

    `samples` has exactly the samples of `band_with_neighbours`; `at` has the indices of
    frequency, polarization, row and column of each.
    """
    survey = recording.survey
    begin, end = band_with_neighbours(survey, rows)
    shape = (
        len(recording.frequencies),
        len(recording.pairs),
        end - begin,
        survey.scan.columns,
    )
    at = (at[0], at[1], at[2] - begin, at[3])
    means = _gathered(samples, at, shape)
    azimuth, elevation, _ = scan_directions(survey, rows=slice(begin, end))
    return Band(
        means=means,
        uncertainty=_uncertainty(recording.described, survey, means),
        nearest=nearest_distance(means.signal),
        azimuth=_direction(samples.azimuth, at, azimuth),
        elevation=_direction(samples.elevation, at, elevation),
        rows=rows,
        inner=slice(rows[0] - begin, rows[1] - begin),
    )


def cube_of(
    recording: Recording, band: Band, typical: Floats, *, mean: bool, temperature: bool
) -> xr.Dataset:
    """Measurement cube of a band of rows, with outliers flagged.

    `typical` is the median difference of neighbors in each channel; `mean` and
    `temperature` state whether any row of the recording has these quantities.
    """
    survey, described = recording.survey, recording.described
    broken = _breakdowns(band, typical)[:, :, band.inner]
    means = band.means.rows(band.inner)
    uncertainty = band.uncertainty[:, :, band.inner]
    cube = cubes.build(
        "samples",
        {
            **_outputs(means, uncertainty, survey, described),
            "saturated": broken.astype(np.int8),
        },
        {
            "modulation_frequency": recording.frequencies,
            "polarization": recording.pairs,
            "azimuth": band.azimuth[band.inner],
            "elevation": band.elevation[band.inner],
        },
        geometry=geometry_attributes(survey),
        attributes=_attributes(
            recording.path, survey, recording.frequencies, recording.pairs
        ),
    )
    if recording.shots is not None:
        cube = cubes.attach(cube, recording.shots, "open_water")
    cube = cube.assign(
        _user_variables(means, broken, mean=mean, temperature=temperature)
    )
    return cubes.note(cube, "import recordings")


def marked(cube: xr.Dataset) -> dict[str, int]:
    """Count the samples of each import flag, and references without a number."""
    flag = cube["user_sample_flag"]
    counted = {
        word.replace("_", " "): int((flag.values & mask != 0).sum())
        for mask, word in zip(
            flag.attrs["flag_masks"], flag.attrs["flag_meanings"].split(), strict=True
        )
    }
    if "open_water_in_phase" in cube:
        lost = int(cube["open_water_in_phase"].isnull().sum())
        counted["open-water references without a usable number"] = lost
    return {word: count for word, count in counted.items() if count}


def is_measured(signal: Complex) -> NDArray[np.bool_]:
    """Mask of signals that contain a measurement: finite and not 0."""
    return np.asarray((signal != 0) & ~_is_none(signal))


def _is_none(signal: Complex) -> NDArray[np.bool_]:
    return np.asarray(~(np.abs(np.nan_to_num(signal, nan=np.inf)) < _NO_VOLTAGE))


def refuse_no_scan(path: Path, *, any_scan: bool) -> None:
    """Raise if a recording has open-water references but no scanned pixels."""
    if not any_scan:
        raise FormatError(
            f"{path}: holds open-water shots and no sample of the scan; check "
            "constants.open_water of the map"
        )


def shots_of(
    path: Path,
    samples: Samples,
    channel: tuple[NDArray[np.intp], NDArray[np.intp]],
    survey: Survey,
    described: RecordingMap,
    *,
    names: tuple[Floats, list[str]],
    scanned: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> xr.Dataset | None:
    """Open-water references of all scanned channels; None if there are none."""
    if not len(samples.water):
        return None
    missing = set(zip(*scanned, strict=True)) - set(zip(*channel, strict=True))
    if missing:
        f, p = min(missing)
        raise FormatError(
            f"{path}: the scan has {names[0][f] / 1e6:g} MHz {names[1][p]}, of "
            "which there is no open-water shot; record shots in all channels, or "
            "take out constants.open_water of the map"
        )
    usable = is_measured(samples.signal)
    for f, p in sorted(set(zip(*channel, strict=True))):
        if not usable[(channel[0] == f) & (channel[1] == p)].any():
            raise FormatError(
                f"{path}: no open-water shot at {names[0][f] / 1e6:g} MHz "
                f"{names[1][p]} is a number; record shots in all channels, or take out "
                "constants.open_water of the map"
            )
    return _shots(samples, channel, survey, described)


def _gathered(
    samples: Samples, at: tuple[NDArray[np.intp], ...], shape: tuple[int, ...]
) -> _Gathered:
    """Mean signal of the valid samples at each channel and pixel, with flags."""
    zero = samples.signal == 0
    none = _is_none(samples.signal)
    measured = is_measured(samples.signal)
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
    real = mean_of(samples.signal.real, measured)
    imaginary = mean_of(samples.signal.imag, measured)
    return _Gathered(
        signal=real + 1j * imaginary,
        mean=mean_of(samples.mean, measured),
        temperature=mean_of(samples.temperature, np.ones(len(flat), dtype=bool)),
        takes=np.bincount(flat[measured], minlength=size)
        .astype(np.int32)
        .reshape(shape),
        flag=flag.reshape(shape),
    )


def _direction(
    angle: Floats, at: tuple[NDArray[np.intp], ...], planned: Floats
) -> Floats:
    """Beam direction of each pixel: mean over all channels, else as planned [rad]."""
    flat = np.ravel_multi_index(at[2:], planned.shape)
    finite = np.isfinite(angle)
    count = np.bincount(flat[finite], minlength=planned.size)
    total = np.bincount(flat[finite], angle[finite], minlength=planned.size)
    mean = (total / np.maximum(count, 1)).reshape(planned.shape)
    return np.where(count.reshape(planned.shape) > 0, mean, planned)


def _uncertainty(described: RecordingMap, survey: Survey, means: _Gathered) -> Floats:
    """Return the noise of the mean in-phase or quadrature, without phase floor [V]."""
    takes = np.maximum(means.takes, 1)
    if described.constants.uncertainty is not None:
        return described.constants.uncertainty / np.sqrt(takes)
    detector = survey.instrument.detector
    volt = detector.volt_per_photoelectron_rate
    # Without a mean output the amplitude tells how much light there is at least.
    lower = np.abs(means.signal) / (survey.instrument.modulation_depth * volt)
    measured = np.maximum(means.mean / volt - detector.dark_rate, 0.0)
    rate = np.where(np.isfinite(means.mean), measured, lower)
    variance = counting_variance(
        survey, rate=np.nan_to_num(rate), integration_time=integration_time(survey)
    )
    return np.asarray(np.sqrt(variance / takes))


def _outputs(
    means: _Gathered, uncertainty: Floats, survey: Survey, described: RecordingMap
) -> dict[str, Floats]:
    """Return the outputs and their uncertainties as variables of a cube."""
    floor = survey.instrument.lock_in.phase_floor
    if described.constants.uncertainty is not None:
        floor = 0.0  # what is stated holds for all of it
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        means.signal, phase_floor=floor
    )
    return {
        "in_phase": means.signal.real,
        "quadrature": means.signal.imag,
        "in_phase_uncertainty": np.sqrt(uncertainty**2 + in_phase),
        "quadrature_uncertainty": np.sqrt(uncertainty**2 + quadrature),
        "in_phase_quadrature_covariance": covariance,
    }


def _breakdowns(band: Band, typical: Floats) -> NDArray[np.bool_]:
    """Mask of isolated samples that no mixture of their neighbors explains."""
    signal = band.means.signal
    beside = around(signal)
    far = np.maximum(_BREAKDOWN * typical, _SURE * band.uncertainty)
    broken = np.asarray(band.nearest > far)
    near = np.stack([neighbor[broken] for neighbor in beside])
    off, spread = off_mixtures(signal[broken], near)
    broken[broken] = off > np.maximum(far[broken], _SPREAD * spread)
    return broken


def _shots(
    samples: Samples,
    channel: tuple[NDArray[np.intp], NDArray[np.intp]],
    survey: Survey,
    described: RecordingMap,
) -> xr.Dataset:
    """Open-water references as a dataset, with outliers set to NaN."""
    number = turn(channel).astype(np.intp)
    sizes = channel[0].max() + 1, channel[1].max() + 1, number.max() + 1
    at = (*channel, np.zeros_like(number), number)
    shape = (*sizes[:2], 1, sizes[2])
    means = _gathered(samples, at, shape)
    uncertainty = _uncertainty(described, survey, means)
    middle = np.nanmedian(means.signal.real, axis=3, keepdims=True) + 1j * np.nanmedian(
        means.signal.imag, axis=3, keepdims=True
    )
    off = np.abs(means.signal - middle)
    typical = np.nanmedian(off, axis=3, keepdims=True)
    broken = off > np.maximum(_BREAKDOWN * typical, _SURE * uncertainty)
    means.signal[broken] = complex(np.nan, np.nan)
    outputs = {
        name: values[:, :, 0]
        for name, values in _outputs(means, uncertainty, survey, described).items()
    }
    coordinates = {}
    for name in ("azimuth", "elevation"):
        angle = getattr(samples, name)
        if np.isfinite(angle).all():
            total = np.bincount(number, angle) / np.bincount(number)
            coordinates[name] = np.asarray(total)
    return cubes.open_water({**outputs, **coordinates})


def _user_variables(
    means: _Gathered, broken: NDArray[np.bool_], *, mean: bool, temperature: bool
) -> dict[str, xr.Variable]:
    flag = (means.flag | np.int16(BREAKDOWN) * broken).astype(np.int16)
    masks = np.array([ZERO, BREAKDOWN, NO_NUMBER], dtype=np.int16)
    about = "problems of a sample, 0 if none"
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
            means.takes,
            {"long_name": "samples that were averaged", "units": "1"},
        ),
    }
    for name, values, unit, present in (
        ("mean output of the detector", means.mean, "V", mean),
        ("temperature of the water", means.temperature, "degC", temperature),
    ):
        if present:
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
