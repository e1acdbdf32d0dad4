"""`amulor info`: what a file of amulor holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from amulor.cli._output import print_json


def info(
    file: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Say what a file holds.

    Parameters
    ----------
    file
        Cube of any level (netCDF).
    json
        Print it for other programs.
    """
    from amulor import cube as cubes
    from amulor import io

    cube = io.read_cube(file)
    found: dict[str, Any] = {
        "file": str(file),
        "level": cube.attrs["level"],
        "title": cube.attrs.get("title", ""),
        "sizes": {str(name): size for name, size in cube.sizes.items()},
        "modulation_frequencies_hz": (
            cube["modulation_frequency"].values.tolist()
            if "modulation_frequency" in cube.coords
            else []
        ),
        "polarizations": (
            [str(value) for value in cube["polarization"].values]
            if "polarization" in cube.coords
            else []
        ),
        "simulated": bool(cube.attrs.get("simulated", 0)),
        "flags": cubes.flag_counts(cube),
        "history": str(cube.attrs.get("history", "")).splitlines(),
    }
    if json:
        print_json(found)
        return
    for name, value in found.items():
        if value not in ([], {}, ""):
            lines = value if isinstance(value, list) and name == "history" else [value]
            for line in lines:
                print(f"{name:>26}: {line}")
