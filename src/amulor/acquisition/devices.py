"""All devices of a scan: identities, safe state and release."""

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
    Navigation,
    RotationMount,
    Scanner,
    Shutter,
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
    """Connected devices of a scan."""

    laser: Laser
    """Laser."""
    lock_in: LockIn
    """Lock-in amplifier."""
    scanner: Scanner
    """Scanner, which turns the beam."""
    launch: RotationMount | None
    """Mount of the launched polarization; None without a motor."""
    analyser: RotationMount | None
    """Mount of the analyzed polarization; None without a motor."""
    target: TargetStage | None
    """Target stage; None without open-water shots."""
    clock: Clock
    """Clock of the devices."""
    source: Source | None = None
    """Generator that modulates the laser; None if the lock-in modulates it."""
    shutter: Shutter | None = None
    """Shutter in front of the detector; None without one."""
    navigation: Navigation | None = None
    """Source of the poses of the vehicle; None without one."""
    release: Callable[[], None] = lambda: None
    """Function that unlocks the devices for other scans, once they are closed."""

    def all(self) -> Iterator[tuple[str, Device]]:
        """Yield name and device, the laser first, so that it is made safe first."""
        for name in (
            "laser",
            "source",
            "scanner",
            "target",
            "launch",
            "analyser",
            "shutter",
            "lock_in",
            "navigation",
        ):
            device = getattr(self, name)
            if device is not None:
                yield name, device

    def identities(self) -> dict[str, str]:
        """Return the identity of each device."""
        return {name: device.identity() for name, device in self.all()}

    def make_safe(self) -> list[str]:
        """Make every device safe, even if some fail; return the failures."""
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
        """Close every device."""
        for _, device in self.all():
            with contextlib.suppress(Exception):
                device.close()
        self.release()


def digest(settings: Settings, identities: dict[str, str]) -> str:
    """Return a hash of procedure, devices and identities, to compare two runs."""
    # Omitted settings are not compared, because later versions of amulor add settings.
    content = settings.model_dump(
        mode="json", exclude={"simulation": True}, exclude_none=True
    )
    for part in content.values():
        for name in [*part]:
            if name in _NO_PART_OF_IT or name.endswith("timeout"):
                del part[name]
    return cube.digest(json.dumps([content, identities], sort_keys=True))


def is_simulated(identities: dict[str, str]) -> bool:
    """Return whether any of the devices is a simulator."""
    return any(SIMULATOR in identity for identity in identities.values())
