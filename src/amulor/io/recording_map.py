"""The file that says which column of a recording means what: one TOML, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from amulor.errors import FormatError
from amulor.survey import toml_file
from amulor.survey.quantity import Description, Frequency, Voltage

Column = Annotated[str, Field(min_length=1, max_length=500)]
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295}


class TableSettings(Description):
    """How the file is written."""

    format: Literal["csv", "hdf5"] = "csv"
    """"csv": a line of names and a line for each sample; "hdf5": an array for each
    column, of one or two dimensions."""
    delimiter: Annotated[
        str, StringConstraints(strip_whitespace=False, min_length=1, max_length=1)
    ] = ","
    """Between columns: ";" for LabOne, "\\t" for a tab, " " for one or more spaces."""
    comment: Annotated[str, Field(max_length=1)] = "#"
    """What a line begins with that holds no data; "%" for LabOne. The last of them
    before the data names the columns if no other line does."""
    skip: Annotated[int, Field(ge=0, le=10**9)] = 0
    """Lines before the one with the names [1]."""
    decimal: Literal[".", ","] = "."
    """What stands before the fraction of a number."""

    @model_validator(mode="after")
    def _columns_can_be_told_apart(self) -> Self:
        if self.delimiter in ('"', "\r", "\n"):
            raise ValueError(
                f"delimiter {self.delimiter!r} ends a text or a line; state what "
                'separates columns, such as ",", ";", "\\t" or " "'
            )
        return self


class ColumnSettings(Description):
    """Names of columns; of "hdf5" the paths of arrays."""

    in_phase: Column | None = None
    """X of the lock-in."""
    quadrature: Column | None = None
    """Y of the lock-in."""
    amplitude: Column | None = None
    """R of the lock-in, instead of X and Y."""
    phase: Column | None = None
    """Theta of the lock-in, instead of X and Y."""
    frequency: Column | None = None
    """Modulation frequency of each sample [Hz]."""
    polarization: Column | None = None
    """Launched and analysed state of each sample, such as VH."""
    azimuth: Column | None = None
    """Direction to the right."""
    elevation: Column | None = None
    """Direction upwards."""
    row: Column | None = None
    """Row of the scan, counted from 0 on top."""
    column: Column | None = None
    """Column of the scan, counted from 0 at the left."""
    mean: Column | None = None
    """Mean output of the detector [V]."""
    temperature: Column | None = None
    """Temperature of the water [degC]."""
    what: Column | None = None
    """What a sample is of: see `constants.open_water`."""

    @model_validator(mode="after")
    def _a_signal_and_a_place_are_stated(self) -> Self:
        both = [
            ("in_phase", "quadrature"),
            ("amplitude", "phase"),
            ("azimuth", "elevation"),
            ("row", "column"),
        ]
        for one, other in both:
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"{one} and {other} belong together; state both")
        if (self.in_phase is None) == (self.amplitude is None):
            raise ValueError(
                "needed are in_phase and quadrature, or amplitude and phase"
            )
        return self


class ConstantSettings(Description):
    """What holds for all samples."""

    frequency: Annotated[Frequency, Field(gt=0)] | None = None
    """Modulation frequency, where no column states it [Hz]."""
    polarization: str | None = None
    """Launched and analysed state, where no column states it."""
    scale: Annotated[float, Field(gt=0)] = 1.0
    """Volts per unit of the columns [V]."""
    root_mean_square: bool = True
    """Whether the lock-in counts in volts rms, as most do; peak amplitudes if not."""
    phase_falls_with_delay: bool = True
    """Whether a later echo has a smaller phase, as lock-ins have it."""
    phase_unit: Literal["rad", "mrad", "deg"] = "deg"
    """Unit of the column `phase`."""
    angle_unit: Literal["rad", "mrad", "deg"] = "deg"
    """Unit of the columns `azimuth` and `elevation`."""
    uncertainty: Annotated[Voltage, Field(gt=0)] | None = None
    """Standard uncertainty of either output, a peak amplitude; from counting and the
    phase floor of the survey if left out [V]."""
    open_water: str = "open_water"
    """What the column `what` holds for open-water shots; all others see the target."""

    def radians(self, unit: str) -> float:
        """Return the size of a unit of angle [rad]."""
        return _ANGLES[unit]


class RecordingMap(Description):
    """Which column of a recording means what."""

    table: TableSettings = TableSettings()
    """How the file is written."""
    columns: ColumnSettings
    """Names of columns."""
    constants: ConstantSettings = ConstantSettings()
    """What holds for all samples."""

    @model_validator(mode="after")
    def _channels_are_stated(self) -> Self:
        for name in ("frequency", "polarization"):
            column, constant = (
                getattr(self.columns, name),
                getattr(self.constants, name),
            )
            if column is not None and constant is not None:
                raise ValueError(
                    f"columns.{name} and constants.{name} say it twice; keep one"
                )
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a map."""
        return toml_file.described(
            toml_file.text_of(path, error=FormatError),
            cls,
            name=str(Path(path)),
            what="a column map",
            error=FormatError,
        )
