"""`amulor site register`: poses of all scans in one frame, with their covariance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from amulor.site.registration.result import Registration


def register(
    site: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Bring all scans of a site into one frame.

    Parameters
    ----------
    site
        Site file (TOML).
    output
        File to write (JSON), with poses and the covariance of all.
    json
        Print the figures as JSON.
    overwrite
        Replace a file that is there.
    """
    from amulor import io
    from amulor._extras import require
    from amulor.cli._arguments import check_ending
    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.site import Site
    from amulor.site.registration import register as room
    from amulor.site.registration.result import write_registration

    require("site", purpose="registration")
    check_ending("--output", output, (".json",))
    described = Site.from_toml(site)
    io.check_output(
        output, overwrite=overwrite, inputs=[site, *(s.file for s in described.scan)]
    )
    with progress_bar(quiet=json):
        result = room.register(described)
        write_registration(result, output, overwrite=overwrite)
    if json:
        print_json(
            {
                "poses": {
                    name: {
                        "position_m": pose.position,
                        "uncertainty": _sigmas(result, name),
                    }
                    for name, pose in result.poses.items()
                },
                "pairs": [
                    {k: v for k, v in pair.items() if k != "moved_pixels"}
                    for pair in result.pairs
                ],
                "disagreements": result.disagreements,
                "weaknesses": [vars(one) for one in result.weaknesses],
                "settled": result.settled,
            }
        )
        return
    _print(result)
    print(f"{output}: poses of {len(result.poses)} scans")
    print_next(f"amulor site merge {site} --poses {output} -o merged")


def _sigmas(result: Registration, name: str) -> list[float]:
    import numpy as np

    return [float(v) for v in np.sqrt(np.diag(result.covariance_of(f"pose {name}")))]


def _print(result: Registration) -> None:
    import numpy as np

    from amulor.cli._output import print_table

    rows = []
    for name, pose in result.poses.items():
        sigma = np.array(_sigmas(result, name))
        rows.append(
            [
                name,
                *(f"{value:.4f}" for value in pose.position),
                f"{np.linalg.norm(sigma[:3]) * 1e3:.2f}",
                f"{np.linalg.norm(sigma[3:]) * 1e3:.3f}",
            ]
        )
    header = ["scan", "east, m", "north, m", "up, m", "u, mm", "u, mrad"]
    print_table("Poses", header, rows)
    if result.fixed:
        print(f"the frame is that of {result.fixed}: nothing ties it to the world")
    for one in result.disagreements:
        first, second = one["scans"]
        print(
            f"warning: {first} on {second} contradicts all others by "
            f"{one['shift'] * 1e3:.2f} mm, {one['turn'] * 1e3:.3f} mrad (chi-square "
            f"{one['score']:.1f} per degree of freedom); it counts {one['trust']:.0%}. "
            "Look whether something moved, or the instrument did during a scan"
        )
    for weak in result.weaknesses:
        shift, turn = np.array(weak.shift), np.array(weak.turn)
        print(
            f"warning: {weak.scan}: only its start pose holds it along "
            f"({', '.join(f'{v * 1e3:.1f}' for v in shift)}) mm with a turn of "
            f"({', '.join(f'{v * 1e3:.2f}' for v in turn)}) mrad (one standard "
            "deviation); add targets, or a scan that sees relief"
        )
    if not result.settled:
        print("warning: the fit did not settle; the covariance may be too small")
