"""Calibrations at the bench: leakage behind a shutter, phase delays from a plate."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.acquisition import plan
from amulor.acquisition.cube.calibration import (
    Calibration,
    FrequencyCalibration,
    Leakage,
    ReferencePhase,
    TemperatureCoefficient,
    phase_correction,
)
from amulor.acquisition.cube.filters import measured_filters
from amulor.acquisition.cube.samples import Samples, counting_variance, procedure_of
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.sampler import SampleFlag
from amulor.errors import CubeError
from amulor.optics import detection, rays
from amulor.rejection.observation import Observation
from amulor.survey import Survey
from amulor.survey.properties import group_index_uncertainty

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Fraction of the rows and columns, in the middle, that show the plate.
_MIDDLE = 0.5
#: Relative standard uncertainty of the transmission of a neutral filter [1].
_TRANSMISSION_UNCERTAINTY = 0.05
#: Cubes of a temperature run, and the least difference of its temperatures [degC].
_FEWEST_TEMPERATURES, _LEAST_SPAN = 3, 2.0
#: Filters that separate leakage from phase against amplitude.
_FEWEST_FILTERS = 3


def from_shutter(recordings: Sequence[xr.Dataset]) -> Calibration:
    """Measure the leakage of an instrument with a closed shutter and the laser on.

    Parameters
    ----------
    recordings : sequence of xarray.Dataset
        Cubes of level `samples` with the attribute `shutter` = "closed", in the order
        of recording, such as one before the scan and one after it. They have the same
        frequencies and channels, and no calibration.

    Returns
    -------
    Calibration
        Leakage at each frequency and channel, as the mean of the cubes. That of the
        references is the mean of the open-water samples; without them, it is the
        leakage of the scan.

    Raises
    ------
    CubeError
        If there is no cube, or a cube is of another level, was recorded with an open
        shutter, has a calibration already, has other frequencies or channels than the
        first one, or has no sample of a channel.

    Notes
    -----
    The uncertainty has two parts: the standard error of the mean, and an even
    distribution over the change from the first cube to the last, change / sqrt(12).

    Examples
    --------
    >>> from amulor import acquisition, samples
    >>> closed = samples.cube("ladder").assign_attrs(shutter="closed")  # stands for one
    >>> calibration = acquisition.from_shutter([closed])
    >>> sorted({leak.polarization for leak in calibration.leakage})
    ['VH', 'VV']
    """
    if not recordings:
        raise CubeError("no cube was given; record one with the shutter closed first")
    first = recordings[0]
    parts: dict[str, list[tuple[Complex, Floats]]] = {"scan": [], "open_water": []}
    for cube in recordings:
        refuse_open_shutter(cube, first)
        dark = np.reshape(cube.attrs.get("dark_uncertainty", 0.0), (-1, 1))
        shots = cube.amulor.open_water
        for part, samples in (("scan", cube), ("open_water", shots)):
            mean, error = mean_output(cube if samples is None else samples)
            # All samples share the error of the subtracted dark output.
            shared = np.broadcast_to(dark, (error.size, 1)).reshape(error.shape)
            parts[part].append((mean, np.hypot(error, shared)))
    return Calibration(
        date=measured_on(first),
        leakage=mean_leakage(
            parts,
            frequencies=first["modulation_frequency"].values,
            channels=first.amulor.polarizations,
        ),
    )


def mean_leakage(
    parts: dict[str, list[tuple[Complex, Floats]]],
    *,
    frequencies: Floats,
    channels: Sequence[str],
) -> tuple[Leakage, ...]:
    """Return the leakage of each channel from its outputs at several times.

    Each output is a pair of mean and standard error, shape (frequency, channel) [V].
    """
    mean, error, change = {}, {}, {}
    for part, results in parts.items():
        signal = np.array([result[0] for result in results])
        errors = np.array([result[1] for result in results])
        mean[part], change[part] = signal.mean(axis=0), np.abs(signal[-1] - signal[0])
        statistical = np.sqrt((errors**2).sum(axis=0)) / len(results)
        error[part] = np.hypot(statistical, change[part] / math.sqrt(12))
    several = len(parts["scan"]) > 1
    return tuple(
        Leakage(
            modulation_frequency=float(frequency),
            polarization=channel,
            scan=_outputs(mean["scan"][i, j]),
            scan_uncertainty=error["scan"][i, j],
            open_water=_outputs(mean["open_water"][i, j]),
            open_water_uncertainty=error["open_water"][i, j],
            change=change["scan"][i, j] if several else None,
        )
        for i, frequency in enumerate(frequencies)
        for j, channel in enumerate(channels)
    )


def _outputs(value: complex) -> tuple[float, float]:
    return float(value.real), float(value.imag)


def refuse_open_shutter(cube: xr.Dataset, first: xr.Dataset) -> None:
    """Raise unless a cube was recorded behind the shutter, as the first one."""
    cubes.check(cube, "samples", name="the cube with the shutter closed")
    if cube.attrs.get("shutter") != "closed":
        raise CubeError(
            "the cube was not recorded with the shutter closed; record one with: "
            "amulor acquire --shutter-closed"
        )
    if "calibration" in cube.attrs:
        raise CubeError(
            "the cube with the shutter closed has a calibration already; make it "
            "again from its journal without one (amulor recover)"
        )
    if cube.amulor.polarizations != first.amulor.polarizations or not np.array_equal(
        cube["modulation_frequency"], first["modulation_frequency"]
    ):
        raise CubeError(
            "the cubes with the shutter closed differ in frequencies or channels; "
            "record all of them with one survey"
        )


def measured_on(cube: xr.Dataset) -> datetime.date | None:
    """Return the day on which a cube was measured; None if it has no time."""
    start = cube.attrs.get("time_coverage_start")
    return None if start is None else datetime.datetime.fromisoformat(start).date()


def shutter_leakage(
    survey: Survey,
    journal: Journal,
    dark: tuple[Complex, Floats],
    frequency: Floats,
) -> tuple[Leakage, ...]:
    """Return the leakage by closed-shutter readings of a scan; empty if there are none.

    The readings before, during and after the scan are averaged.
    """
    recorded = [*journal.samples(plan.SHUTTER)]
    if not recorded:
        return ()
    procedure = procedure_of(journal)
    readings = procedure.shutter_readings or 1
    blocks = sorted({key.repeat // readings for key, _ in recorded})
    number = {block: at for at, block in enumerate(blocks)}
    samples = Samples(survey, len(blocks), readings)
    for key, record in recorded:
        if not record.flags & SampleFlag.OVERLOAD:
            block, reading = divmod(key.repeat, readings)
            samples.put(key, record, number[block], reading)
    samples["signal"][...] -= dark[0][:, :, None, None]
    variance = counting_variance(samples, survey, procedure)
    # A block that an interruption cut short has not all channels.
    whole = np.isfinite(samples["signal"]).any(axis=3).all(axis=(0, 1))
    # The dark output is common to all blocks.
    results = [
        _mean_of(samples["signal"][:, :, at], variance[:, :, at])
        for at in np.flatnonzero(whole)
    ]
    if not results:
        return ()
    results = [(mean, np.sqrt(error**2 + dark[1])) for mean, error in results]
    return mean_leakage(
        {"scan": results, "open_water": results},
        frequencies=frequency,
        channels=survey.instrument.polarizations,
    )


def mean_output(samples: xr.Dataset) -> tuple[Complex, Floats]:
    """Return the mean output of each channel and its standard error [V]."""
    signal = samples.amulor.signal.values
    errors = Observation(cube=samples).covariance
    flat = signal.reshape(*signal.shape[:2], -1)
    if not np.isfinite(flat).any(axis=2).all():
        raise CubeError(
            "a channel has no sample with the shutter closed; record it with: amulor "
            "acquire --shutter-closed"
        )
    variance = ((errors.in_phase + errors.quadrature) / 2).reshape(flat.shape)
    return _mean_of(flat, variance)


def _mean_of(signal: Complex, variance: Floats) -> tuple[Complex, Floats]:
    """Return mean and standard error of readings along the last axis [V].

    The error is that of the scatter or of the stated variances of an output, whichever
    is larger.
    """
    valid = np.isfinite(signal)
    count = np.maximum(valid.sum(axis=-1), 1)
    mean = np.where(valid, signal, 0).sum(axis=-1) / count
    off = np.where(valid, np.abs(signal - mean[..., None]) ** 2, 0.0)
    scatter = off.sum(axis=-1) / 2 / np.maximum(count - 1, 1)
    stated = np.where(valid, variance, 0.0).sum(axis=-1) / count
    return mean, np.sqrt(np.maximum(scatter, stated) / count)


def from_reference(cube: xr.Dataset) -> Calibration:
    """Return the phases of the standing reference in a cube, as a calibration.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube of level `samples` of a plate, from a survey with `[scan.reference]`.

    Returns
    -------
    Calibration
        Phase of the reference in each channel, its uncertainty, and its changes.

    Raises
    ------
    CubeError
        If the cube is of another level, or has no readings of a reference.

    Examples
    --------
    >>> from amulor import Survey, acquisition, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "scan.columns": 3,
    ...         "scan.rows": 4,
    ...         "scan.reference": {
    ...             "azimuth": "12 deg",
    ...             "elevation": "0 deg",
    ...             "amplitude": "20 mV",
    ...         },
    ...     }
    ... )
    >>> cube = simulation.simulate(survey, rng=1, model=simulation.ClosureModel())
    >>> calibration = acquisition.from_reference(cube)
    >>> print(f"{calibration.reference[0].uncertainty:.0e} rad")
    1e-04 rad
    """
    cubes.check(cube, "samples", name="the cube with the standing reference")
    if "reference_phase_rad" not in cube.attrs:
        raise CubeError(
            "the cube has no readings of a standing reference; record it with the "
            "section [scan.reference] in the survey"
        )
    frequencies, channels = cube["modulation_frequency"], cube.amulor.polarizations
    shape = len(frequencies), len(channels)
    phase, time, change = (
        np.reshape(cube.attrs[f"reference_{name}"], (*shape, -1))
        for name in ("phase_rad", "time_s", "drift_rad")
    )
    error = np.atleast_1d(cube.attrs["reference_phase_uncertainty_rad"])
    return Calibration(
        date=measured_on(cube),
        reference=tuple(
            ReferencePhase(
                modulation_frequency=float(frequency),
                polarization=channel,
                phase=float(phase[i, j, 0]),
                uncertainty=float(error[i]),
                times=tuple((time[i, j] - time.min()).tolist()),
                changes=tuple(change[i, j].tolist()),
            )
            for i, frequency in enumerate(frequencies.values)
            for j, channel in enumerate(channels)
        ),
    )


def from_temperatures(plates: Sequence[xr.Dataset]) -> Calibration:
    """Measure the dependence of the phase on the temperature of the instrument.

    Parameters
    ----------
    plates : sequence of xarray.Dataset
        At least three cubes of level `target_signal` of a plate that stands still, at
        instrument temperatures that differ by 2 degC or more. Their surveys state
        `scan.instrument_temperature`.

    Returns
    -------
    Calibration
        Phase per degree at each frequency, by a weighted straight line through the
        phases of the strongest channel. The reference is the mean temperature.

    Raises
    ------
    CubeError
        If there are too few cubes or temperatures, a temperature is not recorded, or a
        cube is of another level, has calibrated phases, or shows no plate.

    Notes
    -----
    If the phases scatter about the line by more than their errors, the uncertainty
    grows by the square root of the reduced chi-square.

    Examples
    --------
    >>> from amulor import Survey, acquisition, rejection, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "scan.columns": 8,
    ...         "scan.rows": 8,
    ...         "scan.open_water": None,
    ...         "water.absorption": "0.05 1/m",
    ...         "water.scattering": "0.001 1/m",
    ...     }
    ... )
    >>> run = []
    >>> for value in (10, 20, 30):
    ...     warm = {"temperature": value, "delay_per_degree": "20 ps"}
    ...     cube = simulation.simulate(
    ...         survey.with_(
    ...             {
    ...                 "scan.instrument_temperature": value,
    ...                 "instrument.errors": {"temperature": warm},
    ...             }
    ...         ),
    ...         rng=1,
    ...     )
    ...     run.append(rejection.keep_water(cube))
    >>> calibration = acquisition.from_temperatures(run)
    >>> change = calibration.temperature[0].phase_per_degree
    >>> print(f"{1e3 * change:.1f} mrad per degree")  # 2 pi 39 MHz times 20 ps: 4.9
    4.9 mrad per degree
    """
    if len(plates) < _FEWEST_TEMPERATURES:
        raise CubeError(
            f"{len(plates)} cubes; at least {_FEWEST_TEMPERATURES} are needed, at "
            "different temperatures"
        )
    surveys = [cube.amulor.survey for cube in plates]
    stated = [s.scan.instrument_temperature if s else None for s in surveys]
    if None in stated:
        raise CubeError(
            f"cube {stated.index(None) + 1} states no temperature; state "
            "scan.instrument_temperature in the survey of each recording"
        )
    temperature = np.array(stated, dtype=float)
    if np.ptp(temperature) < _LEAST_SPAN:
        raise CubeError(
            f"the temperatures differ by {np.ptp(temperature):.2g} degC; at least "
            f"{_LEAST_SPAN:g} degC are needed"
        )
    # The path is common to all cubes, so that any distance does.
    sums = [_plate_sums(cube, 1.0) for cube in plates]
    mean, error = (np.array([values[k] for values in sums]) for k in (0, 1))
    order, reference = np.argsort(temperature), float(temperature.mean())
    entries = []
    for number, frequency in enumerate(plates[0]["modulation_frequency"].values):
        strongest = int(np.argmax(np.abs(np.nan_to_num(mean[0, number]))))
        signal = mean[order, number, strongest]
        if not np.isfinite(signal).all():
            raise CubeError(
                f"no pixel in the middle of the scan shows a target at "
                f"{frequency / 1e6:g} MHz; let the plate fill the middle half of "
                "the scan"
            )
        weight = np.abs(signal) / error[order, number, strongest]
        warmer = temperature[order] - reference
        # Relative to the first phase, which a whole turn must not divide.
        phase = np.unwrap(np.angle(signal / signal[0]))
        design = np.stack([np.ones(warmer.size), warmer], axis=1) * weight[:, None]
        covariance = np.linalg.inv(design.T @ design)
        level, slope = covariance @ design.T @ (phase * weight)
        rest = (phase - level - slope * warmer) * weight
        excess = max(float(rest @ rest) / (warmer.size - 2), 1.0)
        entries.append(
            TemperatureCoefficient(
                modulation_frequency=float(frequency),
                phase_per_degree=float(slope),
                uncertainty=math.sqrt(covariance[1, 1] * excess),
                temperatures=tuple(temperature[order].tolist()),
                phases=tuple((phase - level).tolist()),
            )
        )
    before = applied(plates)
    return Calibration(
        date=measured_on(plates[0]),
        leakage=before.get("leakage", ()),
        temperature=tuple(entries),
        reference_temperature=reference,
    )


def from_plates(
    plates: Sequence[xr.Dataset],
    *,
    distance: float | Sequence[float],
    distance_uncertainty: float | None = None,
    densities: Sequence[float] | None = None,
) -> Calibration:
    r"""Calibrate the phase delay of an instrument with a plate at known distances.

    Parameters
    ----------
    plates : sequence of xarray.Dataset
        Cubes of level `target_signal`, recorded without calibrated phases. The plate is
        the only target. Several cubes differ by density filters, by the distance of the
        plate, or by both.
    distance : float or sequence of float
        Forward coordinate of the plate, above zero: one for all cubes, or one for each
        [m]. The plate is perpendicular to the forward axis.
    distance_uncertainty : float, optional
        Standard uncertainty of each distance [m]. Without it, the uncertainty of the
        common delay is unknown.
    densities : sequence of float, optional
        Optical density of the filter of each cube [1], at least three at the first
        distance. The fit S = T y + L then separates leakage from the dependence of the
        phase on the amplitude. The transmissions T are measured, too, and with signals
        of different strength the change of the gain.

    Returns
    -------
    Calibration
        For each frequency, the delay at the mean amplitude of each cube at the first
        distance, from the strongest channel in the middle half of rows and columns.
        Several distances add their mean delay, its error by frequency, and a
        measurement of the group index.

    Raises
    ------
    CubeError
        If a cube is of another level, has calibrated phases, or shows no plate.
    ValueError
        If a distance is not above zero, or the numbers of cubes, distances and
        densities do not fit.

    Notes
    -----
    The delay is the phase of the sum of all samples, after subtraction of the phase of
    each path. That is 2 pi f / c times the group index times the length to the plate
    and back to the receiver. Wrong distances and a wrong group index change this phase
    in proportion to the frequency. The remainder, pooled over frequencies and
    distances, is the error by frequency.

    Examples
    --------
    >>> from amulor import Survey, acquisition, rejection, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "water.absorption": "0.05 1/m",
    ...         "water.scattering": "0.001 1/m",
    ...         "instrument.modulation_frequencies": ["40 MHz"],
    ...         "scan.open_water": None,
    ...     }
    ... )
    >>> import tempfile
    >>> from pathlib import Path
    >>> def scene(survey):
    ...     return simulation.scene_light(survey, model=simulation.ClosureModel())
    >>> settings = acquisition.Settings(
    ...     simulation={"cable_delay": "1 ns"}, procedure={"dark_readings": 0}
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = acquisition.acquire(
    ...         survey, Path(folder) / "scan", settings=settings, scene=scene
    ...     )
    ...     with acquisition.Journal.read(Path(folder) / "scan") as journal:
    ...         plate = rejection.keep_water(acquisition.build(journal))
    >>> calibration = acquisition.from_plates([plate], distance=1.5)
    >>> delay = calibration.frequencies[0].phases[0]
    >>> print(f"{delay:.2f} rad")  # 2 pi f times 1 ns: 0.25
    0.25 rad
    """
    distances = _distances(distance, len(plates))
    if not plates:
        raise CubeError("no cube was given; record the plate first")
    first_distance = distances == distances[0]
    density = None if densities is None else np.asarray(densities, dtype=float)
    if density is not None and (
        len(density) != len(plates) or first_distance.sum() < _FEWEST_FILTERS
    ):
        raise ValueError(
            f"{len(density)} densities for {len(plates)} cubes; state one for each "
            f"cube, and record the plate through at least {_FEWEST_FILTERS} filters "
            "at the first distance"
        )
    sums = [
        _plate_sums(cube, length)
        for cube, length in zip(plates, distances, strict=True)
    ]
    mean, error, path = (np.array([values[k] for values in sums]) for k in (0, 1, 2))
    first = plates[0]
    before = applied(plates)
    entries, leakage, rest = [], [*before.get("leakage", ())], []
    stray = np.full((2, *mean.shape[1:]), complex(np.nan, np.nan))
    for number, frequency in enumerate(first["modulation_frequency"].values):
        strongest = int(np.argmax(np.abs(np.nan_to_num(mean[0, number]))))
        if not np.isfinite(mean[:, number, strongest]).all():
            raise CubeError(
                f"no pixel in the middle of the scan shows a target at "
                f"{frequency / 1e6:g} MHz; let the plate fill the middle half of "
                "the scan"
            )
        signal = mean[:, number, strongest]
        sigma = error[:, number, strongest]
        if density is None:
            entry = _table(float(frequency), signal, sigma, first_distance)
        else:
            fits = [
                _fit_filters(
                    10.0 ** -density[first_distance],
                    mean[first_distance, number, channel],
                    error[first_distance, number, channel],
                )
                if np.isfinite(mean[:, number, channel]).all()
                else None
                for channel in range(mean.shape[2])
            ]
            for at, (name, fit) in enumerate(
                zip(first.amulor.polarizations, fits, strict=True)
            ):
                if fit is not None:
                    stray[:, number, at] = fit[3:]
                    turn = path[0, number, at]
                    leakage = _with_leakage(
                        leakage, float(frequency), name, fit[3] / turn,
                        fit[4] / abs(turn),
                    )  # fmt: skip
            fitted = fits[strongest]
            assert fitted is not None
            turns = path[:, number, strongest]
            signal = signal - fitted[3] * turns / turns[0]
            entry = _table_of(float(frequency), *fitted[:3])
        entries.append(entry)
        rest.append(_rest(entry, signal[~first_distance]))
    table = Calibration(
        date=measured_on(first),
        frequencies=tuple(entries),
        leakage=tuple(leakage),
        reference=before.get("reference", ()),
        temperature=before.get("temperature", ()),
        reference_temperature=before.get("reference_temperature"),
        delay_uncertainty=_delay_uncertainty(first, distances, distance_uncertainty),
    )
    if density is not None:
        part = slice(None) if first_distance.all() else first_distance
        shape = int(first_distance.sum()), -1
        echo = np.abs(mean[part] - stray[0]).reshape(shape)
        filters, gain = measured_filters(
            density[part],
            echo,
            error[part].reshape(shape),
            leakage=float(np.nanmin(stray[1].real.ravel() / echo.max(axis=0))),
        )
        change, of_change = (None, None) if gain is None else gain
        update = {
            "filters": filters,
            "gain_change": change,
            "gain_change_uncertainty": of_change,
            "gain_amplitude": None if gain is None else float(np.nanmax(echo)),
        }
        table = table.model_copy(update=update)
    if first_distance.all():
        return table
    return _over_distances(
        table, np.array(rest), distances, first, distance_uncertainty
    )


def _distances(distance: float | Sequence[float], count: int) -> Floats:
    """Return the plate distance of each cube [m]."""
    distances = np.asarray(distance, dtype=float)
    if distances.ndim and distances.size != count:
        raise ValueError(
            f"{distances.size} distances for {count} cubes; state one distance, or one "
            "for each cube"
        )
    if not np.all(distances > 0):
        raise ValueError(f"distance must be above 0 m, got {distances.min():g} m")
    return np.broadcast_to(distances, (count,))


def _table(
    frequency: float, signal: Complex, sigma: Floats, part: NDArray[np.bool_]
) -> FrequencyCalibration:
    """Return the calibration of phase by amplitude from selected plate cubes."""
    amplitudes = np.abs(signal[part])
    return _table_of(
        frequency, amplitudes, np.angle(signal[part]), sigma[part] / amplitudes
    )


def _table_of(
    frequency: float, amplitudes: Floats, phases: Floats, uncertainties: Floats
) -> FrequencyCalibration:
    """Return a calibration by rising amplitude, with the mean of equal amplitudes."""
    order = np.argsort(amplitudes)
    rising, place = np.unique(amplitudes, return_inverse=True)

    def averaged(values: Floats) -> tuple[float, ...]:
        return tuple((np.bincount(place[order], values) / np.bincount(place)).tolist())

    return FrequencyCalibration(
        modulation_frequency=frequency,
        amplitudes=tuple(rising.tolist()),
        phases=averaged(np.unwrap(phases[order])),
        phase_uncertainties=averaged(uncertainties[order]),
    )


def _rest(entry: FrequencyCalibration, signal: Complex) -> Floats:
    """Return the phases of signals minus the phases in the table [rad]."""
    expected, _ = phase_correction(
        Calibration(frequencies=(entry,)),
        np.abs(signal),
        modulation_frequency=entry.modulation_frequency,
    )
    return np.asarray(np.angle(signal * np.exp(-1j * expected)))


def _over_distances(
    table: Calibration,
    rest: Floats,
    distances: Floats,
    cube: xr.Dataset,
    uncertainty: float | None,
) -> Calibration:
    """Average phases over distances; add phase errors; estimate the group index.

    `rest` are the phases beyond the table, shape (frequency, further cubes) [rad].
    """
    where = np.concatenate([distances[:1], distances[distances != distances[0]]])
    rest = np.concatenate([np.zeros((len(rest), 1)), rest], axis=1)
    omega = 2 * np.pi * np.array([e.modulation_frequency for e in table.frequencies])
    delay = omega @ rest / (omega @ omega)
    shift = rest.mean(axis=1)
    odd = rest - omega[:, None] * delay
    odd = odd - odd.mean(axis=1, keepdims=True)
    freedom = (len(omega) - 1) * (where.size - 1)
    # One frequency does not show an error by frequency.
    by_frequency = math.sqrt(np.sum(odd**2) / freedom / where.size) if freedom else 0.0
    entries = tuple(
        entry.model_copy(
            update={
                "phases": tuple(phase + more for phase in entry.phases),
                "phase_uncertainties": tuple(
                    math.hypot(value, by_frequency)
                    for value in entry.phase_uncertainties
                ),
            }
        )
        for entry, more in zip(table.frequencies, shift.tolist(), strict=True)
    )
    # Path there and back per unit of the group index, as a time.
    time = 2 * (where - where.mean()) / speed_of_light
    index = float(cube.amulor.geometry["group_index"])
    change = float(time @ delay / (time @ time))
    index_error = None
    if uncertainty is not None:
        phase_error = max(entry.phase_uncertainties[-1] for entry in entries)
        of_delay = math.hypot(
            2 * index * uncertainty / speed_of_light, phase_error / omega.max()
        )
        index_error = of_delay / math.sqrt(time @ time)
    return table.model_copy(
        update={
            "frequencies": entries,
            "group_index": index + change,
            "group_index_uncertainty": index_error,
        }
    )


def _delay_uncertainty(
    cube: xr.Dataset, distances: Floats, uncertainty: float | None
) -> float | None:
    """Return the delay uncertainty due to distances and group index [s]."""
    if uncertainty is None:
        return None
    survey = cube.amulor.survey
    index = None if survey is None else group_index_uncertainty(survey)
    several = np.unique(distances)
    group_index = float(cube.amulor.geometry["group_index"])
    of_distance = group_index * uncertainty / math.sqrt(several.size)
    of_index = float(several.mean()) * (index or 0.0)
    return 2 * math.hypot(of_distance, of_index) / float(speed_of_light)


def applied(plates: Sequence[xr.Dataset]) -> dict[str, Any]:
    """Return the calibration applied to the plate cubes; raise if references differ."""
    phases = {tuple(cube.attrs.get("reference_phase_rad", ())) for cube in plates}
    if len(phases) > 1:
        raise CubeError(
            "the cubes of the plate refer to different phases of the standing "
            "reference; make one file from the first one (amulor calibrate reference), "
            "and apply it to all (amulor recover --calibration)"
        )
    text = plates[0].attrs.get("calibration")
    return {} if text is None else dict(Calibration.from_text(text))


def _with_leakage(
    leakage: Sequence[Leakage], frequency: float, channel: str, more: complex,
    uncertainty: float,
) -> list[Leakage]:  # fmt: skip
    """Return the leakage entries, with an excess added to that of one channel."""
    at = (frequency, channel)
    result = [e for e in leakage if (e.modulation_frequency, e.polarization) != at]
    for entry in leakage:
        if (entry.modulation_frequency, entry.polarization) == at:
            total = math.hypot(entry.scan_uncertainty, uncertainty)
            changed = {
                "scan": _outputs(complex(*entry.scan) + more),
                "scan_uncertainty": total,
            }
            return [*result, entry.model_copy(update=changed)]
    return [
        *result,
        Leakage(
            modulation_frequency=frequency,
            polarization=channel,
            scan=_outputs(more),
            scan_uncertainty=uncertainty,
            open_water=(0.0, 0.0),
            open_water_uncertainty=0.0,
        ),
    ]


def _plate_sums(cube: xr.Dataset, distance: float) -> tuple[Complex, Floats, Complex]:
    """Return the plate's mean signal, path phase removed, and its uncertainty [V].

    The third array is the mean factor that removes the phase of the path. A leakage has
    no path: it appears in the mean signal times this factor. Shape (frequency,
    polarization); NaN in a channel without a usable pixel.
    """
    _refuse(cube)
    middle = _middle(cube)
    signal = _plate_signal(middle)
    path = _optical_path(middle, distance)
    frequency = cube["modulation_frequency"].values[:, None, None, None]
    turn = np.exp(-2j * np.pi * frequency * path / speed_of_light)
    turned = signal * turn
    usable = (middle["quality_flag"].values & cubes.UNUSABLE) == 0
    usable &= np.isfinite(turned)
    variance = _across(turned, signal, middle, "")
    shared = (
        _across(turned, signal, middle, "common_")
        if "common_covariance" in middle
        else np.zeros(signal.shape)
    )
    mean = np.full(signal.shape[:2], complex(np.nan, np.nan))
    factor, error = mean.copy(), np.full(signal.shape[:2], np.nan)
    turn = np.broadcast_to(turn, signal.shape)
    for at in np.ndindex(mean.shape):
        values = turned[at][usable[at]]
        if values.size == 0:
            continue
        mean[at] = values.mean()
        factor[at] = turn[at][usable[at]].mean()
        alone = np.mean(np.maximum(variance[at] - shared[at], 0.0)[usable[at]])
        # Scatter across the mean phasor turns its phase.
        rest = (values * np.exp(-1j * np.angle(mean[at]))).imag
        scatter = rest.var(ddof=1) if values.size > 1 else 0.0
        common = np.mean(shared[at][usable[at]])
        error[at] = math.sqrt(max(alone, scatter) / values.size + common)
    return mean, error, factor


def _across(turned: Complex, signal: Complex, cube: xr.Dataset, prefix: str) -> Floats:
    """Return the variance of samples perpendicular to their phasor [V^2]."""
    cross = cube["common_covariance"] if prefix else cube.amulor.covariance
    usable = np.isfinite(turned) & (signal != 0)
    phase = detection.phase_uncertainty(
        np.where(usable, signal, 1.0),
        in_phase_variance=np.where(
            usable, cube[f"{prefix}in_phase_uncertainty"].values ** 2, 0.0
        ),
        quadrature_variance=np.where(
            usable, cube[f"{prefix}quadrature_uncertainty"].values ** 2, 0.0
        ),
        covariance=np.where(usable, cross.values, 0.0),
    )
    return np.asarray((phase * np.abs(np.where(usable, signal, 0.0))) ** 2)


def _fit_filters(
    transmission: Floats, signal: Complex, sigma: Floats
) -> tuple[Floats, Floats, Floats, complex, float]:
    """Fit signals behind filters: amplitude, phase (with error), leakage (with error).

    The transmission is uncertain, so the signals are uncertain along their phasor.
    """
    from scipy.optimize import least_squares

    order = np.argsort(-transmission)
    decades = np.log10(transmission)
    bright = signal[order[0]] / transmission[order[0]]
    axis = bright / abs(bright)
    along = np.hypot(sigma, _TRANSMISSION_UNCERTAINTY * transmission * abs(bright))

    def light(values: Floats) -> Complex:
        phase = values[1] + values[2] * decades
        return np.asarray(transmission * values[0] * bright * np.exp(1j * phase))

    def residuals(values: Floats) -> Floats:
        leak = abs(bright) * axis * complex(values[3], values[4])
        rest = (signal - light(values) - leak) / axis
        return np.concatenate([rest.real / along, rest.imag / sigma])

    fit = least_squares(residuals, [1.0, 0.0, 0.0, 0.0, 0.0], x_scale="jac")
    freedom = 2 * signal.size - 5
    excess = max(2 * float(fit.cost) / freedom, 1.0)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * excess
    of_phase = np.stack([np.ones(signal.size), decades])
    phase_error = np.sqrt(
        np.einsum("in,ij,jn->n", of_phase, covariance[1:3, 1:3], of_phase)
    )
    model = light(fit.x)
    leak = complex(abs(bright) * axis * complex(fit.x[3], fit.x[4]))
    # The larger of the two directions.
    leak_error = abs(bright) * math.sqrt(max(covariance[3, 3], covariance[4, 4]))
    return np.abs(model), np.angle(model), phase_error, leak, leak_error


def _plate_signal(cube: xr.Dataset) -> NDArray[np.complex128]:
    """Return the plate's signal minus the estimated residual water signal [V]."""
    signal = np.asarray(cube.amulor.signal.values)
    if "residual_in_phase" not in cube:
        return signal
    residual = cube["residual_in_phase"] + 1j * cube["residual_quadrature"]
    return np.asarray(signal - np.nan_to_num(residual.values))


def _refuse(cube: xr.Dataset) -> None:
    cubes.check(cube, "target_signal", name="the cube of the plate")
    text = cube.attrs.get("calibration")
    if text is not None and Calibration.from_text(text).frequencies:
        raise CubeError(
            "the cube of the plate has a calibration already; make it again from its "
            "journal without one (amulor recover, without --calibration)"
        )


def _middle(cube: xr.Dataset) -> xr.Dataset:
    def part(size: int) -> slice:
        edge = int(size * (1 - _MIDDLE) / 2)
        return slice(edge, size - edge)

    return cube.isel(row=part(cube.sizes["row"]), column=part(cube.sizes["column"]))


def _optical_path(cube: xr.Dataset, distance: float) -> NDArray[np.float64]:
    geometry = cube.amulor.geometry
    window = {
        key: float(geometry[key])
        for key in (
            "window_distance",
            "window_thickness",
            "window_refractive_index",
            "window_group_index",
        )
        if key in geometry
    }
    medium = rays.Medium(
        refractive_index=float(geometry["refractive_index"]),
        group_index=float(geometry["group_index"]),
        **window,
    )
    directions = rays.direction(cube["azimuth"].values, cube["elevation"].values)
    beam = rays.enter_water(geometry["emitter_position"], directions, medium=medium)
    length = (distance - beam.entry[..., 2]) / beam.direction[..., 2]
    point = beam.entry + beam.direction * length[..., None]
    return np.asarray(
        beam.optical_length_before
        + medium.group_index * length
        + rays.return_length(point, geometry["receiver_position"], medium=medium)
    )
