"""Mounting of the instrument on a vehicle: lever arm, boresight and clock offset."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from pydantic import Field

from amulor.errors import SurveyError
from amulor.survey import toml_file
from amulor.survey.quantity import Angle, Description, Length, Position, Time


class Mounting(Description):
    """Position, attitude and clock offset of the instrument relative to its vehicle.

    Examples
    --------
    An instrument that looks straight down, 1.2 m in front of the inertial sensor:

    >>> from amulor.platform import Mounting
    >>> mounting = Mounting(
    ...     lever_arm=("0 m", "0.3 m", "1.2 m"),
    ...     pitch="-90 deg",
    ...     lever_arm_uncertainty="5 mm",
    ...     boresight_uncertainty="0.05 deg",
    ...     clock_uncertainty="1 ms",
    ... )
    >>> mounting.lever_arm
    (0.0, 0.3, 1.2)
    """

    lever_arm: Position = (0.0, 0.0, 0.0)
    """Origin of the instrument's axes (right, down, forward), from the reference point
    of the vehicle [m]."""
    heading: Annotated[Angle, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.0
    """Direction of the instrument's forward axis on a level vehicle, clockwise from the
    vehicle's forward axis [rad]."""
    pitch: Annotated[Angle, Field(ge=-math.pi / 2, le=math.pi / 2)] = 0.0
    """Elevation of the instrument's forward axis on a level vehicle [rad]."""
    roll: Annotated[Angle, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Angle of the instrument's right axis below the horizontal on a level vehicle
    [rad]."""
    clock_offset: Time = 0.0
    """Time to add to readings of the instrument's clock to obtain the clock of the
    trajectory [s]."""
    lever_arm_uncertainty: Annotated[Length, Field(ge=0, le=10)] | None = None
    """Standard uncertainty of each component of the lever arm; unknown by default
    [m]."""
    boresight_uncertainty: Annotated[Angle, Field(ge=0, le=1)] | None = None
    """Standard uncertainty of the rotation about each axis of the instrument; unknown
    by default [rad]."""
    clock_uncertainty: Annotated[Time, Field(ge=0, le=60)] | None = None
    """Standard uncertainty of the clock offset; unknown by default [s]."""


class _MountingFile(Description):
    """Content of a file with a mounting and nothing else."""

    mounting: Mounting
    """Mounting of the instrument."""


def read_mounting(path: str | Path) -> Mounting:
    r"""Read a mounting from a TOML file that has only the section [mounting].

    Parameters
    ----------
    path : str or pathlib.Path
        Mounting file (TOML).

    Returns
    -------
    Mounting
        Mounting in SI units.

    Raises
    ------
    SurveyError
        If the file is invalid; the message has one line per error.

    Examples
    --------
    >>> from pathlib import Path
    >>> from amulor.platform import read_mounting
    >>> size = Path("rov.toml").write_text(
    ...     '[mounting]\nlever_arm = ["0 m", "0 m", "1 m"]\npitch = "-90 deg"\n'
    ... )
    >>> read_mounting("rov.toml").lever_arm
    (0.0, 0.0, 1.0)
    """
    return toml_file.read(
        path, _MountingFile, what="a file with a [mounting]", error=SurveyError
    ).mounting
