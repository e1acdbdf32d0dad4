"""What one sample of a scan has brought, as the journal keeps it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Record:
    """What one sample has brought, apart from its key."""

    in_phase: float
    """Mean of the readings [V]."""
    quadrature: float
    """Mean of the readings [V]."""
    mean: float | None
    """Mean output of the detector, None where it is not wired [V]."""
    readings: int
    """How many readings were averaged [1]."""
    full_scale: float
    """Largest peak amplitude of the setting [V]."""
    flags: int
    """Sum of `SampleFlag` [1]."""
    commanded_azimuth: float
    """Direction asked for [rad]."""
    commanded_elevation: float
    """Direction asked for [rad]."""
    azimuth: float
    """Direction read back [rad]."""
    elevation: float
    """Direction read back [rad]."""
    modulation_frequency: float
    """Frequency read back [Hz]."""
    elapsed: float
    """Time since the scan began, by the clock of the scan [s]."""
    segment: int
    """Which uninterrupted part of the scan it belongs to [1]."""
    # What older journals do not have follows, each with None as its default.
    launch: float | None = None
    """Where the mount of the launched polarization stands, None without one [rad]."""
    analyser: float | None = None
    """Where the mount of the analysed polarization stands, None without one [rad]."""
    target: float | None = None
    """Where the stage of the target stands, None if nobody can tell [m]."""
    interval: float | None = None
    """Time between readings by the clock of the lock-in, None without one [s]."""
    spread: float | None = None
    """Standard deviation of either output where the record itself tells it, None
    otherwise [V]."""
    edge: float | None = None
    """Standard deviation of either output by edges of the scene that the beam passed
    inside one interval of a record, None where it stood still [V]."""
    laser_current: float | None = None
    """Current of the laser diode, None where nobody tells it [A]."""
    laser_temperature: float | None = None
    """Temperature of the laser diode, None where nobody tells it [degC]."""
