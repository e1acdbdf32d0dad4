"""The devices file: scanner, mounts, target, procedure and simulation in TOML."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import (
    AnalogSettings,
    Axis,
    DigitiserSettings,
    LaserSettings,
    Linked,
    LockInSettings,
    NavigationSettings,
    Options,
    PanTiltSettings,
    Patience,
    SourceSettings,
    driver_check,
    need,
)
from amulor.errors import InstrumentError
from amulor.survey import toml_file
from amulor.survey.quantity import (
    Angle,
    Description,
    Length,
    Time,
    Voltage,
)

#: Drivers that may be combined with devices that are not simulated.
_ANYWHERE = ("simulated", "none", "operator")
#: Auxiliary outputs of each lock-in, counted from 1.
_OUTPUTS = {"simulated": 4, "sr844": 2, "sr865a": 4, "zurich": 4}
#: Angle of a linear polarizer for each state of polarization [rad].
_LINEAR_POLARIZER = {
    "V": 0.0,
    "H": math.pi / 2,
    "P": math.pi / 4,
    "M": 3 * math.pi / 4,
}


#: Least turn of the beam by one unit of an axis [rad].
_LEAST_TURN = 1e-9

ScannerDriver = Annotated[
    str,
    driver_check("scanner", "simulated", "pi_gcs", "analog", "pelco_d", "ophyd_async"),
]


class ScannerSettings(Linked):
    """Scanner that turns the beam."""

    driver: ScannerDriver = "simulated"
    """Driver: simulated, pi_gcs, analog (mirrors on voltages, see `analog`), pelco_d (a
    pan-tilt head, see `pan_tilt`), ophyd_async (two axes, see `options`), or a scanner
    of an installed package (entry point amulor.scanners)."""
    analog: AnalogSettings | None = None
    """Mirrors on analog outputs; needed by "analog"."""
    pan_tilt: PanTiltSettings | None = None
    """Counting directions and limits of a pan-tilt head; typical values by default."""
    options: Options = None
    """Options of a scanner of another package."""
    azimuth_axis: Axis = "1"
    """Axis of the controller that turns to the right."""
    elevation_axis: Axis = "2"
    """Axis of the controller that turns upwards."""
    angle_per_unit: Annotated[Angle, Field(ge=-10, le=10)] = math.radians(1.0)
    """Rotation of the beam per unit of the axis, twice the rotation of a mirror.
    Negative if the axis counts in the other direction [rad]."""
    azimuth_zero: float = 0.0
    """Position of the axis where the azimuth is zero, in its unit."""
    elevation_zero: float = 0.0
    """Position of the axis where the elevation is zero, in its unit."""
    park_azimuth: Angle | None = None
    """Azimuth of the parking direction; no parking by default [rad]."""
    park_elevation: Angle | None = None
    """Elevation of the parking direction; no parking by default [rad]."""
    move_timeout: Patience = 30.0
    """Longest time of one move [s]."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        wired = self.driver in ("pi_gcs", "pelco_d")
        need(self.address is not None or not wired, "scanner.address")
        need(self.analog is not None or self.driver != "analog", "scanner.analog")
        need(bool(self.options) or self.driver != "ophyd_async", "scanner.options")
        need(
            abs(self.angle_per_unit) >= _LEAST_TURN,
            f"scanner.angle_per_unit, not 0 but {_LEAST_TURN:g} rad at least,",
        )
        need(
            (self.park_azimuth is None) == (self.park_elevation is None),
            "both or none of scanner.park_azimuth and scanner.park_elevation",
        )
        return self


class MountSettings(Linked):
    """Rotation mount of a polarizer or a retarder."""

    driver: Literal["simulated", "pi_gcs", "none"] = "simulated"
    """Driver: simulated, pi_gcs, or none for a fixed polarizer."""
    axis: Axis = "3"
    """Axis of the controller, in degrees."""
    angles: dict[Annotated[str, Field(pattern="^[VHPMRL]$")], Angle] = Field(
        default_factory=lambda: dict(_LINEAR_POLARIZER)
    )
    """Angle of the mount for each state of polarization; by default those of a linear
    polarizer [rad]."""
    move_timeout: Patience = 30.0
    """Longest time of one turn [s]."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        need(self.address is not None or self.driver != "pi_gcs", "address of a mount")
        return self


class TargetSettings(Linked):
    """Stage that takes the target out of the beam for open-water references."""

    driver: Literal["simulated", "pi_gcs", "operator", "none"] = "simulated"
    """Driver: simulated, pi_gcs, operator (who moves the target on request, at a
    terminal), or none for a survey without open-water shots."""
    axis: Axis = "5"
    """Axis of the controller, in millimeters."""
    position_in: Length = 0.0
    """Position of the target in the scan [m]."""
    position_out: Length = 0.2
    """Position of the target outside of every beam [m]."""
    move_timeout: Patience = 60.0
    """Longest time of one move [s]."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        need(self.address is not None or self.driver != "pi_gcs", "target.address")
        return self


class ShutterSettings(Description):
    """Shutter in front of the detector, for readings of the leakage with the laser on.

    The readings are part of each reference measurement of a scan, and amulor subtracts
    their mean.
    """

    driver: Literal["simulated", "lock_in_output", "operator"] = "simulated"
    """Driver: simulated, lock_in_output (an auxiliary output of the lock-in moves the
    shutter), or operator (who moves it on request, at a terminal)."""
    output: Annotated[int, Field(ge=1, le=4)] = 2
    """Number of the auxiliary output, counted from 1 [1]."""
    closed_voltage: Annotated[Voltage, Field(ge=-10, le=10)] = 0.0
    """Voltage that closes the shutter [V]."""
    open_voltage: Annotated[Voltage, Field(ge=-10, le=10)] = 5.0
    """Voltage that opens the shutter [V]."""
    move_time: Annotated[Time, Field(ge=0, le=60)] = 0.1
    """Wait after the shutter was moved [s]."""


class Procedure(Description):
    """Acquisition procedure: settling, readings, references, tolerances."""

    settling: Annotated[float, Field(ge=3, le=50)] = 5.0
    """Wait after each change, in time constants of the lock-in [1]. After the laser was
    switched off or the shutter closed, the wait is 10 time constants longer."""
    settled_by: Literal["samples"] | None = None
    """Criterion that ends the wait after a move; by default the wait is `settling`.
    "samples": successive readings agree within their noise, after at least two time
    constants. A sample is flagged if they do not agree within four times `settling`.
    With output_filter = "known", the first parts of a dwell that disagree with the rest
    are discarded."""
    output_filter: Literal["known"] | None = None
    """Treatment of the output filter of the lock-in; by default readings start after
    `settling`. "known": the filter is a single pole with the time constant of the
    survey. Its remainder of the last direction is subtracted, there is no wait after a
    move, and readings fill the dwell."""
    readings: Literal["buffer"] | None = None
    """Transfer of readings; by default one query for each reading. "buffer": the
    lock-in records its outputs by its own clock and transfers them after each dwell
    (sr865a, zurich, digitiser)."""
    mode: Literal["continuous"] | None = None
    """Motion of the beam; by default it stops for each sample. "continuous": the beam
    moves along each row without a stop, by one column in a dwell. The measured
    direction assigns the buffer of the lock-in to pixels. This mode needs output_filter
    = "known" and readings = "buffer"."""
    run_up: Annotated[Time, Field(gt=0, le=60)] | None = None
    """Time of the motion before the first pixel of a row and after the last one; 10 ms
    by default [s]."""
    frequencies_at_once: Annotated[int, Field(ge=2, le=64)] | None = None
    """Number of simultaneous modulation frequencies, for a lock-in with as many
    oscillators and demodulators; one at a time by default [1]."""
    references: Annotated[int, Field(ge=1, le=10_000)] = 2
    """Number of times at which dark readings and open-water shots are acquired, spread
    evenly from before the scan to after it; the repeats are divided among them [1]."""
    dark_readings: Annotated[int, Field(ge=0, le=100_000)] = 5
    """Samples with the laser off, per channel, at each reference measurement [1]."""
    shutter_readings: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """Samples with the laser on and the shutter closed, per channel, at each reference
    measurement; 5 if the devices file has a shutter, else none [1]."""
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    """Number of attempts for a sample after loss of the reference [1]."""
    patience: Annotated[int, Field(ge=1, le=1_000_000)] = 50
    """Number of consecutive overloaded samples that stops the scan [1]."""
    darkness_patience: Annotated[int, Field(ge=0, le=1_000_000)] = 3
    """Number of consecutive samples without light that stops the scan [1]."""
    position_tolerance: Annotated[Angle, Field(gt=0)] = 1e-4
    """Largest unflagged difference between commanded and read-back direction [rad]."""
    clock_speed: Annotated[float, Field(ge=1e-3, le=1e6)] = 1.0
    """Clock speed of simulators on the network; 1 for real devices [1]."""

    @model_validator(mode="after")
    def _continuous_needs_filter_and_buffer(self) -> Self:
        if self.mode == "continuous" and (
            self.output_filter != "known" or self.readings != "buffer"
        ):
            raise ValueError(
                'mode = "continuous" takes off what the filter holds of the pixel '
                'before, from a record without gaps; set output_filter = "known" and '
                'readings = "buffer" beside it'
            )
        if self.mode == "continuous" and self.settled_by is not None:
            raise ValueError(
                f'settled_by is {self.settled_by!r}, but with mode = "continuous" '
                "nothing settles; leave settled_by out"
            )
        if self.run_up is not None and self.mode != "continuous":
            raise ValueError(
                'run_up is that of mode = "continuous"; state both, or take it out'
            )
        return self


class SimulationSettings(Description):
    """Errors and faults of the simulated devices in this program."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Seed of the noise [1]."""
    speed: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    """Speed relative to real time; as fast as possible by default [1]."""
    cable_delay: Annotated[Time, Field(ge=-1e-3, le=1e-3)] = 0.0
    """Delay of the signal path, for the calibration of phase zero [s]."""
    pickup: Annotated[Voltage, Field(ge=-100, le=100)] = 0.0
    """In-phase output without light, for dark readings [V]."""
    leakage: Annotated[Voltage, Field(ge=-100, le=100)] = 0.0
    """In-phase output by crosstalk while the laser is on, also with a closed shutter
    [V]."""
    phase_drift: Annotated[Angle, Field(ge=-1e3, le=1e3)] = 0.0
    """Drift of the phase in one second [rad]."""
    phase_walk: Annotated[Angle, Field(ge=-10, le=10)] = 0.0
    """Change of the phase when the amplitude increases tenfold [rad]."""
    water_drift: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    """Relative change of the water signal in one second [1/s]."""
    position_error: Annotated[Angle, Field(ge=0, le=0.1)] = 2e-6
    """Random error of the position of the scanner [rad]."""
    faults: tuple[
        Annotated[
            str,
            Field(
                pattern=r"^(overload|saturation|unlock|lost-link|timeout|stuck|darkness|interlock)"
                r"@\d+(x\d+)?$"
            ),
        ],
        ...,
    ] = ()
    """Faults, each with its first reading and its number of readings. Example:
    "unlock@500x3" affects three readings from number 500."""


class Settings(Description):
    """Devices and procedure of a scan; all devices are simulated by default.

    Examples
    --------
    >>> from amulor.acquisition import Settings
    >>> Settings().lock_in.driver, Settings().laser.driver
    ('simulated', 'simulated')
    """

    lock_in: LockInSettings = LockInSettings()
    """Lock-in amplifier."""
    scanner: ScannerSettings = ScannerSettings()
    """Scanner, which turns the beam."""
    launch: MountSettings = MountSettings()
    """Rotation mount of the launched polarization."""
    analyser: MountSettings = MountSettings(axis="4")
    """Rotation mount of the analyzed polarization."""
    laser: LaserSettings = LaserSettings()
    """Laser."""
    target: TargetSettings = TargetSettings()
    """Target stage."""
    shutter: ShutterSettings | None = None
    """Shutter in front of the detector; none by default."""
    digitiser: DigitiserSettings = DigitiserSettings()
    """Digitizer that replaces the lock-in."""
    source: SourceSettings = SourceSettings()
    """Modulation source that replaces the oscillator of the lock-in."""
    navigation: NavigationSettings | None = None
    """Source of the poses of the vehicle; none by default. Simulated devices of a
    survey with a section [platform] have one."""
    procedure: Procedure = Procedure()
    """Acquisition procedure."""
    simulation: SimulationSettings = SimulationSettings()
    """Errors and faults of embedded simulated devices."""

    @model_validator(mode="before")
    @classmethod
    def _a_shutter_is_used(cls, content: Any) -> Any:
        if not isinstance(content, dict) or content.get("shutter") is None:
            return content
        procedure = content.get("procedure", {})
        if isinstance(procedure, Procedure):
            procedure = procedure.model_dump(exclude_none=True)
        if not isinstance(procedure, dict):
            return content
        return {**content, "procedure": {"shutter_readings": 5, **procedure}}

    @model_validator(mode="after")
    def _shutter_is_there(self) -> Self:
        need(self.shutter is not None or not self.procedure.shutter_readings, "shutter")
        if self.shutter is None or self.shutter.driver != "lock_in_output":
            return self
        used = [self.shutter.output]
        if self.laser.driver == "lock_in_output":
            used.append(self.laser.output)
        last = _OUTPUTS.get(self.lock_in.driver, 4)
        if len({*used}) < len(used) or self.shutter.output > last:
            raise ValueError(
                "laser and shutter need outputs of their own among 1 to "
                f"{last} of the lock-in, stated is shutter.output = "
                f"{self.shutter.output}"
            )
        return self

    @model_validator(mode="after")
    def _simulated_devices_stay_among_themselves(self) -> Self:
        drivers = {
            "lock_in": self.lock_in.driver,
            "scanner": self.scanner.driver,
            "launch": self.launch.driver,
            "analyser": self.analyser.driver,
            "laser": self.laser.driver,
            "target": self.target.driver,
        }
        if self.shutter is not None:
            drivers["shutter"] = self.shutter.driver
        if self.navigation is not None:
            drivers["navigation"] = self.navigation.driver
        simulated = [name for name, driver in drivers.items() if driver == "simulated"]
        real = [name for name, driver in drivers.items() if driver not in _ANYWHERE]
        if simulated and real:
            raise ValueError(
                f"{', '.join(simulated)} simulated, {', '.join(real)} not: embedded "
                "simulated devices see one scene together and cannot work beside "
                'others; set every driver, mounts without a motor to "none"'
            )
        return self

    @model_validator(mode="after")
    def _output_is_there(self) -> Self:
        last = _OUTPUTS.get(self.lock_in.driver, 4)
        if self.laser.driver == "lock_in_output" and self.laser.output > last:
            raise ValueError(
                f"the lock-in {self.lock_in.driver!r} has auxiliary outputs 1 to "
                f"{last}, stated is laser.output = {self.laser.output}; wire another "
                "one"
            )
        return self

    @model_validator(mode="after")
    def _mirrors_have_outputs_of_their_own(self) -> Self:
        analog = self.scanner.analog
        if (
            self.scanner.driver != "analog"
            or analog is None
            or analog.outputs != "lock_in"
        ):
            return self
        used = [analog.azimuth.output, analog.elevation.output]
        if self.laser.driver == "lock_in_output":
            used.append(str(self.laser.output))
        last = _OUTPUTS.get(self.lock_in.driver, 4)
        available = [str(number) for number in range(1, last + 1)]
        if len({*used}) < len(used) or not {*used} <= {*available}:
            raise ValueError(
                f"mirrors and laser need outputs of their own among "
                f"{', '.join(available)} of the lock-in, stated are {', '.join(used)}"
            )
        return self

    @model_validator(mode="after")
    def _steps_are_within_the_tolerance(self) -> Self:
        step = math.radians(0.01)
        if self.scanner.driver == "pelco_d" and (
            self.procedure.position_tolerance < step
        ):
            raise ValueError(
                "a pan-tilt head by Pelco-D counts in 0.01 degrees, "
                "procedure.position_tolerance is less, and every sample would be "
                'flagged; state what the head is good for, such as "0.05 deg"'
            )
        return self

    @model_validator(mode="after")
    def _reference_and_source_agree(self) -> Self:
        external = self.lock_in.reference == "external"
        if external and self.source.driver == "none":
            raise ValueError(
                'lock_in.reference is "external", but nothing says what makes the '
                "frequency; add the part source"
            )
        stanford = self.lock_in.driver in ("sr844", "sr865a")
        if self.source.driver != "none" and stanford and not external:
            raise ValueError(
                "the part source makes the frequency, but the lock-in takes its own; "
                'set lock_in.reference = "external"'
            )
        return self

    @model_validator(mode="after")
    def _digitiser_is_named(self) -> Self:
        used = self.lock_in.driver == "digitiser"
        if used != (self.digitiser.driver != "none"):
            raise ValueError(
                'lock_in.driver = "digitiser" and the part digitiser with its driver '
                "belong together; state both, or none of them"
            )
        return self

    @model_validator(mode="after")
    def _lock_in_takes_a_comb(self) -> Self:
        if self.procedure.frequencies_at_once is None:
            return self
        if self.lock_in.driver in ("sr844", "sr865a", "scpi"):
            raise ValueError(
                f"the lock-in {self.lock_in.driver!r} has one oscillator; take "
                "procedure.frequencies_at_once out, or use a lock-in with several"
            )
        if self.source.driver != "none":
            raise ValueError(
                "procedure.frequencies_at_once needs the oscillators of the lock-in, "
                "but the part source modulates the laser; take one of them out"
            )
        return self

    @property
    def simulated(self) -> bool:
        """Whether all devices are simulated in this program."""
        return self.lock_in.driver == "simulated"

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a devices file.

        Parameters
        ----------
        path : str or pathlib.Path
            Devices file (TOML).

        Returns
        -------
        Settings
            Settings in SI units.

        Raises
        ------
        InstrumentError
            If the file is invalid; the message has one line per error.
        """
        return toml_file.read(path, cls, what="a devices file", error=InstrumentError)

    def to_toml(self) -> str:
        """Return the settings as TOML text, each quantity with its SI unit.

        Returns
        -------
        str
            Text that `from_toml` converts back to equal settings.
        """
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))
