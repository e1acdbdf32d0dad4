"""Measurement cube of a scan, built from its journal."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.acquisition import plan
from amulor.acquisition.cube.calibrate import shutter_leakage
from amulor.acquisition.cube.calibration import (
    UNCALIBRATED,
    Calibration,
    calibrated,
)
from amulor.acquisition.cube.samples import (
    MISSING,
    Floats,
    Samples,
    counting_variance,
    dark_output,
    entry,
    identities_of,
    phase_drift,
    procedure_of,
    read_back_frequencies,
)
from amulor.acquisition.devices import is_simulated
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import EXTRA, QUANTITIES
from amulor.acquisition.navigation import (
    RecordedTrajectory,
    line_steps,
    middle_times,
    recorded_trajectory,
    speed_advice,
)
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.cube.phase_drift import PhaseDrift
from amulor.errors import CubeError, FormatError
from amulor.io import read_cube, write_cube
from amulor.io.trajectories import write_trajectory
from amulor.optics import detection
from amulor.survey import Survey
from amulor.survey.counting import photon_noise_volt
from amulor.survey.directions import scan_directions
from amulor.survey.view import geometry_attributes

#: File name of the cube in the folder of its scan.
CUBE_NAME = "cube.nc"
#: Resolution of the outputs of a lock-in over their full scale: 20 bits [1].
_RESOLUTION = 1e-6
#: Largest number of messages on damaged rows; for more rows, their number is stated.
_MOST_LINES = 20
#: Difference of scan and open water that shows a target, in standard errors [1].
_SIGNIFICANT = 5.0
_SAMPLE = ("modulation_frequency", "polarization", "row", "column")
_PIXEL = ("row", "column")


def recover(
    folder: Path,
    *,
    output: Path | None = None,
    calibration: Calibration | None = None,
    overwrite: bool = False,
    told: Callable[[str], None] = lambda line: None,
    damaged: Callable[[str], None] | None = None,
) -> Path:
    """Build the cube of a scan, finished or not, from its journal, and write it.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of the scan.
    output : pathlib.Path, optional
        File to write; by default `cube.nc` in the folder.
    calibration : Calibration, optional
        Phase delays of the instrument, which are subtracted from the phases.
    overwrite : bool
        Whether an existing file is replaced.
    told : callable
        Function called with a line of text for each damaged row of the journal, which
        is omitted; with more than 20 rows, with their number.
    damaged : callable, optional
        Function called with these lines instead of `told`.

    Returns
    -------
    pathlib.Path
        Path of the file, which was read back and compared with the journal. The journal
        stays in place.

    Raises
    ------
    FormatError
        If there is no journal, or the file cannot be written or read back.
    CubeError
        If the journal holds no sample of the scan.

    Examples
    --------
    >>> from amulor import Survey, acquisition, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "scan.open_water": None,
    ...     }
    ... )
    >>> import tempfile
    >>> from pathlib import Path
    >>> def scene(survey):
    ...     return simulation.scene_light(survey, model=simulation.ClosureModel())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = acquisition.acquire(survey, Path(folder) / "scan", scene=scene)
    ...     path = acquisition.recover(Path(folder) / "scan")
    ...     path.name
    'cube.nc'
    """
    path = folder / CUBE_NAME if output is None else output
    with Journal.read(folder) as journal:
        survey = Survey.from_text(
            entry(journal, "survey"), name="the survey of the journal"
        )
        recorded = recorded_trajectory(journal, survey)
        cube = _built(journal, survey, recorded, calibration)
        lines = journal.damage()
    for line in lines[:_MOST_LINES]:
        (damaged or told)(f"{folder}: {line}")
    if len(lines) > _MOST_LINES:
        more = len(lines) - _MOST_LINES
        (damaged or told)(f"{folder}: and {more} more rows like these")
    if recorded is not None:
        _write_trajectory(recorded, cube, trajectory_path(path), told, overwrite)
        steps = line_steps(recorded, middle_times(cube["reading_time"].values))
        for line in speed_advice(steps, survey):
            told(line)
    write_cube(cube, path, overwrite=overwrite)
    result = read_cube(path)
    for name, variable in cube.variables.items():
        if not _same(np.asarray(result[name].values), np.asarray(variable.values)):
            raise FormatError(
                f"{path} does not hold what was written to it ({name}); check the "
                f"disk, and make the cube again with: amulor recover {folder} "
                "--overwrite"
            )
    return path


def trajectory_path(path: Path) -> Path:
    """Return the file of the trajectory beside a cube."""
    return path.with_suffix(".trajectory.csv")


def _write_trajectory(
    recorded: RecordedTrajectory,
    cube: xr.Dataset,
    path: Path,
    told: Callable[[str], None],
    overwrite: bool,
) -> None:
    """Write the trajectory of a scan, and describe its irregularities."""
    for line in recorded.lines:
        told(line)
    lost = int((cube["user_sample_flag"].values & SampleFlag.NO_POSE != 0).sum())
    if lost:
        told(f"navigation: {lost} of {cube['in_phase'].size} samples have no pose")
    if recorded.trajectory is not None:
        write_trajectory(recorded.trajectory, path, overwrite=overwrite)
    elif overwrite:
        # That of an earlier cube does not belong to this one.
        path.unlink(missing_ok=True)


def _same(first: NDArray[Any], second: NDArray[Any]) -> bool:
    number = second.dtype.kind in "fc"
    return bool(np.array_equal(first, second, equal_nan=number))


def build(journal: Journal, *, calibration: Calibration | None = None) -> xr.Dataset:
    """Build the cube of the samples in a journal.

    Parameters
    ----------
    journal : Journal
        Journal of a scan, finished or not; missing samples become NaN.
    calibration : Calibration, optional
        Phase delays of the instrument, which are subtracted from the phases.

    Returns
    -------
    xarray.Dataset
        Cube of level `samples`, with the group `open_water` if there were shots.

    Raises
    ------
    CubeError
        If there is no sample of the scan.
    FormatError
        If a frequency was not calibrated.

    Notes
    -----
    The mean of a channel's dark readings is subtracted from its samples. If the survey
    has a standing reference, the drift of its phase is then subtracted. The variance
    is the sum of counting noise, the phase floor of the survey, and the variance of
    that mean. Counting noise follows from the mean output of the detector. If the mean
    output is not connected, it follows from the amplitude, as a lower limit. The cube
    has the modulation frequencies that the instrument reads back, since ranges follow
    from them; the survey has the commanded ones.

    Examples
    --------
    >>> from amulor import Survey, acquisition, simulation
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.polarizations": ["VV"],
    ...         "scan.columns": 3,
    ...         "scan.rows": 2,
    ...         "scan.open_water": None,
    ...     }
    ... )
    >>> import tempfile
    >>> from pathlib import Path
    >>> def scene(survey):
    ...     return simulation.scene_light(survey, model=simulation.ClosureModel())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = acquisition.acquire(survey, Path(folder) / "scan", scene=scene)
    ...     with acquisition.Journal.read(Path(folder) / "scan") as journal:
    ...         cube = acquisition.build(journal)
    >>> cube.sizes["row"], cube.sizes["column"]
    (2, 3)
    """
    survey = Survey.from_text(
        entry(journal, "survey"), name="the survey of the journal"
    )
    recorded = recorded_trajectory(journal, survey)
    return _built(journal, survey, recorded, calibration)


def _built(
    journal: Journal,
    survey: Survey,
    recorded: RecordedTrajectory | None,
    calibration: Calibration | None,
) -> xr.Dataset:
    """Build the cube of a journal with the trajectory of its vehicle."""
    meta = journal.meta()
    scan = Samples(survey, survey.scan.rows, survey.scan.columns)
    scan.fill(journal, plan.SCAN)
    if not np.isfinite(scan["signal"]).any():
        lines = journal.damage()
        if lines:
            raise CubeError(
                f"{journal.folder} holds no undamaged sample of the scan; the first of "
                f"{len(lines)} errors is: {lines[0]}; take a copy of the folder before "
                "anything else"
            )
        raise CubeError(
            f"{journal.folder} holds no sample of the scan yet; go on with it by "
            "amulor acquire --resume"
        )
    # Samples without light measure neither water nor target; the journal keeps them.
    scan["signal"][scan["flags"] & SampleFlag.NO_LIGHT != 0] = MISSING
    dark = dark_output(survey, journal)
    closed = meta.get("shutter") == "closed"
    frequency = read_back_frequencies(scan, survey)
    scan["signal"][...] -= dark[0][:, :, None, None]
    drift = None if closed else phase_drift(survey, journal, dark)
    if drift is not None:
        scan["signal"][...] = drift.corrected(scan["signal"], scan["elapsed"])
    measured = cubes.build(
        "samples",
        {
            **_outputs(
                scan, dark, survey, procedure_of(journal), shutter_closed=closed
            ),
            "saturated": (scan["flags"] & SampleFlag.OVERLOAD != 0).astype(np.int8),
        },
        {
            "modulation_frequency": frequency,
            "polarization": list(survey.instrument.polarizations),
            **_directions(scan, survey),
            "time": _first(scan["elapsed"]),
            **_windows(scan),
        },
        geometry=geometry_attributes(survey),
        attributes=_attributes(journal, meta, survey, dark),
    )
    if drift is not None:
        measured = measured.assign_attrs(drift.attributes(frequency))
    shots = _open_water(survey, journal, dark, drift, shutter_closed=closed)
    if shots is not None:
        measured = cubes.attach(measured, shots, "open_water")
    if recorded is not None:
        middle = scan["begin"] + scan["duration"] / 2
        lost = np.isfinite(scan["signal"]) & ~recorded.known(middle)
        scan["flags"][lost] |= int(SampleFlag.NO_POSE)
    measured = measured.assign(_user_variables(scan))
    if closed:
        procedure = procedure_of(journal)
        count = max(procedure.references * procedure.dark_readings, 1)
        scatter = np.nanvar(scan["signal"], axis=(2, 3)) / 2
        # Samples and dark readings without light have the same noise.
        error = np.sqrt(np.maximum(scatter / count, dark[1])).ravel()
        measured = measured.assign_attrs(shutter="closed", dark_uncertainty=error)
    else:
        leakage = shutter_leakage(survey, journal, dark, frequency)
        if leakage:
            # The newest reading replaces an earlier one.
            rest = calibration or Calibration(leakage=leakage)
            calibration = rest.model_copy(update={"leakage": leakage})
    if calibration is not None:
        measured = calibrated(measured, calibration)
    return cubes.note(measured, "acquire")


def shows_no_target(cube: xr.Dataset) -> bool:
    """Return whether no sample differs significantly from open-water references."""
    shots = cube.amulor.open_water
    if shots is None:
        return False
    water = shots.amulor.signal.mean("shot", skipna=True)
    error = np.hypot(cube["in_phase_uncertainty"], cube["quadrature_uncertainty"])
    significance = np.abs(cube.amulor.signal - water) / error
    return not bool((significance > _SIGNIFICANT).any())


def _outputs(
    samples: Samples,
    dark: tuple[NDArray[np.complex128], Floats],
    survey: Survey,
    procedure: Procedure,
    *,
    shutter_closed: bool,
) -> dict[str, NDArray[Any]]:
    signal = samples["signal"]
    counting = counting_variance(samples, survey, procedure)
    counting = counting + dark[1][:, :, None, None]
    if shutter_closed:
        # Without light, the noise is that of detector and electronics, which the survey
        # need not state.
        floor = (_RESOLUTION * np.nan_to_num(samples["full_scale"])) ** 2
        scatter = np.nanvar(signal, axis=(2, 3), keepdims=True) / 2
        counting = np.maximum(counting, np.maximum(scatter, floor))
    in_phase, quadrature, covariance = detection.phase_floor_covariance(
        signal, phase_floor=survey.instrument.lock_in.phase_floor
    )
    return {
        "in_phase": signal.real,
        "quadrature": signal.imag,
        "in_phase_uncertainty": np.sqrt(counting + in_phase),
        "quadrature_uncertainty": np.sqrt(counting + quadrature),
        "in_phase_quadrature_covariance": covariance,
    }


def _directions(samples: Samples, survey: Survey) -> dict[str, Floats]:
    """Return the measured beam directions, else the planned ones [rad]."""
    azimuth, elevation, _ = scan_directions(survey)
    return {
        "azimuth": _mean(samples["azimuth"], otherwise=azimuth),
        "elevation": _mean(samples["elevation"], otherwise=elevation),
    }


def _windows(samples: Samples) -> dict[str, Floats]:
    """Return middle and length of the integration windows [s], if recorded."""
    duration = samples["duration"]
    if not np.isfinite(duration).any():
        return {}
    return {
        "reading_time": samples["begin"] + duration / 2,
        "reading_duration": duration,
    }


def _mean(values: Floats, *, otherwise: Floats) -> Floats:
    valid = np.isfinite(values)
    count = valid.sum(axis=(0, 1))
    total = np.where(valid, values, 0.0).sum(axis=(0, 1))
    return np.where(count > 0, total / np.maximum(count, 1), otherwise)


def _first(values: Floats) -> Floats:
    filled = np.where(np.isfinite(values), values, np.inf).min(axis=(0, 1))
    return np.where(np.isfinite(filled), filled, np.nan)


def _open_water(
    survey: Survey,
    journal: Journal,
    dark: tuple[NDArray[np.complex128], Floats],
    drift: PhaseDrift | None,
    *,
    shutter_closed: bool,
) -> xr.Dataset | None:
    recorded = [*journal.samples(plan.OPEN_WATER)]
    if not recorded:
        return None
    shots = {
        shot: number
        for number, shot in enumerate(
            dict.fromkeys((key.repeat, key.row, key.column) for key, _ in recorded)
        )
    }
    samples = Samples(survey, 1, len(shots))
    for key, record in recorded:
        samples.put(key, record, 0, shots[key.repeat, key.row, key.column])
    samples["signal"][...] -= dark[0][:, :, None, None]
    if drift is not None:
        samples["signal"][...] = drift.corrected(samples["signal"], samples["elapsed"])
    # A shot with an overload or without light does not measure the water.
    spoiled = SampleFlag.OVERLOAD | SampleFlag.NO_LIGHT
    samples["signal"][samples["flags"] & spoiled != 0] = MISSING
    outputs = {
        name: values[:, :, 0, :]
        for name, values in _outputs(
            samples, dark, survey, procedure_of(journal), shutter_closed=shutter_closed
        ).items()
    }
    where = {
        "azimuth": _mean(samples["azimuth"], otherwise=np.zeros((1, len(shots))))[0],
        "elevation": _mean(samples["elevation"], otherwise=np.zeros((1, len(shots))))[
            0
        ],
    }
    # Commanded directions identify shots, because read-back directions never repeat.
    commanded = {
        f"user_{name}": values.squeeze("row").rename({"column": "shot"})
        for name, values in _commanded(samples).items()
    }
    return cubes.open_water({**outputs, **where}).assign(commanded)


def _commanded(samples: Samples) -> dict[str, xr.DataArray]:
    """Return the quantities that the cube stores per pixel, averaged over channels."""
    return {
        quantity.cube: xr.DataArray(
            _mean(samples[name], otherwise=np.full((1, 1), np.nan)),
            dims=_PIXEL,
            attrs={"long_name": quantity.text, "units": quantity.unit},
        )
        for name, quantity in QUANTITIES.items()
        if quantity.cube is not None and quantity.per_pixel
    }


def _user_variables(samples: Samples) -> dict[str, xr.Variable]:
    flags = [flag for flag in SampleFlag if flag]
    masks = np.array([*map(int, flags), UNCALIBRATED], dtype=np.int16)
    words = " ".join([*(str(flag.name).lower() for flag in flags), "uncalibrated"])
    flag = samples["flags"].astype(np.int16)

    def variable(
        text: str, values: NDArray[Any], unit: str, **more: Any
    ) -> xr.Variable:
        return xr.Variable(_SAMPLE, values, {"long_name": text, "units": unit, **more})

    return {
        "user_sample_flag": variable(
            "problems of a sample, 0 if none", flag, "1",
            flag_masks=masks, flag_values=masks, flag_meanings=words,
        ),
        **{
            f"user_{name}": values.variable
            for name, values in _commanded(samples).items()
        },
        "user_takes": variable(
            "how often a sample was taken; the last take stands",
            samples["takes"], "1",
        ),
        **{
            f"user_{quantity.cube}": variable(
                quantity.text, samples[name], quantity.unit
            )
            for name, quantity in QUANTITIES.items()
            if quantity.cube is not None and not quantity.per_pixel
            and (name not in EXTRA or np.isfinite(samples[name]).any())
        },
    }  # fmt: skip


def _attributes(
    journal: Journal,
    meta: Mapping[str, str],
    survey: Survey,
    dark: tuple[NDArray[np.complex128], Floats],
) -> dict[str, Any]:
    identities = identities_of(journal)
    parts = journal.segments()
    return cubes.attributes(
        "samples",
        title=survey.name,
        source=f"acquisition by amulor with {identities.get('lock_in', 'unknown')}",
        simulated=np.int32(is_simulated(identities)),
        survey=meta["survey"],
        devices=entry(journal, "devices"),
        identities=json.dumps(identities),
        segments=json.dumps(parts),
        time_coverage_start=parts[0]["started"] if parts else None,
        time_coverage_end=_last_end(parts),
        input_digests=(
            f"survey {entry(journal, 'survey_digest')} "
            f"instrument {entry(journal, 'instrument_digest')}"
        ),
        dark_in_phase=dark[0].real.ravel(),
        dark_quadrature=dark[0].imag.ravel(),
        modulation_depth=survey.instrument.modulation_depth,
        photon_noise_volt=photon_noise_volt(survey),
    )


def _last_end(parts: list[dict[str, Any]]) -> str | None:
    """Return the end time of the last segment; its start time after a loss of power."""
    if not parts:
        return None
    return str(parts[-1]["ended"] or parts[-1]["started"])
