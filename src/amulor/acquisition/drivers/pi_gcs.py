"""Driver of Physik Instrumente stages, with the General Command Set 2.0."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.links.lines import Conversation
from amulor.acquisition.settings import ScannerSettings, TargetSettings
from amulor.errors import InstrumentError

#: Answer of ERR? after a commanded stop.
_STOPPED = 10
#: First and longest time between two queries; it doubles each time [s].
_FIRST_POLL, _POLL = 0.2e-3, 2e-3
#: Part of the identity of every controller, in small letters.
_MAKER = "physik instrumente"
#: Query of the moving axes, the character 5; the answer is a hexadecimal bit mask.
_MOTION = "\x05"
#: Longest time for coming to rest after HLT, before STP is sent [s].
_HALT = 2.0
#: Difference of position and goal above which the controller is queried for an error,
#: in the unit of the axis.
_ASTRAY = 0.01
#: Fraction of the longest path of a sweep below which another axis is not moved.
_UNMOVED = 1e-2
#: Largest difference of position and goal of a mount [deg] and of the target [mm].
_MOUNT_OFF, _TARGET_OFF = 0.5, 1.0


class PiController:
    """Stage controller of Physik Instrumente with one or more axes.

    Lines end with a line feed. In an answer of several lines, all but the last have a
    space before it (chapter "GCS commands" of the manuals, such as MS249E, page 116).
    """

    #: Line end on a serial port.
    serial_end = "\n"

    def __init__(self, link: Conversation, *, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        (self._identity,) = link.ask("*IDN?")
        if _MAKER not in self._identity.lower():
            raise InstrumentError(
                f"at {link.address} is {self._identity!r}, needed is a controller of "
                "Physik Instrumente; check the address"
            )

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def enable(self, axes: Sequence[str]) -> None:
        """Switch on the servo loops of axes; raise if an axis is not homed."""
        self._link.send("SVO " + " ".join(f"{axis} 1" for axis in axes))
        self.raise_error()
        referenced = self._values("FRF?", axes)
        for axis in axes:
            if referenced[axis] != 1:
                raise InstrumentError(
                    f"axis {axis} at {self._link.address} does not know where it is; "
                    f"see that nothing is in its way, and reference it (FRF {axis})"
                )

    def refuse_beyond_reach(self, goals: Mapping[str, Sequence[float]]) -> None:
        """Raise if a goal is beyond the travel range of its axis."""
        low = self._values("TMN?", [*goals])
        high = self._values("TMX?", [*goals])
        for axis, positions in goals.items():
            # Rounded to the digits that MOV sends.
            least, most = round(min(positions), 7), round(max(positions), 7)
            if least < low[axis] or most > high[axis]:
                raise InstrumentError(
                    f"axis {axis} at {self._link.address} goes from {low[axis]:g} to "
                    f"{high[axis]:g}, the scan needs {least:.6g} to {most:.6g} in its "
                    "unit; check zero and unit of the axis in the devices file, or "
                    "change the scan"
                )

    def move(self, goals: Mapping[str, float], *, timeout: float) -> list[float]:
        """Move axes, wait until they reach their goals, and return their positions."""
        axes = [*goals]
        listed = " ".join(axes)
        words = [f"{axis} {goal:.7f}" for axis, goal in goals.items()]
        # Sent in a separate packet: a controller may answer a query before it moves.
        self._link.send("MOV " + " ".join(words))
        end, wait = Deadline(self._clock, timeout), _FIRST_POLL
        # Both are queries: the position is needed as soon as the goal is reached.
        question = f"ONT? {listed}\nPOS? {listed}"
        while True:
            answers = self._link.ask(question, answers=2 * len(axes))
            on_target = self._parsed(answers[: len(axes)], axes, "ONT?")
            result = self._parsed(answers[len(axes) :], axes, "POS?")
            if all(value == 1 for value in on_target.values()):
                break
            if end.passed():
                self.raise_error()
                raise InstrumentError(
                    f"axes {listed} at {self._link.address} are not on target "
                    f"{timeout:g} s after MOV; see what holds them"
                )
            self._clock.sleep(wait)
            wait = min(2 * wait, _POLL)
        if any(abs(result[axis] - goal) > _ASTRAY for axis, goal in goals.items()):
            self.raise_error()
        return [result[axis] for axis in axes]

    def velocities(self, axes: Sequence[str]) -> dict[str, float]:
        """Return the velocity setting of each axis, in axis units per second."""
        return self._values("VEL?", axes)

    def set_velocities(self, velocities: Mapping[str, float]) -> None:
        """Set the velocity of axes, in axis units per second."""
        words = [f"{axis} {value:.7g}" for axis, value in velocities.items()]
        self._link.send("VEL " + " ".join(words))

    def set_out(self, goals: Mapping[str, float]) -> None:
        """Start to move axes to positions, in axis units, without waiting."""
        words = [f"{axis} {goal:.7f}" for axis, goal in goals.items()]
        self._link.send("MOV " + " ".join(words))

    def positions(self, axes: Sequence[str]) -> list[float]:
        """Return the present positions of axes, in axis units."""
        values = self._values("POS?", axes)
        return [values[axis] for axis in axes]

    def stop(self) -> None:
        """Stop all axes, through a new link if the old link is broken."""
        try:
            self._stop()
        except InstrumentError:
            self._link.reopen()
            self._stop()

    def raise_error(self) -> None:
        """Raise if the controller reports an error; the query clears the error."""
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
        """Halt all axes smoothly; stop them abruptly if one still moves."""
        self._link.send("HLT")
        (code,) = self._link.ask("ERR?")
        if code in ("0", str(_STOPPED)) and self._comes_to_rest():
            return
        self._link.send("STP")
        self.raise_error()

    def _comes_to_rest(self) -> bool:
        end = Deadline(self._clock, _HALT)
        while True:
            (answer,) = self._link.ask(_MOTION)
            try:
                if int(answer, base=16) == 0:
                    return True
            except ValueError:
                return False
            if end.passed():
                return False
            self._clock.sleep(_POLL)

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
        """Return the identity of the controller, and its axes."""
        return f"axis {', '.join(self._axes)} of {self._controller.identity()}"

    def make_safe(self) -> None:
        """Stop all axes of the controller."""
        self._controller.stop()

    def close(self) -> None:
        """Close the link."""
        self._controller.close()


class PiScanner(_OnController):
    """Scanner of two stage axes that turn the beam."""

    def __init__(self, controller: PiController, settings: ScannerSettings) -> None:
        self._settings = settings
        #: Velocities outside sweeps, read at the first sweep; whether a sweep changed
        #: them.
        self._fast: dict[str, float] = {}
        self._is_slow = False
        #: Positions after the last move, until the next one starts.
        self._current: dict[str, float] | None = None
        super().__init__(controller, [settings.azimuth_axis, settings.elevation_axis])

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad] within a time [s]; return the read-back [rad]."""
        self._restore_velocities()
        self._current = None
        across, up = self._controller.move(
            self._goals(azimuth, elevation), timeout=timeout
        )
        self._current = dict(zip(self._axes, (across, up), strict=True))
        return self._directions(across, up)

    def begin_sweep(self, azimuth: float, elevation: float, *, duration: float) -> None:
        """Start a motion that reaches a direction [rad] after a time [s]; do not wait.

        Notes
        -----
        Axes already at their goal are not moved. Velocities (VEL) are constant over the
        whole path; the next move, or the end of the scan, restores the former ones.
        """
        if not self._fast:
            self._fast = self._controller.velocities(self._axes)
        goals = self._goals(azimuth, elevation)
        origin = self._current or dict(
            zip(self._axes, self._controller.positions(self._axes), strict=True)
        )
        self._current = None
        distances = {axis: abs(goal - origin[axis]) for axis, goal in goals.items()}
        moved = [
            axis
            for axis in goals
            if distances[axis] > _UNMOVED * max(distances.values())
        ]
        slow = {axis: distances[axis] / duration for axis in moved}
        for axis, velocity in slow.items():
            if velocity > self._fast[axis]:
                raise InstrumentError(
                    f"axis {axis} would have to move by {velocity:.4g} of its units in "
                    f"a second, set is a velocity of {self._fast[axis]:.4g}; take a "
                    "longer dwell, or raise VEL if the stage bears it"
                )
        self._is_slow = True
        self._controller.set_velocities(slow)
        self._controller.set_out({axis: goals[axis] for axis in moved})

    def where(self) -> tuple[float, float]:
        """Return the present direction, also during a motion [rad]."""
        return self._directions(*self._controller.positions(self._axes))

    def _restore_velocities(self) -> None:
        if self._is_slow:
            self._controller.set_velocities(self._fast)
            self._is_slow = False

    def _goals(self, azimuth: float, elevation: float) -> dict[str, float]:
        return {
            axis: position
            for axis, (position,) in self._positions([azimuth], [elevation]).items()
        }

    def _directions(self, across: float, up: float) -> tuple[float, float]:
        settings = self._settings
        return (
            (across - settings.azimuth_zero) * settings.angle_per_unit,
            (up - settings.elevation_zero) * settings.angle_per_unit,
        )

    def refuse_beyond_reach(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> None:
        """Raise if a direction [rad] is beyond the travel range of an axis."""
        settings = self._settings
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            azimuth = [*azimuth, settings.park_azimuth]
            elevation = [*elevation, settings.park_elevation]
        self._controller.refuse_beyond_reach(self._positions(azimuth, elevation))

    def _positions(
        self, azimuth: Sequence[float], elevation: Sequence[float]
    ) -> dict[str, list[float]]:
        """Return the axis positions for beam directions, in axis units."""
        settings = self._settings
        zeros = (settings.azimuth_zero, settings.elevation_zero)
        return {
            axis: [zero + angle / settings.angle_per_unit for angle in angles]
            for axis, zero, angles in zip(
                self._axes, zeros, (azimuth, elevation), strict=True
            )
        }

    def make_safe(self) -> None:
        """Stop both axes, and turn to the parking direction, if one is set."""
        super().make_safe()
        self._restore_velocities()
        settings = self._settings
        if settings.park_azimuth is not None and settings.park_elevation is not None:
            self.move(
                settings.park_azimuth,
                settings.park_elevation,
                timeout=settings.move_timeout,
            )


def _refuse_off_target(part: str, position: float, goal: float, *, near: float) -> None:
    if not abs(position - goal) <= near:
        raise InstrumentError(
            f"{part} is on target at {position:g} and was sent to {goal:g}, in the "
            "unit of its axis; reference it, and see what holds it"
        )


class PiMount(_OnController):
    """Rotation stage (one axis, in degrees) that turns a polarizer or a retarder."""

    def __init__(self, controller: PiController, axis: str) -> None:
        super().__init__(controller, [axis])

    def rotate(self, angle: float, *, timeout: float) -> float:
        """Turn to an angle [rad] within a time [s]; return the read-back [rad]."""
        goal = math.degrees(angle)
        (reached,) = self._controller.move({self._axes[0]: goal}, timeout=timeout)
        _refuse_off_target(f"mount {self._axes[0]}", reached, goal, near=_MOUNT_OFF)
        return math.radians(reached)

    def refuse_beyond_reach(self, angles: Sequence[float]) -> None:
        """Raise if an angle [rad] is beyond the travel range of the axis."""
        goals = [math.degrees(angle) for angle in angles]
        self._controller.refuse_beyond_reach({self._axes[0]: goals})


class PiTargetStage(_OnController):
    """Linear stage (one axis, in millimeters) that carries the target."""

    def __init__(self, controller: PiController, settings: TargetSettings) -> None:
        self._settings = settings
        super().__init__(controller, [settings.axis])

    def bring_in(self, *, timeout: float) -> float:
        """Put the target into the beam within a time [s]; return its position [m]."""
        return self._go(self._settings.position_in, timeout)

    def take_out(self, *, timeout: float) -> float:
        """Take the target out of the beam in a time [s]; return its position [m]."""
        return self._go(self._settings.position_out, timeout)

    def _go(self, position: float, timeout: float) -> float:
        goal = position * 1e3
        (reached,) = self._controller.move({self._axes[0]: goal}, timeout=timeout)
        _refuse_off_target("the target", reached, goal, near=_TARGET_OFF)
        return reached / 1e3

    def refuse_beyond_reach(self) -> None:
        """Raise if a position of the target is beyond the travel range."""
        settings = self._settings
        goals = [settings.position_in * 1e3, settings.position_out * 1e3]
        self._controller.refuse_beyond_reach({self._axes[0]: goals})
