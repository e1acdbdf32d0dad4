"""The file that says which devices take a scan and how: one TOML, strictly checked."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import (
    AnalogSettings,
    Axis,
    DigitiserSettings,
    LaserSettings,
    Linked,
    LockInSettings,
    Options,
    PanTiltSettings,
    Patience,
    SourceSettings,
    known,
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

#: Drivers that can stand in one file with devices that are not simulated.
_ANYWHERE = ("simulated", "none", "operator")
#: Auxiliary outputs of each lock-in, counted from 1.
_OUTPUTS = {"simulated": 4, "sr844": 2, "sr865a": 4, "zurich": 4}
#: Angle of a linear polarizer for the states that it makes or passes [rad].
_LINEAR_POLARIZER = {
    "V": 0.0,
    "H": math.pi / 2,
    "P": math.pi / 4,
    "M": 3 * math.pi / 4,
}


#: Least turn of a beam by one unit of an axis that any stage has [rad].
_LEAST_TURN = 1e-9

ScannerDriver = Annotated[
    str, known("scanner", "simulated", "pi_gcs", "analog", "pelco_d", "ophyd_async")
]


class ScannerSettings(Linked):
    """What turns the beam."""

    driver: ScannerDriver = "simulated"
    """Which controller it is: simulated, pi_gcs, analog (mirrors on voltages, stated in
    `analog`), pelco_d (a pan-tilt head, stated in `pan_tilt`), ophyd_async (two axes,
    stated in `options`), or the name of one that an installed package offers (entry
    point amulor.scanners)."""
    analog: AnalogSettings | None = None
    """Mirrors on analog outputs; needed by "analog"."""
    pan_tilt: PanTiltSettings | None = None
    """How a pan-tilt head counts; by default as most do."""
    options: Options = None
    """What a scanner of another package wants to be told."""
    azimuth_axis: Axis = "1"
    """Axis of the controller that turns to the right."""
    elevation_axis: Axis = "2"
    """Axis of the controller that turns upwards."""
    angle_per_unit: Annotated[Angle, Field(ge=-10, le=10)] = math.radians(1.0)
    """Turn of the beam per unit of the axis; twice the turn of a mirror. Negative if
    the axis counts the other way [rad]."""
    azimuth_zero: float = 0.0
    """Position of the axis where the azimuth is zero, in its unit."""
    elevation_zero: float = 0.0
    """Position of the axis where the elevation is zero, in its unit."""
    park_azimuth: Angle | None = None
    """Direction to be left in; where it stands, if left out [rad]."""
    park_elevation: Angle | None = None
    """Direction to be left in; where it stands, if left out [rad]."""
    move_timeout: Patience = 30.0
    """How long one move may take [s]."""

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
    """A rotation mount with a polarizer or a retarder."""

    driver: Literal["simulated", "pi_gcs", "none"] = "simulated"
    """Which controller it is; "none" for a polarizer that stays as it is."""
    axis: Axis = "3"
    """Axis of the controller, in degrees."""
    angles: dict[Annotated[str, Field(pattern="^[VHPMRL]$")], Angle] = Field(
        default_factory=lambda: dict(_LINEAR_POLARIZER)
    )
    """Angle of the mount for each state of polarization that it makes or passes; by
    default those of a linear polarizer [rad]."""
    move_timeout: Patience = 30.0
    """How long one turn may take [s]."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        need(self.address is not None or self.driver != "pi_gcs", "address of a mount")
        return self


class TargetSettings(Linked):
    """What takes the target out of the beam for open-water shots."""

    driver: Literal["simulated", "pi_gcs", "operator"] = "simulated"
    """"operator": somebody is asked to do it."""
    axis: Axis = "5"
    """Axis of the controller, in millimetres."""
    position_in: Length = 0.0
    """Where the target is scanned [m]."""
    position_out: Length = 0.2
    """Where it is out of every beam [m]."""
    move_timeout: Patience = 60.0
    """How long the way may take [s]."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        need(self.address is not None or self.driver != "pi_gcs", "target.address")
        return self


class Procedure(Description):
    """How each sample is taken."""

    settling: Annotated[float, Field(ge=3, le=50)] = 5.0
    """Wait after each change, in time constants of the lock-in [1]."""
    settled_by: Literal["samples"] | None = None
    """"samples": after a move it is waited until successive readings agree within their
    noise, at least for two time constants and at most for four times `settling`; what
    does not settle by then is flagged. With output_filter = "known" the first parts of
    a dwell that do not agree with the rest are left out. If left out, `settling` is
    taken for granted."""
    output_filter: Literal["known"] | None = None
    """"known": the lock-in's filter is a single pole of the survey's time constant, and
    what it still holds of the last direction is taken off: nothing is waited for after
    a move, and the dwell is filled with readings. Left out: readings are taken after
    `settling`."""
    readings: Literal["buffer"] | None = None
    """"buffer": the lock-in records its outputs by its own clock and hands them over
    after each dwell (sr865a, zurich, digitiser); one question a reading if left out."""
    mode: Literal["continuous"] | None = None
    """"continuous": the beam moves along each row without a stop, by one column in a
    dwell, and the buffer of the lock-in is divided by where the beam was; it needs
    output_filter = "known" and readings = "buffer". Left out: it stands still for each
    sample."""
    run_up: Annotated[Time, Field(gt=0, le=60)] | None = None
    """How long before the first pixel of a row the beam is set moving, and how much
    further than the last one it is sent; 10 ms if left out [s]."""
    frequencies_at_once: Annotated[int, Field(ge=2, le=64)] | None = None
    """How many modulation frequencies are measured in one dwell, by a lock-in with as
    many oscillators and demodulators; one after the other if left out [1]."""
    references: Annotated[int, Field(ge=1, le=10_000)] = 2
    """Times at which dark readings and open-water shots are taken, spread evenly from
    before the scan to after it; the repeats are dealt out among them [1]."""
    dark_readings: Annotated[int, Field(ge=0, le=100_000)] = 5
    """Samples with the laser off, per channel, at each of these times [1]."""
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    """How often a sample is taken again after the reference was lost in it [1]."""
    patience: Annotated[int, Field(ge=1, le=1_000_000)] = 50
    """Overloaded samples one after the other before the scan stops [1]."""
    darkness_patience: Annotated[int, Field(ge=0, le=1_000_000)] = 3
    """Samples without light one after the other before the scan stops [1]."""
    position_tolerance: Annotated[Angle, Field(gt=0)] = 1e-4
    """Largest difference of commanded and read-back direction that is not flagged
    [rad]."""
    clock_speed: Annotated[float, Field(ge=1e-3, le=1e6)] = 1.0
    """How much faster than real the clock of simulators on the network runs; 1 for
    devices that are real [1]."""

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
                'with mode = "continuous" nothing settles; take settled_by out'
            )
        if self.run_up is not None and self.mode != "continuous":
            raise ValueError(
                'run_up is that of mode = "continuous"; state both, or take it out'
            )
        return self


class SimulationSettings(Description):
    """What embedded simulated devices do that ideal ones would not."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Seed of the noise [1]."""
    speed: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    """How much faster than real; as fast as the computer can if left out [1]."""
    cable_delay: Annotated[Time, Field(ge=-1e-3, le=1e-3)] = 0.0
    """Delay of the signal path, which calibration of phase zero finds [s]."""
    pickup: Annotated[Voltage, Field(ge=-100, le=100)] = 0.0
    """In-phase output without light, which dark readings find [V]."""
    phase_drift: Annotated[Angle, Field(ge=-1e3, le=1e3)] = 0.0
    """Change of the phase in one second [rad]."""
    phase_walk: Annotated[Angle, Field(ge=-10, le=10)] = 0.0
    """Change of the phase when the amplitude is ten times as large [rad]."""
    water_drift: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    """Change of the water signal in one second, in parts of what it was at the start
    [1/s]."""
    position_error: Annotated[Angle, Field(ge=0, le=0.1)] = 2e-6
    """Random error of where the scanner comes to stand [rad]."""
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
    """Faults by the number of the reading that they begin at and, if more than one, how
    many readings they last: "unlock@500x3"."""


class Settings(Description):
    """The devices of a scan; by default all of them are simulated.

    Examples
    --------
    >>> from amulor.acquisition import Settings
    >>> Settings().lock_in.driver, Settings().laser.driver
    ('simulated', 'simulated')
    """

    lock_in: LockInSettings = LockInSettings()
    """The lock-in amplifier."""
    scanner: ScannerSettings = ScannerSettings()
    """What turns the beam."""
    launch: MountSettings = MountSettings()
    """What sets the launched polarization."""
    analyser: MountSettings = MountSettings(axis="4")
    """What sets the analysed polarization."""
    laser: LaserSettings = LaserSettings()
    """What lets light out."""
    target: TargetSettings = TargetSettings()
    """What takes the target out of the beam."""
    digitiser: DigitiserSettings = DigitiserSettings()
    """What records the detector directly, if no lock-in does."""
    source: SourceSettings = SourceSettings()
    """What modulates the laser, if the lock-in does not."""
    procedure: Procedure = Procedure()
    """How each sample is taken."""
    simulation: SimulationSettings = SimulationSettings()
    """What embedded simulated devices do."""

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
        own = self.scanner.analog
        if self.scanner.driver != "analog" or own is None or own.outputs != "lock_in":
            return self
        taken = [own.azimuth.output, own.elevation.output]
        if self.laser.driver == "lock_in_output":
            taken.append(str(self.laser.output))
        last = _OUTPUTS.get(self.lock_in.driver, 4)
        there = [str(number) for number in range(1, last + 1)]
        if len({*taken}) < len(taken) or not {*taken} <= {*there}:
            raise ValueError(
                f"mirrors and laser need outputs of their own among "
                f"{', '.join(there)} of the lock-in, stated are {', '.join(taken)}"
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
        own = self.lock_in.driver in ("sr844", "sr865a")
        if self.source.driver != "none" and own and not external:
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
        """Whether the devices are the embedded simulated ones."""
        return self.lock_in.driver == "simulated"

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a devices file.

        Parameters
        ----------
        path : str or pathlib.Path
            TOML file.

        Returns
        -------
        Settings
            In SI units.

        Raises
        ------
        InstrumentError
            With one line for each thing that is wrong.
        """
        return toml_file.described(
            toml_file.text_of(path, error=InstrumentError),
            cls,
            name=str(Path(path)),
            what="a devices file",
            error=InstrumentError,
        )

    def to_toml(self) -> str:
        """Write the settings as TOML, each quantity with its SI unit.

        Returns
        -------
        str
            Text that `from_toml` reads back to equal settings.
        """
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))
