"""Makes the cubes of `amulor samples` anew; dated by one time, so that bytes are kept.

    python tools/make_samples.py [NAME ...] [--folder src/amulor/samples/data]

`amphora` takes about a minute: it is a scan, sample by sample, of simulated devices.
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from collections.abc import Callable
from pathlib import Path

import xarray as xr

from amulor import Survey, acquisition, read_cube, simulate, simulation, write_cube
from amulor import cube as cubes
from amulor.cube.provenance import dated
from amulor.studies.ladder import survey_text

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "src" / "amulor" / "samples" / "data"
WHEN = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
#: Two for each octave from below the cut-off of the water to far above it.
SWEEP = [f"{frequency} MHz" for frequency in (
    5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 200, 240, 280, 320, 360,
)]  # fmt: skip


def ladder() -> xr.Dataset:
    """Return the milky case of the demo."""
    return simulate(Survey.from_text(survey_text("milk")), rng=1)


def sweep() -> xr.Dataset:
    """Return a few pixels of the same water and a plate, at many frequencies."""
    survey = Survey.from_text(survey_text("milk")).with_(
        {
            "name": "Plate in milky water, sixteen frequencies",
            "instrument.modulation_frequencies": SWEEP,
            "targets": [
                {
                    "kind": "plate",
                    "position": ["0 cm", "0 cm", "150 cm"],
                    "width": "7 cm",
                    "height": "10 cm",
                    "reflectance": 0.1,
                    "mueller": [0.61, -0.61, -0.46],
                }
            ],
            "scan.columns": 24,
            "scan.rows": 8,
            "scan.open_water.repeats": 8,
        }
    )
    return simulate(survey, rng=2)


def amphora() -> xr.Dataset:
    """Return the amphora of the examples, acquired with simulated devices."""
    survey = Survey.from_toml(ROOT / "examples" / "amphora" / "amphora.toml").with_(
        {"scan.columns": 48, "scan.rows": 82}
    )
    with tempfile.TemporaryDirectory() as folder:
        scan = Path(folder) / "scan"
        acquisition.acquire(survey, scan, scene=simulation.scene_light)
        cube = read_cube(acquisition.recover(scan))
    # As from a boat: nobody states what is looked at, and no file lies beside the cube.
    stated = survey.with_({"targets": []}).to_toml()
    old = cubes.digest(cube.attrs["survey"])
    digests = str(cube.attrs["input_digests"]).replace(old, cubes.digest(stated))
    return cube.assign_attrs(survey=stated, input_digests=digests)


CUBES: dict[str, Callable[[], xr.Dataset]] = {
    "ladder": ladder,
    "sweep": sweep,
    "amphora": amphora,
}


def main() -> None:
    """Write the cubes that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[[], *CUBES], default=[])
    parser.add_argument("--folder", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    for name in arguments.names or CUBES:
        with dated(WHEN):
            cube = CUBES[name]()
            write_cube(cube, arguments.folder / f"{name}.nc", overwrite=True)
        print(f"{name}.nc: {(arguments.folder / f'{name}.nc').stat().st_size} bytes")


if __name__ == "__main__":
    main()
