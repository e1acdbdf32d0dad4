"""The devices file: devices and procedure of a scan in TOML."""

from amulor.acquisition.settings.devices_file import (
    MountSettings,
    Procedure,
    ScannerSettings,
    Settings,
    SimulationSettings,
    TargetSettings,
)
from amulor.acquisition.settings.parts import (
    DigitiserSettings,
    LaserSettings,
    LockInSettings,
    SourceSettings,
)

__all__ = [
    "DigitiserSettings",
    "LaserSettings",
    "LockInSettings",
    "MountSettings",
    "Procedure",
    "ScannerSettings",
    "Settings",
    "SimulationSettings",
    "SourceSettings",
    "TargetSettings",
]


def __dir__() -> list[str]:
    """List the public names, not the modules that they come from."""
    return sorted(__all__)
