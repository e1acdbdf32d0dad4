"""A laser whose enable input is wired to an auxiliary output of the lock-in."""

from __future__ import annotations

from typing import Protocol

from amulor.acquisition.settings.light import LaserSettings
from amulor.errors import InstrumentError

#: Largest voltage that counts as off; an enable input of TTL levels needs 0.8 V [V].
_OFF = 0.1


class _HasOutputs(Protocol):
    def identity(self) -> str: ...

    def set_output(self, number: int, voltage: float) -> float: ...

    def input(self, number: int) -> float: ...

    def reconnect(self) -> None: ...


class LockInGate:
    """The laser behind an auxiliary output.

    Parameters
    ----------
    lock_in : object
        A lock-in whose driver has `set_output`, which returns the voltage read back.
    settings : LaserSettings
        Which output, and the voltage that lets light out.
    """

    def __init__(self, lock_in: _HasOutputs, settings: LaserSettings) -> None:
        self._lock_in = lock_in
        self._settings = settings

    def identity(self) -> str:
        """Return which output of which lock-in it is."""
        return f"output {self._settings.output} of {self._lock_in.identity()}"

    def on(self) -> None:
        """Let light out, if the interlock is closed."""
        self.check()
        self._lock_in.set_output(self._settings.output, self._settings.on_voltage)

    def off(self) -> None:
        """Let no light out, and read back that it is so."""
        left = self._lock_in.set_output(self._settings.output, 0.0)
        if abs(left) > _OFF:
            raise InstrumentError(
                f"output {self._settings.output} of the lock-in stands at {left:g} V "
                "and not at 0 V: the laser may be on; switch it off by hand"
            )

    def check(self) -> None:
        """Raise if the interlock is open."""
        own = self._settings
        if own.interlock_input is None:
            return
        voltage = self._lock_in.input(own.interlock_input)
        if not voltage >= own.interlock_voltage:
            raise InstrumentError(
                f"the interlock of the laser is open: input {own.interlock_input} of "
                f"the lock-in stands at {voltage:g} V, closed it has at least "
                f"{own.interlock_voltage:g} V; see who opened it, and close it"
            )

    def make_safe(self) -> None:
        """Let no light out, over a new link if the old one is lost."""
        try:
            self.off()
        except InstrumentError:
            self._lock_in.reconnect()
            self.off()

    def close(self) -> None:
        """Do nothing: the link is the lock-in's."""
