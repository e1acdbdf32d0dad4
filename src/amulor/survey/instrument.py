"""Instrument of a survey: emitter, receiver, detector, lock-in, window, daylight."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.optics.polarization import stokes
from amulor.survey.instrument_errors import InstrumentErrors
from amulor.survey.quantity import (
    Angle,
    Description,
    Fraction,
    Frequency,
    Length,
    PerMetre,
    Position,
    Power,
    SpectralRadiance,
    Time,
    Voltage,
    Wavelength,
)


class Daylight(Description):
    """Daylight in the field of view of the receiver, a source of shot noise.

    Examples
    --------
    >>> from amulor.survey import Daylight
    >>> light = Daylight(
    ...     radiance="0.02 W/(m^2 sr nm)",
    ...     bandwidth="10 nm",
    ...     depth="12 m",
    ...     diffuse_attenuation="0.1 1/m",
    ... )
    >>> light.bandwidth, light.depth
    (1e-08, 12.0)
    """

    radiance: Annotated[SpectralRadiance, Field(ge=0)]
    """Spectral radiance just below the surface, in the direction of the view, such as
    "0.01 W/m^2/sr/nm" [W/(m^2 sr m)]."""
    bandwidth: Annotated[Length, Field(gt=0, le=300e-9)]
    """Width of the optical filter before the detector [m]."""
    depth: Annotated[Length, Field(ge=0)] = 0.0
    """Depth of the instrument below the surface [m]."""
    diffuse_attenuation: Annotated[PerMetre, Field(ge=0)] = 0.0
    """Diffuse attenuation coefficient K_d of the water above the instrument [1/m]."""


#: Launched and analyzed state: vertical, horizontal, +45 and -45 degrees, right, left.
PolarizationPair = Annotated[str, Field(pattern=f"^({stokes.PAIR_PATTERN})$")]


class Emitter(Description):
    """Emitter: origin of the beam, and beam direction at scan angles of zero.

    Examples
    --------
    >>> from amulor.survey import Emitter
    >>> Emitter(
    ...     position=("-5 cm", "0 cm", "0 cm"),
    ...     beam_radius="1 mm",
    ...     beam_divergence="0.5 mrad",
    ... ).position
    (-0.05, 0.0, 0.0)
    """

    position: Position = (0.0, 0.0, 0.0)
    """Position of the beam's start (right, down, forward) [m]."""
    beam_radius: Annotated[Length, Field(ge=0, le=0.5)] | None = None
    """1/e half-width of the Gaussian beam at its start; by default a thin beam [m]."""
    beam_divergence: Annotated[Angle, Field(ge=0, le=0.2)] | None = None
    """1/e semi-angle of the beam, in the medium at the emitter; 0 by default [rad]."""


class Receiver(Description):
    """Receiver: aperture, field of view and direction.

    With sharp edges, aperture and field of view are a disc and a cone of the same area
    and solid angle.

    Examples
    --------
    >>> from amulor.survey import Receiver
    >>> Receiver(
    ...     position=("15 cm", "0 cm", "0 cm"),
    ...     radius="2.5 cm",
    ...     acceptance="20 mrad",
    ... ).acceptance
    0.02
    """

    position: Position
    """Center of the aperture (right, down, forward) [m]."""
    azimuth: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Azimuth of the receiver's axis at the middle of the scan, positive to the right
    [rad]."""
    elevation: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Elevation of the receiver's axis at the middle of the scan, positive upwards
    [rad]."""
    radius: Annotated[Length, Field(gt=0)]
    """1/e half-width R of the aperture, whose area is pi R^2 [m]."""
    acceptance: Annotated[Angle, Field(gt=0, le=0.5)]
    """1/e half-width gamma of the field of view, in the medium at the receiver
    [rad]."""
    edge: Literal["gaussian", "sharp"] | None = None
    """Shape of aperture and field of view: Gaussian (default), or with sharp edges."""
    speckle_cells: Annotated[float, Field(ge=1, le=1e15)] | None = None
    """Number M of speckles of the target's light within the aperture; no speckle by
    default [1]. The power varies by 1 / sqrt(M) from pixel to pixel."""


class Detector(Description):
    """Photomultiplier and the optics in front of it.

    Examples
    --------
    >>> from amulor.survey import Detector
    >>> Detector(
    ...     quantum_efficiency="25 %", dark_rate="2 kHz", saturation="0.5 V"
    ... ).quantum_efficiency
    0.25
    """

    quantum_efficiency: Annotated[Fraction, Field(gt=0, le=1)] = 0.25
    """Photoelectrons per photon [1]."""
    optical_transmission: Annotated[Fraction, Field(gt=0, le=1)] = 1.0
    """Fraction of the collected light that reaches the photocathode [1]."""
    excess_noise_factor: Annotated[float, Field(ge=1)] = 1.2
    """Factor by which the multiplication increases the shot-noise power [1]."""
    dark_rate: Annotated[Frequency, Field(ge=0)] = 0.0
    """Rate of dark counts, which occur without light [Hz]."""
    volt_per_photoelectron_rate: Annotated[float, Field(gt=0)] = 8.0e-12
    """Output voltage per rate of photoelectrons; 8e-12 is a gain of 1e6 into 50 ohm [V
    s]."""
    saturation: Annotated[Voltage, Field(gt=0)] = 1.0
    """Largest mean output in the linear range [V]."""


class LockIn(Description):
    """Lock-in amplifier: time constant and phase floor.

    Examples
    --------
    >>> from amulor.survey import LockIn
    >>> LockIn(time_constant="3 ms", phase_floor="0.5 mrad").phase_floor
    0.0005
    """

    time_constant: Annotated[Time, Field(gt=0)] = 0.01
    """Time constant of the one-pole output filter [s]."""
    phase_floor: Annotated[Angle, Field(ge=0, le=1)] = 0.0
    """Random phase error of one sample, independent of the amount of light [rad]."""
    demodulator: Literal["digital", "analog"] | None = None
    """Kind of demodulator; digital by default. The outputs of analog mixers typically
    differ by 1 % in gain and by 1 degree from a right angle. The range error contains
    this, unless phase_uncertainty is stated or "amulor calibrate demodulator" has
    measured it."""


class Window(Description):
    """Flat window between the instrument, which is in air, and the water.

    Examples
    --------
    >>> from amulor.survey import Window
    >>> Window(
    ...     distance="20 cm", thickness="1 cm", reflection_loss=True
    ... ).refractive_index
    1.47
    """

    distance: Annotated[Length, Field(gt=0)]
    """Forward coordinate of the window's face in air [m]."""
    thickness: Annotated[Length, Field(ge=0)]
    """Thickness of the pane [m]."""
    refractive_index: Annotated[float, Field(ge=1, le=2.5)] = 1.47
    """Phase index of the pane [1]."""
    group_index: Annotated[float, Field(ge=1, le=2.5)] = 1.50
    """Group index of the pane [1]."""
    reflection_loss: bool | None = None
    """Loss by Fresnel reflection at both faces, on the way out and back; no loss by
    default."""


class Instrument(Description):
    """Amplitude-modulated laser radar: laser, modulation, receiver and lock-in.

    Examples
    --------
    >>> from amulor.survey import Survey
    >>> survey = Survey.preset("amulor-2010")
    >>> survey.instrument.power, survey.instrument.polarizations
    (0.02, ('VV', 'VH'))
    >>> faster = survey.with_({"instrument.modulation_frequencies": ["80 MHz"]})
    >>> faster.instrument.modulation_frequencies
    (80000000.0,)
    """

    wavelength: Annotated[Wavelength, Field(ge=400e-9, le=700e-9)]
    """Wavelength of the laser in vacuum [m]."""
    power: Annotated[Power, Field(gt=0)]
    """Mean launched power [W]."""
    modulation_depth: Annotated[Fraction, Field(gt=0, le=1)]
    """Depth m of the intensity modulation [1]."""
    modulation_frequencies: Annotated[
        tuple[Annotated[Frequency, Field(gt=0, le=10e9)], ...], Field(min_length=1)
    ]
    """Modulation frequencies of every pixel, in increasing order [Hz]."""
    polarizations: Annotated[tuple[PolarizationPair, ...], Field(min_length=1)]
    """Pairs of launched and analyzed polarization, such as "VH"; "none" for an
    instrument without polarizers."""
    emitter: Emitter = Emitter()
    """Emitter."""
    receiver: Receiver
    """Receiver."""
    detector: Detector = Detector()
    """Detector."""
    lock_in: LockIn = LockIn()
    """Lock-in amplifier."""
    window: Window | None = None
    """Window between instrument and water; none by default."""
    phase_uncertainty: Annotated[Angle, Field(ge=0, le=0.5)] | None = None
    """Standard uncertainty of the phase at each modulation frequency from leakage,
    amplitude-dependent phase and harmonics [rad]. The default is 0.5 degrees for
    calibrated phases, three times as much without calibration, and six times as much
    without calibration at one frequency. If the leakage was measured, 0.4 degrees
    replace 0.5. At one frequency no other phase tests a stated value: without a
    calibration of the phases, it is multiplied by 2.2. 0 means an instrument without
    such errors."""
    errors: InstrumentErrors | None = None
    """Instrument errors that simulated samples contain; none by default."""

    @model_validator(mode="after")
    def _lists_are_in_order(self) -> Self:
        frequencies = self.modulation_frequencies
        if any(b <= a for a, b in pairwise(frequencies)):
            raise ValueError(
                "modulation_frequencies must increase and hold each one once; found "
                + ", ".join(f"{value / 1e6:g} MHz" for value in frequencies)
            )
        twice = [p for p, count in Counter(self.polarizations).items() if count > 1]
        if twice:
            raise ValueError(f"polarizations hold {twice[0]!r} more than once")
        return self

    @model_validator(mode="after")
    def _errors_belong_to_its_frequencies(self) -> Self:
        crosstalk = None if self.errors is None else self.errors.crosstalk
        if crosstalk is None or not isinstance(crosstalk.amplitude, tuple):
            return self
        count, needed = len(crosstalk.amplitude), len(self.modulation_frequencies)
        if count != needed:
            raise ValueError(
                f"errors.crosstalk.amplitude has {count} values for {needed} "
                "modulation frequencies; state one value, or one for each"
            )
        return self

    @model_validator(mode="after")
    def _stands_before_the_window(self) -> Self:
        if self.window is None:
            return self
        for name, side in (("emitter", self.emitter), ("receiver", self.receiver)):
            if side.position[2] >= self.window.distance:
                raise ValueError(
                    f"{name}.position is {side.position[2]:g} m forward, which is not "
                    f"before the window at {self.window.distance:g} m"
                )
        return self
