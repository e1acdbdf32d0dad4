"""The devices of a scan together: who they are, and how all of them are made safe."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from amulor import cube
from amulor.acquisition.clock import Clock
from amulor.acquisition.protocols import (
    SIMULATOR,
    Device,
    Laser,
    LockIn,
    RotationMount,
    Scanner,
    Source,
    TargetStage,
)
from amulor.acquisition.settings import Settings

#: Settings that change no sample.
_NO_PART_OF_IT = (
    "address", "baud_rate", "flow_control", "clock_speed", "attempts", "patience",
    "darkness_patience", "lock",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Devices:
    """All devices of a scan, connected."""

    laser: Laser
    """What lets light out."""
    lock_in: LockIn
    """What measures."""
    scanner: Scanner
    """What turns the beam."""
    launch: RotationMount | None
    """What sets the launched polarization, None if nothing turns."""
    analyser: RotationMount | None
    """What sets the analysed polarization, None if nothing turns."""
    target: TargetStage
    """What takes the target out of the beam."""
    clock: Clock
    """What the devices go by."""
    source: Source | None = None
    """What modulates the laser, None if the lock-in does."""
    release: Callable[[], None] = lambda: None
    """Lets other scans have the devices, once they are closed."""

    def all(self) -> Iterator[tuple[str, Device]]:
        """Yield name and device; the laser first, since it is made safe first."""
        for name in (
            "laser",
            "source",
            "scanner",
            "target",
            "launch",
            "analyser",
            "lock_in",
        ):
            device = getattr(self, name)
            if device is not None:
                yield name, device

    def identities(self) -> dict[str, str]:
        """Return what each device says it is."""
        return {name: device.identity() for name, device in self.all()}

    def make_safe(self) -> list[str]:
        """Make every device safe, whatever the others do."""
        wrong = []
        for name, device in self.all():
            try:
                device.make_safe()
            except Exception as error:  # the next device must be reached in any case
                wrong.append(
                    f"{name} could not be made safe, see to it by hand: {error}"
                )
        return wrong

    def close(self) -> None:
        """Let go of every device."""
        for _, device in self.all():
            with contextlib.suppress(Exception):
                device.close()
        self.release()


def digest(settings: Settings, identities: dict[str, str]) -> str:
    """Return what changes when the instrument or the procedure is another one."""
    # What says nothing does not count: a later amulor knows more settings.
    content = settings.model_dump(
        mode="json", exclude={"simulation": True}, exclude_none=True
    )
    for own in content.values():
        for name in [*own]:
            if name in _NO_PART_OF_IT or name.endswith("timeout"):
                del own[name]
    return cube.digest(json.dumps([content, identities], sort_keys=True))


def is_simulated(identities: dict[str, str]) -> bool:
    """Return whether any device says that it is simulated."""
    return any(SIMULATOR in identity for identity in identities.values())
