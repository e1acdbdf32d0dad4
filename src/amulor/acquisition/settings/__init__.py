"""The devices file: devices and procedure of a scan in TOML."""

from amulor.acquisition.settings.devices_file import (
    MountSettings,
    Procedure,
    ScannerSettings,
    Settings,
    ShutterSettings,
    SimulationSettings,
    TargetSettings,
)
from amulor.acquisition.settings.parts import (
    DigitiserSettings,
    LaserSettings,
    LockInSettings,
    NavigationSettings,
    SourceSettings,
)

__all__ = [
    "DigitiserSettings",
    "LaserSettings",
    "LockInSettings",
    "MountSettings",
    "NavigationSettings",
    "Procedure",
    "ScannerSettings",
    "Settings",
    "ShutterSettings",
    "SimulationSettings",
    "SourceSettings",
    "TargetSettings",
]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
