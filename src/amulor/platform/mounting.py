"""Mounting of an instrument on its vehicle: files, and the covariance of its errors."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from amulor.errors import SurveyError
from amulor.survey import toml_file
from amulor.survey.platform import Mounting
from amulor.survey.quantity import Description


class _MountingFile(Description):
    """Content of a file with a mounting and nothing else."""

    mounting: Mounting
    """Mounting of the instrument."""


def deviations(mounting: Mounting) -> NDArray[np.float64]:
    """Return the eight standard uncertainties of a mounting, NaN where unknown.

    Lever arm (right, down, forward) [m], boresight (right, down, forward) [rad], clock
    offset [s], clock drift [1].
    """
    arm = mounting.lever_arm_uncertainties or (mounting.lever_arm_uncertainty,) * 3
    bend = mounting.boresight_uncertainties or (mounting.boresight_uncertainty,) * 3
    clock = (mounting.clock_uncertainty, mounting.clock_drift_uncertainty)
    return np.array([*arm, *bend, *clock], dtype=float)


def error_factors(mounting: Mounting) -> NDArray[np.float64]:
    """Return independent errors of a mounting, shape (error, 8), see `deviations`.

    A row has the change of the eight quantities by one standard uncertainty of one
    error; unknown uncertainties count as 0.
    """
    sigma = np.nan_to_num(deviations(mounting))
    if mounting.correlation is None:
        return np.diag(sigma)
    values, vectors = np.linalg.eigh(np.array(mounting.correlation))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T * sigma)


def changed(mounting: Mounting, step: NDArray[np.float64]) -> Mounting:
    """Return a mounting after changes of its eight quantities, see `deviations`."""
    turn = Rotation.from_rotvec(mounting.boresight) * Rotation.from_rotvec(step[3:6])
    return mounting.model_copy(
        update={
            "lever_arm": tuple(mounting.lever_arm + step[:3]),
            "boresight": tuple(turn.as_rotvec()),
            "clock_offset": mounting.clock_offset + float(step[6]),
            "clock_drift": mounting.clock_drift + float(step[7]),
        }
    )


def with_covariance(mounting: Mounting, covariance: NDArray[np.float64]) -> Mounting:
    """Return a mounting with its uncertainties and their correlation."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = np.round(covariance / scale[:, None] / scale, 9)
    correlation = (correlation + correlation.T) / 2
    np.fill_diagonal(correlation, 1.0)
    return mounting.model_copy(
        update={
            "lever_arm_uncertainty": None,
            "lever_arm_uncertainties": tuple(sigma[:3]),
            "boresight_uncertainty": None,
            "boresight_uncertainties": tuple(sigma[3:6]),
            "clock_uncertainty": float(sigma[6]),
            "clock_drift_uncertainty": float(sigma[7]),
            "correlation": tuple(map(tuple, correlation)),
        }
    )


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


def mounting_text(mounting: Mounting) -> str:
    """Return a mounting as TOML text that `read_mounting` reads.

    Values are rounded to a thousandth of their uncertainties.
    """
    sigma = deviations(mounting)
    fields = {
        "lever_arm": sigma[:3],
        "boresight": sigma[3:6],
        "clock_offset": sigma[6],
        "clock_drift": sigma[7],
        "lever_arm_uncertainties": sigma[:3],
        "boresight_uncertainties": sigma[3:6],
        "clock_uncertainty": sigma[6],
        "clock_drift_uncertainty": sigma[7],
    }
    update = {
        name: _rounded(getattr(mounting, name), spread)
        for name, spread in fields.items()
        if getattr(mounting, name) is not None
    }
    if mounting.correlation is not None:
        update["correlation"] = tuple(
            tuple(round(value, 6) for value in row) for row in mounting.correlation
        )
    content = mounting.model_copy(update=update).model_dump(
        mode="json", exclude_defaults=True
    )
    lines = []
    for name, value in content.items():
        if name == "correlation":
            rows = "".join(f"    {json.dumps(row)},\n" for row in value)
            lines.append(f"{name} = [\n{rows}]")
        else:
            lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(["[mounting]", *lines, ""])


def _rounded(value: Any, spread: Any) -> Any:
    """Return numbers rounded to a thousandth of their uncertainties."""
    if isinstance(value, tuple):
        return tuple(map(_rounded, value, spread))
    if not spread > 0:
        return value
    return round(value, 3 - math.floor(math.log10(spread)))
