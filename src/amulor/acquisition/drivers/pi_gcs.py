"""Stages behind controllers of Physik Instrumente, by the General Command Set 2.0."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from amulor.acquisition.clock import Clock
from amulor.acquisition.links.visa import Conversation
from amulor.acquisition.settings import ScannerSettings, TargetSettings
from amulor.errors import InstrumentError

#: What ERR? answers after a stop on purpose.
_STOPPED = 10
_POLL = 2e-3
#: Difference of position and goal beyond which the controller is asked for an error,
#: in the unit of the axis.
_ASTRAY = 0.01


class PiController:
    """A controller with one or more axes.

    Lines end with a line feed; in an answer of several lines all but the last end with
    a space before it (chapter "GCS commands" of the manuals, such as MS249E, page 116).

    Parameters
    ----------
    link : Conversation
        An open link.
    clock : Clock
        What waits go by.
    """

    #: What a line ends with on a serial port.
    serial_end = "\n"

    def __init__(self, link: Conversation, *, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        (self._identity,) = link.ask("*IDN?")

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def enable(self, axes: Sequence[str]) -> None:
        """Close the servo loop of axes that know where they are.

        Raises
        ------
        InstrumentError
            If one has not been referenced: that move is for somebody who looks on.
        """
        self._link.send("SVO " + " ".join(f"{axis} 1" for axis in axes))
        self.raise_error()
        known = self._values("FRF?", axes)
        for axis in axes:
            if known[axis] != 1:
                raise InstrumentError(
                    f"axis {axis} at {self._link.address} does not know where it is; "
                    f"see that nothing is in its way, and reference it (FRF {axis})"
                )

    def move(self, goals: Mapping[str, float], *, timeout: float) -> list[float]:
        """Move axes and wait until they are on target.

        Parameters
        ----------
        goals : mapping
            Axis to position, in the unit of the axis.
        timeout : float
            How long it may take [s].

        Returns
        -------
        list of float
            Where they stand, in the same order.

        Raises
        ------
        InstrumentError
            If they do not arrive, or the controller refuses.
        """
        axes = [*goals]
        listed = " ".join(axes)
        question = f"ONT? {listed}\nPOS? {listed}"
        words = [f"{axis} {goal:.7f}" for axis, goal in goals.items()]
        # Sent together with the first question: a network holds a second small packet
        # back until the first is acknowledged, some 40 ms.
        line = "MOV " + " ".join(words) + "\n" + question
        end = self._clock.now() + timeout
        while True:
            lines = self._link.ask(line, answers=2 * len(axes))
            line = question
            arrived = self._parsed(lines[: len(axes)], axes, "ONT?")
            if all(value == 1 for value in arrived.values()):
                break
            if self._clock.now() > end:
                self.raise_error()
                raise InstrumentError(
                    f"axes {listed} at {self._link.address} are not on target "
                    f"{timeout:g} s after MOV; see what holds them"
                )
            self._clock.sleep(_POLL)
        result = self._parsed(lines[len(axes) :], axes, "POS?")
        if any(abs(result[axis] - goal) > _ASTRAY for axis, goal in goals.items()):
            self.raise_error()
        return [result[axis] for axis in axes]

    def stop(self) -> None:
        """Stop all axes, over a new link if the old one is lost."""
        try:
            self._stop()
        except InstrumentError:
            self._link.reopen()
            self._stop()

    def raise_error(self) -> None:
        """Raise if the controller has an error to tell, which is then forgotten."""
        (code,) = self._link.ask("ERR?")
        if code not in ("0", str(_STOPPED)):
            raise InstrumentError(
                f"the controller at {self._link.address} reports error {code}; its "
                "manual lists the codes (7: position out of limits)"
            )

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _stop(self) -> None:
        self._link.send("STP")
        self.raise_error()

    def _values(self, question: str, axes: Sequence[str]) -> dict[str, float]:
        line = f"{question} {' '.join(axes)}"
        return self._parsed(self._link.ask(line, answers=len(axes)), axes, question)

    def _parsed(
        self, lines: Sequence[str], axes: Sequence[str], question: str
    ) -> dict[str, float]:
        try:
            pairs = (line.split("=") for line in lines)
            result = {axis.strip(): float(value) for axis, value in pairs}
        except ValueError:
            result = {}
        if sorted(result) != sorted(axes):
            raise InstrumentError(
                f"the controller at {self._link.address} has answered {question} by "
                f"{list(lines)}, needed is a value for each of {', '.join(axes)}"
            )
        return result


class _OnController:
    def __init__(self, controller: PiController, axes: Sequence[str]) -> None:
        self._controller = controller
        self._axes = axes
        controller.enable(axes)

    def identity(self) -> str:
        """Return controller and axes."""
        return f"axis {', '.join(self._axes)} of {self._controller.identity()}"

    def make_safe(self) -> None:
        """Stop."""
        self._controller.stop()

    def close(self) -> None:
        """Close the link."""
        self._controller.close()


class PiScanner(_OnController):
    """Two axes that turn the beam.

    Parameters
    ----------
    controller : PiController
        That both axes belong to.
    settings : ScannerSettings
        Axes, their zero, and the turn per unit.
    """

    def __init__(self, controller: PiController, settings: ScannerSettings) -> None:
        self._settings = settings
        super().__init__(controller, [settings.azimuth_axis, settings.elevation_axis])

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return where it stands [rad]."""
        own = self._settings
        zeros = (own.azimuth_zero, own.elevation_zero)
        goals = {
            axis: zero + angle / own.angle_per_unit
            for axis, zero, angle in zip(
                self._axes, zeros, (azimuth, elevation), strict=True
            )
        }
        across, up = self._controller.move(goals, timeout=timeout)
        return (
            (across - zeros[0]) * own.angle_per_unit,
            (up - zeros[1]) * own.angle_per_unit,
        )

    def make_safe(self) -> None:
        """Stop, and turn to where it is to be left if that is stated."""
        super().make_safe()
        own = self._settings
        if own.park_azimuth is not None and own.park_elevation is not None:
            self.move(own.park_azimuth, own.park_elevation, timeout=own.move_timeout)


class PiMount(_OnController):
    """One axis in degrees that turns a polarizer or a retarder.

    Parameters
    ----------
    controller : PiController
        That the axis belongs to.
    axis : str
        Its name.
    """

    def __init__(self, controller: PiController, axis: str) -> None:
        super().__init__(controller, [axis])

    def rotate(self, angle: float, *, timeout: float) -> float:
        """Turn to an angle [rad] within a time [s]; return where it stands [rad]."""
        goals = {self._axes[0]: math.degrees(angle)}
        return math.radians(self._controller.move(goals, timeout=timeout)[0])


class PiTargetStage(_OnController):
    """One axis in millimetres that carries the target.

    Parameters
    ----------
    controller : PiController
        That the axis belongs to.
    settings : TargetSettings
        Its name and the two positions.
    """

    def __init__(self, controller: PiController, settings: TargetSettings) -> None:
        self._settings = settings
        super().__init__(controller, [settings.axis])

    def bring_in(self, *, timeout: float) -> None:
        """Put the target where it is scanned, within a time [s]."""
        self._go(self._settings.position_in, timeout)

    def take_out(self, *, timeout: float) -> None:
        """Leave open water in every beam of the scan, within a time [s]."""
        self._go(self._settings.position_out, timeout)

    def _go(self, position: float, timeout: float) -> None:
        self._controller.move({self._axes[0]: position * 1e3}, timeout=timeout)
