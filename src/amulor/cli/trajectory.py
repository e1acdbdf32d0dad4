"""`amulor import trajectory`: import of a vehicle's trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from amulor.cli._arguments import UsageError, check_ending, check_inputs, quantity_of
from amulor.cli._output import print_json, print_next

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from amulor.platform import Poses, Trajectory

_BAG, _NMEA, _XTF = (".mcap",), (".nmea", ".nma", ".log"), (".xtf",)


def trajectory(
    file: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    columns: Path | None = None,
    crs: str | None = None,
    crs_offset: str | None = None,
    uncertainty: str | None = None,
    topic: str | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Convert the navigation log of a vehicle to a trajectory, and draw it.

    Parameters
    ----------
    file
        Log: a table (CSV or HDF5), NMEA 0183 sentences (.nmea, .nma, .log), a sonar
        file (.xtf), or a ROS 2 bag (.mcap).
    output
        File to write (CSV). A figure of the same name ends in .png.
    columns
        Column map (TOML) of a table, which assigns columns to quantities.
    crs
        Projected reference system for positions of NMEA or XTF, such as EPSG:32632.
    crs_offset
        Offset of the local frame in the reference system: east, north and up, such as
        "563km,4883km,0m". It is subtracted from positions of NMEA or XTF.
    uncertainty
        Standard uncertainties where NMEA or XTF state none: of each coordinate, of the
        heading, and of pitch and roll, such as "2cm,0.2deg,0.05deg".
    topic
        Topic of the poses in a bag, if several topics have poses.
    json
        Print the summary as JSON.
    overwrite
        Replace existing files.
    """
    check_inputs(file, columns)

    from amulor import io
    from amulor.io.trajectories import write_trajectory
    from amulor.view.trajectory import write_figure

    check_ending("--output", output, [".csv"])
    picture = output.with_suffix(".png")
    inputs = [path for path in (file, columns) if path is not None]
    for path in (output, picture):
        io.check_output(path, overwrite=overwrite, inputs=inputs)
    track = _read(file, columns, crs, crs_offset, uncertainty, topic)
    write_figure(picture, track, overwrite=overwrite)
    write_trajectory(track, output, overwrite=overwrite)
    summary = _summary(track)
    if json:
        print_json({"file": str(output), "figure": str(picture), **summary})
        return
    print(f"{output}, {picture}: {summary['poses']} poses over {track.duration:.1f} s")
    print(
        f"  every {summary['interval_s']:.3g} s (median), speed up to "
        f"{summary['largest_speed_m_s']:.2g} m/s, turn rate up to "
        f"{summary['largest_turn_rate_deg_s']:.2g} deg/s"
    )
    position, attitude = _uncertainties(track)
    if position is not None and attitude is not None:
        print(
            f"  standard uncertainty, median between poses: {1e3 * position:.3g} mm a "
            f"coordinate, {attitude:.2g} deg an axis"
        )
    for remark in track.remarks:
        print(f"  {remark}")
    print_next(
        f"amulor export image.nc --trajectory {output} --mounting rov.toml -o cloud.laz"
    )


def _read(
    file: Path,
    columns: Path | None,
    crs: str | None,
    crs_offset: str | None,
    uncertainty: str | None,
    topic: str | None,
) -> Trajectory:
    """Read a log in the format of its ending; raise for options of other formats."""
    from amulor.io import navigation_logs, xtf_log
    from amulor.io.trajectories import TrajectoryMap, trajectory_from_table

    ending = file.suffix.lower()
    logs = (*_NMEA, *_XTF)
    kind = "bag" if ending in _BAG else "log" if ending in logs else "table"
    options = {
        "--columns": (columns, "table"),
        "--crs": (crs, "log"),
        "--crs-offset": (crs_offset, "log"),
        "--uncertainty": (uncertainty, "log"),
        "--topic": (topic, "bag"),
    }
    for option, (value, wanted) in options.items():
        if value is not None and wanted != kind:
            raise UsageError(
                f"{option} belongs to a {wanted}, but {file.name} is a {kind} by its "
                "ending; leave the option out, or rename the file"
            )
    if kind == "bag":
        return navigation_logs.trajectory_from_bag(file, topic=topic)
    if kind == "log":
        if crs is None:
            raise UsageError(
                f"--crs is missing: {file.name} has geographic positions; state a "
                "projected reference system, such as --crs EPSG:32632"
            )
        read = (
            xtf_log.trajectory_from_xtf
            if ending in _XTF
            else navigation_logs.trajectory_from_nmea
        )
        stated = {}
        if crs_offset is not None:
            lengths = ("length", "length", "length")
            words = 'lengths to the east, north and up, such as "563km,4883km,0m"'
            stated["crs_offset"] = _three("--crs-offset", crs_offset, lengths, words)
        if uncertainty is not None:
            kinds = ("length", "angle", "angle")
            words = 'a length and two angles, such as "2cm,0.2deg,0.05deg"'
            stated["uncertainty"] = _three("--uncertainty", uncertainty, kinds, words)
        return read(file, crs=crs, **stated)
    if columns is None:
        raise UsageError(
            "--columns is missing: a table needs a map of its columns (TOML); the page "
            '"Survey from a vehicle" has an example'
        )
    return trajectory_from_table(file, TrajectoryMap.from_toml(columns))


def _three(
    option: str, text: str, kinds: tuple[str, str, str], words: str
) -> tuple[float, float, float]:
    """Return three quantities with commas between them."""
    parts = text.split(",")
    if len(parts) != 3:
        raise UsageError(f"{option} {text!r}: state three values, {words}")
    first, second, third = (
        quantity_of(option, part, kind) for part, kind in zip(parts, kinds, strict=True)
    )
    return first, second, third


def _middle(track: Trajectory) -> Poses:
    """Return the poses in the middle of the intervals that are interpolated."""
    middle = (track.time[1:] + track.time[:-1]) / 2
    return track.at(middle[np.diff(track.time) <= track.longest_gap])


def _uncertainties(track: Trajectory) -> tuple[float | None, float | None]:
    """Return the median uncertainty of a coordinate [m] and of an axis [deg]."""
    variances = np.einsum("nii->ni", _middle(track).covariance)
    position, attitude = (
        float(np.sqrt(np.median(part)))
        if part.size and np.isfinite(part).all()
        else None
        for part in (variances[:, :3], variances[:, 3:])
    )
    return position, None if attitude is None else float(np.degrees(attitude))


def _summary(track: Trajectory) -> dict[str, object]:
    """Return the summary of a trajectory, for text and JSON."""
    poses = _middle(track)
    position, attitude = _uncertainties(track)

    def largest(vectors: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(vectors, axis=1).max(initial=0.0))

    return {
        "poses": int(track.time.size),
        "duration_s": track.duration,
        "clock": track.clock,
        "interval_s": float(np.median(np.diff(track.time))),
        "largest_speed_m_s": largest(poses.velocity),
        "largest_turn_rate_deg_s": float(np.degrees(largest(poses.turn_rate))),
        "position_uncertainty_m": position,
        "attitude_uncertainty_deg": attitude,
        "gaps_s": track.gaps.tolist(),
        "crs": track.crs,
        "crs_offset_m": list(track.crs_offset),
        "remarks": list(track.remarks),
    }
