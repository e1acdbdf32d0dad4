"""Calibration of the instrument's phase delay, from a plate at a known distance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.errors import CubeError, FormatError
from amulor.optics import rays
from amulor.survey import toml_file
from amulor.survey.quantity import Angle, Description, Frequency, Voltage

#: Relative difference up to which two frequencies are equal: a read-back one varies in
#: its last digits, and a delay of 5 ns changes by 1.2 mrad at 39 MHz for this much [1].
_SAME_FREQUENCY = 1e-3
#: Fraction of the rows and columns, in the middle, that show the plate.
_MIDDLE = 0.5


class FrequencyCalibration(Description):
    """Phase delay of the instrument at one modulation frequency."""

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    amplitudes: Annotated[
        tuple[Annotated[Voltage, Field(gt=0)], ...], Field(min_length=1)
    ]
    """Peak amplitudes of the calibration, increasing [V]."""
    phases: tuple[Angle, ...]
    """Phase delay at each amplitude [rad]."""

    @model_validator(mode="after")
    def _lists_fit(self) -> Self:
        if len(self.phases) != len(self.amplitudes):
            raise ValueError(
                f"{len(self.amplitudes)} amplitudes and {len(self.phases)} phases; "
                "each amplitude needs its phase"
            )
        if any(b <= a for a, b in pairwise(self.amplitudes)):
            raise ValueError("amplitudes must increase")
        return self


class Calibration(Description):
    """Phase delays of an instrument by modulation frequency and amplitude.

    Examples
    --------
    >>> from amulor.acquisition import Calibration
    >>> calibration = Calibration.from_text(
    ...     '''
    ...     [[frequencies]]
    ...     modulation_frequency = "39 MHz"
    ...     amplitudes = ["1 mV", "10 mV"]
    ...     phases = ["0.20 rad", "0.21 rad"]
    ...     '''
    ... )
    >>> calibration.frequencies[0].phases
    (0.2, 0.21)
    """

    frequencies: Annotated[tuple[FrequencyCalibration, ...], Field(min_length=1)]
    """Phase delays at each modulation frequency of a scan, in any order."""

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a calibration file.

        Parameters
        ----------
        path : str or pathlib.Path
            File from `to_toml`.

        Returns
        -------
        Calibration
            Calibration in SI units.

        Raises
        ------
        FormatError
            If the file is invalid; the message has one line per error.
        """
        text = toml_file.text_of(path, error=FormatError)
        return cls.from_text(text, name=str(Path(path)))

    @classmethod
    def from_text(cls, text: str, *, name: str = "calibration") -> Self:
        """Read a calibration from the text of its file.

        Parameters
        ----------
        text : str
            Content of a calibration file (TOML), or of the attribute `calibration` of a
            cube.
        name : str
            Name of the calibration in messages.

        Returns
        -------
        Calibration
            Calibration in SI units.

        Raises
        ------
        FormatError
            As `from_toml`.
        """
        return toml_file.described(
            text, cls, name=name, what="a calibration", error=FormatError
        )

    def to_toml(self) -> str:
        """Write the calibration as TOML, each quantity with its SI unit.

        Returns
        -------
        str
            Text that `from_toml` converts back to an equal calibration.
        """
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json"))


def phase_correction(
    calibration: Calibration,
    amplitude: NDArray[np.float64],
    *,
    modulation_frequency: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the phase correction of samples [rad], and a mask of corrected samples."""
    nearest = min(
        calibration.frequencies,
        key=lambda entry: abs(entry.modulation_frequency - modulation_frequency),
    )
    if not math.isclose(
        nearest.modulation_frequency, modulation_frequency, rel_tol=_SAME_FREQUENCY
    ):
        raise FormatError(
            f"the calibration has no {modulation_frequency / 1e6:g} MHz; record the "
            "plate at the frequencies of the scan"
        )
    at = np.asarray(nearest.amplitudes)
    with np.errstate(divide="ignore", invalid="ignore"):
        correction = np.interp(
            np.log(amplitude), np.log(at), np.asarray(nearest.phases)
        )
    if at.size == 1:
        return correction, np.isfinite(amplitude)
    return correction, (amplitude >= at[0]) & (amplitude <= at[-1])


def from_plates(plates: Sequence[xr.Dataset], *, distance: float) -> Calibration:
    """Calibrate the phase delay of an instrument with a plate at a known distance.

    Parameters
    ----------
    plates : sequence of xarray.Dataset
        Cubes of level `target_signal`, recorded without a calibration. The plate is the
        only target; several cubes differ by density filters.
    distance : float
        Forward coordinate of the plate, above zero [m]. The plate is perpendicular to
        the forward axis.

    Returns
    -------
    Calibration
        For each frequency, the delay at the mean amplitude of each cube, from the
        strongest channel in the middle half of rows and columns.

    Raises
    ------
    CubeError
        If a cube is of another level, has a calibration already, or shows no plate.
    ValueError
        If the distance is not above zero.

    Notes
    -----
    The delay is the phase of the sum of all samples, after subtraction of the phase of
    each path. That is 2 pi f / c times the group index times the length to the plate
    and back to the receiver.

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
    if not distance > 0:
        raise ValueError(f"distance must be above 0 m, got {distance:g} m")
    if not plates:
        raise CubeError("no cube was given; record the plate first")
    tables: dict[float, dict[float, float]] = {}
    for cube in plates:
        _refuse(cube)
        middle = _middle(cube)
        signal = _plate_signal(middle)
        strongest = int(np.nanargmax(np.nanmean(np.abs(signal), axis=(0, 2, 3))))
        path = _optical_path(middle, distance)
        for number, frequency in enumerate(cube["modulation_frequency"].values):
            phase = 2 * np.pi * frequency * path / speed_of_light
            flag = middle["quality_flag"].values[number, strongest]
            usable = (flag & cubes.UNUSABLE) == 0
            turned = (signal[number, strongest] * np.exp(-1j * phase))[usable]
            if turned.size == 0:
                raise CubeError(
                    f"no pixel in the middle of the scan shows a target at "
                    f"{frequency / 1e6:g} MHz; let the plate fill the middle half of "
                    "the scan"
                )
            mean = complex(turned.mean())
            tables.setdefault(float(frequency), {})[abs(mean)] = float(np.angle(mean))
    return Calibration(
        frequencies=tuple(
            FrequencyCalibration(
                modulation_frequency=frequency,
                amplitudes=tuple(sorted(table)),
                phases=_unwrapped([table[amplitude] for amplitude in sorted(table)]),
            )
            for frequency, table in sorted(tables.items())
        )
    )


def _plate_signal(cube: xr.Dataset) -> NDArray[np.complex128]:
    """Return the plate's signal minus the estimated residual water signal [V]."""
    signal = np.asarray(cube.amulor.signal.values)
    if "residual_in_phase" not in cube:
        return signal
    residual = cube["residual_in_phase"] + 1j * cube["residual_quadrature"]
    return np.asarray(signal - np.nan_to_num(residual.values))


def _refuse(cube: xr.Dataset) -> None:
    cubes.check(cube, "target_signal", name="the cube of the plate")
    if "calibration" in cube.attrs:
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


def _unwrapped(phases: list[float]) -> tuple[float, ...]:
    return tuple(float(phase) for phase in np.unwrap(phases))
