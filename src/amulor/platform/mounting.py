"""Files with the mounting of an instrument on its vehicle."""

from __future__ import annotations

from pathlib import Path

from amulor.errors import SurveyError
from amulor.survey import toml_file
from amulor.survey.platform import Mounting
from amulor.survey.quantity import Description


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
