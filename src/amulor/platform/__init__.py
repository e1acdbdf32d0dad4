"""Platform of the instrument: its trajectory, and the pose of every reading."""

from amulor._attitude import rotation_of
from amulor.platform.messages import pose_line
from amulor.platform.mounting import read_mounting
from amulor.platform.poses import (
    InstrumentPoses,
    instrument_poses,
    mean_instrument_poses,
)
from amulor.platform.trajectory import Poses, Trajectory
from amulor.survey.platform import Mounting

__all__ = [
    "InstrumentPoses",
    "Mounting",
    "Poses",
    "Trajectory",
    "instrument_poses",
    "mean_instrument_poses",
    "pose_line",
    "read_mounting",
    "rotation_of",
]


def __dir__() -> list[str]:
    """Return the public names of the package only."""
    return sorted(__all__)
