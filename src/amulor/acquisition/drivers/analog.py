"""Scanner mirrors driven by analog outputs of a lock-in, NI card or LabJack."""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from amulor.acquisition.clock import Clock
from amulor.acquisition.settings.parts import AnalogSettings, MirrorSettings
from amulor.errors import InstrumentError

#: Measured angles from which on a curve, not a line, is fitted.
_CURVED = 5


class Outputs(Protocol):
    """Analog voltage outputs, addressed by name."""

    def identity(self) -> str:
        """Return the identity of the device that has the outputs."""

    def set(self, volts: dict[str, float]) -> dict[str, float]:
        """Set the outputs [V]; return the voltages read back, else the set values."""

    def close(self) -> None:
        """Release the outputs."""


class LockInOutputs:
    """Auxiliary outputs of a lock-in, counted from 1, with read-back."""

    def __init__(self, lock_in: Any) -> None:
        if not hasattr(lock_in, "set_output"):
            raise InstrumentError(
                f"{lock_in.identity()} has no outputs to turn mirrors by; choose other "
                "scanner.analog.outputs"
            )
        self._lock_in = lock_in

    def identity(self) -> str:
        """Return the identity of the device that has the outputs."""
        return f"outputs of {self._lock_in.identity()}"

    def set(self, volts: dict[str, float]) -> dict[str, float]:
        """Set the outputs [V] and read them back [V]."""
        return {
            name: self._lock_in.set_output(int(name), value)
            for name, value in volts.items()
        }

    def close(self) -> None:
        """Do nothing: the link belongs to the lock-in."""


class NidaqOutputs:
    """Analog outputs of a National Instruments card (nidaqmx), without read-back."""

    def __init__(self, limits: dict[str, tuple[float, float]]) -> None:
        package = _imported("nidaqmx", "mirrors on a card of National Instruments")
        self._names = [*limits]
        self._task: Any = None
        try:
            self._task = package.Task()
            for name, (low, high) in limits.items():
                self._task.ao_channels.add_ao_voltage_chan(
                    name, min_val=low, max_val=high
                )
        except Exception as error:
            self.close()
            raise _failed("nidaqmx", error) from error

    def identity(self) -> str:
        """Return the identity of the device that has the outputs."""
        return f"nidaqmx {', '.join(self._names)}"

    def set(self, volts: dict[str, float]) -> dict[str, float]:
        """Set all outputs at once [V]; return the commanded voltages [V]."""
        try:
            self._task.write([volts[name] for name in self._names], auto_start=True)
        except Exception as error:
            raise _failed("nidaqmx", error) from error
        return volts

    def close(self) -> None:
        """Release the channels; the outputs hold their voltages."""
        if self._task is not None:
            self._task.close()
            self._task = None


class LabjackOutputs:
    """Analog outputs of a LabJack (package ljm), with read-back of its registers."""

    def __init__(self, address: str | None) -> None:
        package = _imported("labjack.ljm", "mirrors on a LabJack")
        self._ljm = package
        self._handle: Any = None
        try:
            self._handle = package.openS("ANY", "ANY", address or "ANY")
            self._serial = package.eReadName(self._handle, "SERIAL_NUMBER")
        except Exception as error:
            self.close()
            raise _failed("LabJack", error) from error

    def identity(self) -> str:
        """Return the identity of the device that has the outputs."""
        return f"LabJack {self._serial:.0f}"

    def set(self, volts: dict[str, float]) -> dict[str, float]:
        """Set the outputs [V] and read the registers back [V]."""
        try:
            for name, value in volts.items():
                self._ljm.eWriteName(self._handle, name, value)
            return {
                name: float(self._ljm.eReadName(self._handle, name)) for name in volts
            }
        except Exception as error:
            raise _failed("LabJack", error) from error

    def close(self) -> None:
        """Close the link; it may be called twice."""
        if self._handle is not None:
            self._ljm.close(self._handle)
            self._handle = None


class Mirror:
    """Calibration of a mirror: beam angle as a function of voltage.

    The fit is a line for three or four pairs, and a parabola for five or more, by least
    squares. `spread` is the standard deviation of the residuals, the uncertainty of an
    angle.
    """

    def __init__(self, settings: MirrorSettings) -> None:
        self._settings = settings
        volts, angles = np.array(settings.volts), np.array(settings.angles)
        degree = 2 if volts.size >= _CURVED else 1
        self._fit = np.polynomial.Polynomial.fit(volts, angles, degree)
        residuals = angles - self._fit(volts)
        free = volts.size - degree - 1
        self.spread = math.sqrt(float(np.sum(residuals**2)) / free)
        slope = self._fit.deriv()(volts)
        if not (np.all(slope > 0) or np.all(slope < 0)):
            raise InstrumentError(
                f"the angles of output {settings.output} turn back within its "
                "voltages; measure them again (scanner.analog of the devices file)"
            )

    def angle(self, volts: float) -> float:
        """Return the beam angle [rad] at a mirror voltage [V]."""
        return float(self._fit(volts))

    def volts(self, angle: float) -> float:
        """Return mirror voltage [V] for a beam angle [rad]; raise if out of range."""
        low, high = self._settings.volts[0], self._settings.volts[-1]
        solutions = [
            float(root.real)
            for root in map(complex, (self._fit - angle).roots())
            if abs(root.imag) < 1e-9 and low - 1e-9 <= root.real <= high + 1e-9
        ]
        if not solutions:
            ends = sorted((self.angle(low), self.angle(high)))
            raise InstrumentError(
                f"output {self._settings.output} turns the beam from {ends[0]:.5g} to "
                f"{ends[1]:.5g} rad, the scan needs {angle:.5g} rad; make the spans of "
                "the scan smaller, or measure angles at more voltages"
            )
        return min(max(solutions[0], low), high)


class AnalogScanner:
    """Scanner with two mirrors, each driven by an analog output."""

    def __init__(
        self,
        outputs: Outputs,
        settings: AnalogSettings,
        *,
        clock: Clock,
        tolerance: float,
    ) -> None:
        self._outputs, self._settings, self._clock = outputs, settings, clock
        self._mirrors = [Mirror(settings.azimuth), Mirror(settings.elevation)]
        self.spread = max(mirror.spread for mirror in self._mirrors)
        if self.spread > tolerance:
            raise InstrumentError(
                f"the angles that were measured of the mirrors scatter by "
                f"{self.spread:.2g} rad, procedure.position_tolerance is "
                f"{tolerance:.2g} rad: what is read back says no more; measure them "
                "again, or raise it"
            )

    def identity(self) -> str:
        """Return the output device's identity and the uncertainty of beam angles."""
        return (
            f"mirrors on {self._outputs.identity()}, angles known to "
            f"{self.spread * 1e6:.3g} urad"
        )

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad]; return the direction for the output voltages."""
        names = (self._settings.azimuth.output, self._settings.elevation.output)
        volts = [
            mirror.volts(angle)
            for mirror, angle in zip(self._mirrors, (azimuth, elevation), strict=True)
        ]
        put_out = self._outputs.set(dict(zip(names, volts, strict=True)))
        self._clock.sleep(self._settings.settling)
        across, up = (
            mirror.angle(put_out[name])
            for mirror, name in zip(self._mirrors, names, strict=True)
        )
        return across, up

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if a direction [rad] is beyond the calibrated range of a mirror."""
        for mirror, angles in zip(self._mirrors, (azimuth, elevation), strict=True):
            for angle in angles:
                mirror.volts(angle)

    def make_safe(self) -> None:
        """Do nothing: mirrors may stay where they are, and the laser is off."""

    def close(self) -> None:
        """Release the outputs."""
        self._outputs.close()


def outputs_of(settings: AnalogSettings, *, lock_in: Any, address: str | None) -> Any:
    """Return the analog outputs configured in the devices file."""
    if settings.outputs == "lock_in":
        return LockInOutputs(lock_in)
    if settings.outputs == "labjack":
        return LabjackOutputs(address)
    return NidaqOutputs(
        {
            mirror.output: (mirror.volts[0], mirror.volts[-1])
            for mirror in (settings.azimuth, settings.elevation)
        }
    )


def _imported(name: str, purpose: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        package = {"labjack.ljm": "labjack-ljm"}.get(name, name)
        raise InstrumentError(
            f"{purpose} need {package}, not installed so far; install with: pip "
            f"install {package}, and the maker's driver"
        ) from None


def _failed(device: str, error: Exception) -> InstrumentError:
    text = " ".join(str(error).split())
    return InstrumentError(
        f"{device} has failed: {type(error).__name__}: {text}; check cable, driver and "
        "scanner.analog of the devices file"
    )
