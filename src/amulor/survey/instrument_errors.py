"""Errors that a simulation adds to samples, of the instrument and of disturbed water.

No method that evaluates a scan reads them: they are what a user does not know.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.survey.quantity import (
    Angle,
    Description,
    Fraction,
    Length,
    Temperature,
    Time,
    Voltage,
)

#: Measurements that have the error: scan and open-water references, or one of them.
Part = Literal["all", "scan", "open_water"]
_Share = Annotated[Fraction, Field(ge=0, le=1)]
_Change = Annotated[Fraction, Field(gt=-1, le=10)]
_Phase = Annotated[Angle, Field(ge=-7, le=7)]
_Volts = Annotated[Voltage, Field(ge=0, le=1e4)]
_Delay = Annotated[Time, Field(ge=-1e-3, le=1e-3)]


class Pointing(Description):
    """Pointing error: the true beam directions differ from the recorded ones."""

    jitter: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Standard deviation of azimuth and of elevation from pixel to pixel [rad]."""
    backlash: Annotated[Angle, Field(ge=0, le=0.5)] = 0.0
    """Difference in azimuth between rows scanned to the right and rows scanned to the
    left [rad]. Half of the difference is applied to each kind of row."""


class Plume(Description):
    """Plume of turbid water across the scan, which the references do not contain.

    It has a normal profile over the azimuth. Without a width it is a layer in front of
    the whole target.
    """

    fraction: Annotated[Fraction, Field(ge=0, le=100)]
    """Light of the plume at its center, divided by the mean light of the water signal
    [1]."""
    distance: Annotated[Length, Field(gt=0, le=1e4)]
    """Distance of the plume from the instrument [m]."""
    optical_thickness: Annotated[Fraction, Field(ge=0, le=100)] = 0.0
    """Attenuation coefficient times thickness at the center, for one passage [1]."""
    azimuth: Annotated[Angle, Field(ge=-7, le=7)] = 0.0
    """Azimuth of the center, to the right [rad]."""
    width: Annotated[Angle, Field(gt=0, le=7)] | None = None
    """Standard deviation of the profile over the azimuth [rad]."""


class Gradient(Description):
    """Water whose concentration changes in proportion to the distance.

    Scan and references contain the same water. Absorption, scattering and backscatter
    are multiplied by 1 + change * distance, and never become negative.
    """

    change_per_meter: Annotated[Fraction, Field(ge=-10, le=10)]
    """Relative change of the concentration for each meter from the instrument on, along
    the beam [1/m]."""


class Bubbles(Description):
    """Bubbles that pass the beam, at random distances."""

    number: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
    """Mean number of bubbles in the beam during a sample; the number has a Poisson
    distribution [1]."""
    fraction: Annotated[Fraction, Field(ge=0, le=100)]
    """Light of a bubble at the nearest distance, divided by the mean light of the water
    signal [1]."""
    nearest: Annotated[Length, Field(gt=0, le=1e4)]
    """Least distance of a bubble from the instrument [m]."""
    farthest: Annotated[Length, Field(gt=0, le=1e4)]
    """Largest distance of a bubble from the instrument [m]."""
    part: Part = "all"
    """Affected samples: of the scan, of open-water shots, or both."""

    @model_validator(mode="after")
    def _nearest_is_before_farthest(self) -> Self:
        if not self.nearest < self.farthest:
            raise ValueError(
                f"nearest ({self.nearest:g} m) must be below farthest "
                f"({self.farthest:g} m): bubbles lie between them"
            )
        return self


class Clock(Description):
    """Clock error: the true modulation frequencies differ from the recorded ones."""

    frequency_error: Annotated[Fraction, Field(ge=-0.1, le=0.1)]
    """True frequency divided by recorded frequency, minus 1 [1]."""


class Harmonic(Description):
    """Harmonic of the modulated light, to which the lock-in amplifier also responds.

    The response adds to the output at the modulation frequency. Its phasor is the
    complex conjugate for the orders 3 and 7, as with four samples a period.
    """

    order: Literal[3, 5, 7] = 3
    """Order of the harmonic [1]."""
    fraction: _Share
    """Response of the output to light at the harmonic frequency, divided by the
    response to light at the fundamental [1]."""


class OpticalLeakage(Description):
    """Optical leakage: light that reaches the detector within the instrument."""

    fraction: _Share
    """Leaking power before the analyzer, divided by the launched power [1]."""
    delay: _Delay = 0.0
    """Delay of the leaking light relative to the launched modulation [s]."""
    depolarization: _Share = 0.0
    """0 for leaking light that keeps its polarization, 1 for unpolarized light [1]."""
    part: Part = "all"
    """Affected samples: of the scan, of open-water shots, or both."""


class Counting(Description):
    """Dead time and after-pulses of a detector that counts photons."""

    dead_time: Annotated[Time, Field(ge=0, le=1e-3)] = 0.0
    """Time after each count in which the detector does not count [s]. Photons in this
    time do not extend it."""
    after_pulse_probability: _Share = 0.0
    """Number of after-pulses per count [1]."""
    after_pulse_delay: Annotated[Time, Field(ge=0, le=1e-3)] = 0.0
    """Mean delay of an after-pulse; the delays have an exponential distribution [s]."""


class Compression(Description):
    """Gain compression: the gain falls linearly with the amplitude."""

    fraction: _Share
    """Relative loss of gain at the amplitude `amplitude` [1]. The gain never falls
    below zero."""
    amplitude: Annotated[Voltage, Field(gt=0, le=1e4)]
    """Amplitude at which the loss of gain is `fraction` [V]."""


class Walk(Description):
    """Amplitude-dependent phase error (walk)."""

    phase_per_decade: _Phase
    """Phase error per factor of ten in amplitude [rad]."""
    amplitude: Annotated[Voltage, Field(gt=0, le=1e4)]
    """Amplitude at which the phase error is zero [V]."""


class Reflection(Description):
    """Cable reflection: delayed echo of the signal."""

    coefficient: Annotated[Fraction, Field(ge=-1, le=1)]
    """Product of the reflection coefficients of both ends [1]."""
    delay: Annotated[Time, Field(ge=0, le=1e-3)]
    """Time from one end of the cable to the other and back; 10 ns for one meter of
    coaxial cable [s]."""


class Crosstalk(Description):
    """Electrical crosstalk of the modulation into the receiver electronics."""

    amplitude: _Volts | tuple[_Volts, ...]
    """Amplitude in the output, the same for all modulation frequencies or one value for
    each [V]."""
    phase: _Phase = 0.0
    """Phase of the crosstalk at frequency zero [rad]."""
    delay: _Delay = 0.0
    """Delay; it adds a phase proportional to the frequency [s]."""
    change: _Change = 0.0
    """Relative change of the amplitude from the first to the last sample [1]."""
    part: Part = "all"
    """Affected samples: of the scan, of open-water shots, or both."""


class Drift(Description):
    """Drift of the signal during the scan, linear or exponential in time."""

    phase: _Phase = 0.0
    """Change of the phase, equal for all frequencies [rad]."""
    delay: _Delay = 0.0
    """Change of the delay [s]."""
    power: _Change = 0.0
    """Relative change of the launched power [1]."""
    modulation_depth: _Change = 0.0
    """Relative change of the modulation depth [1]."""
    settling_time: Annotated[Time, Field(gt=0, le=1e6)] | None = None
    """Time constant of an exponential change; the change is linear in time by default
    [s]."""


class TemperatureError(Description):
    """Phase error due to the temperature of the instrument."""

    temperature: Annotated[Temperature, Field(ge=-60, le=100)]
    """True temperature of the instrument [degC]."""
    reference: Annotated[Temperature, Field(ge=-60, le=100)] = 20.0
    """Temperature at which the phase error is zero [degC]."""
    delay_per_degree: Annotated[Time, Field(ge=-1e-6, le=1e-6)] = 0.0
    """Change of the delay per degree [s]."""
    phase_per_degree: _Phase = 0.0
    """Change of the phase per degree, equal for all frequencies [rad]."""


class ScaleChange(Description):
    """Error of the demodulator that appears when it changes its input range."""

    above: _Volts
    """Amplitude above which the demodulator uses the other range [V]."""
    phase: _Phase = 0.0
    """Phase error of the other range [rad]."""
    gain: _Change = 0.0
    """Gain of the other range divided by the gain of the normal range, minus 1 [1]."""


class Demodulator(Description):
    """Offsets, gain and phase errors, and resolution of the two lock-in outputs."""

    in_phase_offset: Annotated[Voltage, Field(ge=-1e4, le=1e4)] = 0.0
    """Offset of the in-phase output [V]."""
    quadrature_offset: Annotated[Voltage, Field(ge=-1e4, le=1e4)] = 0.0
    """Offset of the quadrature output [V]."""
    quadrature_gain: _Change = 0.0
    """Gain of the quadrature output divided by the gain of the in-phase output, minus 1
    [1]."""
    quadrature_phase: Annotated[Angle, Field(ge=-1.5, le=1.5)] = 0.0
    """Angle between the two reference waves, minus 90 degrees [rad]."""
    resolution: _Volts = 0.0
    """Step of the digitized outputs [V]."""


class OutputNoise(Description):
    """Output noise in excess of the stated uncertainty."""

    white: _Volts = 0.0
    """Standard deviation of white noise, which is independent from sample to sample
    [V]."""
    pink: _Volts = 0.0
    """Standard deviation of pink noise over the whole measurement [V]. The noise has
    equal power in each octave, from the duration of a pixel to the duration of the
    measurement."""


class InstrumentErrors(Description):
    """Instrument errors in a simulation; each is off by default.

    The errors act in the order of the fields. Rejection and ranging do not read them,
    because real errors are unknown, too.

    Examples
    --------
    >>> from amulor.survey import InstrumentErrors
    >>> errors = InstrumentErrors(
    ...     crosstalk={"amplitude": "70 uV", "phase": "47 deg", "part": "scan"},
    ...     drift={"delay": "30 ps"},
    ... )
    >>> errors.crosstalk.part, errors.walk is None
    ('scan', True)
    """

    pointing: Pointing | None = None
    """Errors of the beam directions."""
    clock: Clock | None = None
    """Error of the modulation frequencies."""
    plume: Plume | None = None
    """Plume of turbid water across the scan."""
    gradient: Gradient | None = None
    """Water whose concentration changes with the distance."""
    bubbles: Bubbles | None = None
    """Bubbles in the beam."""
    drift: Drift | None = None
    """Drift of the power and modulation depth of the light, and of the phase and delay
    of the signal with crosstalk."""
    optical_leakage: OpticalLeakage | None = None
    """Light that leaks within the instrument."""
    counting: Counting | None = None
    """Dead time and after-pulses."""
    harmonic: Harmonic | None = None
    """Response of the lock-in amplifier to a harmonic."""
    compression: Compression | None = None
    """Gain that depends on the amplitude."""
    walk: Walk | None = None
    """Phase that depends on the amplitude."""
    reflection: Reflection | None = None
    """Reflection in a cable."""
    crosstalk: Crosstalk | None = None
    """Electrical crosstalk."""
    temperature: TemperatureError | None = None
    """Phase and delay that depend on the temperature of the instrument."""
    scale_change: ScaleChange | None = None
    """Change between input ranges of the demodulator."""
    demodulator: Demodulator | None = None
    """Offsets, gain and angle of the demodulator's outputs."""
    noise: OutputNoise | None = None
    """Noise in excess of the stated uncertainty."""
