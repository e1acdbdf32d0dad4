"""Readers of the program, each with real files to be damaged and what must hold."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import trimesh
import xarray as xr
from exact_scenes import plane
from fuzzing import Reader
from mutations import BYTES, TEXT, e57, glb, hdf5, las, npy_header, npz
from project_files import project_text
from shared_light import scene_light

from amulor import acquisition, imaging, io
from amulor.acquisition import Calibration
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.settings import Settings
from amulor.handover import references
from amulor.handover.archive import read_project
from amulor.imaging.measure import read_checks
from amulor.io.recording_table import RecordingMap
from amulor.io.recordings import read_recordings
from amulor.simulation import scene, simulate
from amulor.site import Site
from amulor.survey import Mesh, Survey, read_pose
from amulor.view.page import space

EXAMPLES = Path(__file__).parents[2] / "examples"

SITE = """name = "Two looks"
[[epoch]]
name = "spring"
date = 2026-04-02
[[scan]]
name = "left"
file = "left.nc"
epoch = "spring"
[scan.start]
position = ["0 m", "0 m", "1 m"]
heading = "90 deg"
position_uncertainty = "5 cm"
heading_uncertainty = "2 deg"
level_uncertainty = "1 deg"
[[scan]]
name = "right"
file = "right.nc"
epoch = "spring"
start = "unknown"
[[target]]
kind = "sphere"
name = "A"
radius = "50 mm"
radius_uncertainty = "0.1 mm"
places = [{scan = "left", row = 4, column = 5}, {scan = "right", row = 6, column = 7}]
[[control]]
target = "A"
position = ["0 m", "0 m", "0 m"]
uncertainty = "2 mm"
"""
DEVICES = """[lock_in]
driver = "sr844"
address = "GPIB0::8::INSTR"
mean_output_input = 1
[scanner]
driver = "pi_gcs"
address = "tcp://10.0.0.5:50000"
angle_per_unit = "2 deg"
[launch]
driver = "none"
[analyser]
driver = "pi_gcs"
address = "tcp://10.0.0.5:50000"
axis = "3"
angles = { V = "1.5 deg", H = "91.5 deg" }
[laser]
driver = "lock_in_output"
warm_up = "2 s"
[target]
driver = "operator"
[procedure]
references = 5
settling = 6.0
"""
CALIBRATION = """[[frequencies]]
modulation_frequency = "39 MHz"
amplitudes = ["1 mV", "2 mV"]
phases = ["0.2 rad", "0.21 rad"]
"""
CHECKS = """[[checks]]
name = "bar"
first = [2, 10]
second = [2, 20]
expected = "40 mm"
expected_uncertainty = "0.1 mm"
tolerance = "1 mm"
"""
POSE = """[pose]
position = ["10 m", "20 m", "-5 m"]
heading = "90 deg"
crs = "EPSG:32632"
position_uncertainty = "5 cm"
"""
MAP = """[table]
format = "csv"
delimiter = ","
skip = 0
[columns]
in_phase = "x"
quadrature = "y"
azimuth = "az"
elevation = "el"
frequency = "f"
polarization = "pol"
what = "what"
"""
PROJECT = project_text(
    {"scan1": ("left.nc", '["right.nc"]', 'position = ["10 m", "20 m", "-5 m"]')},
    rms_error="1.5 mm",
)


def _numbers(value: Any) -> Iterator[float]:
    """Yield all numbers of a description."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


def _sound(described: Any, case: str) -> None:
    """Hold that no number of a description is infinite or beyond all measure."""
    described = described if isinstance(described, tuple) else (described,)
    for one in described:
        for number in _numbers(one.model_dump(mode="python")):
            assert math.isfinite(number), (case, number)
            assert abs(number) <= 1e30, (case, number)


def _sound_survey(survey: Survey, case: str) -> None:
    """Hold that a survey says the same when it is written and read again."""
    _sound(survey, case)
    assert Survey.from_text(survey.to_toml()) == survey, case
    for number in (
        survey.instrument.power,
        survey.water.model_dump().get("absorption"),
    ):
        assert number is None or 0 <= number <= 1000, (case, number)


def _sound_cube(cube: xr.Dataset, case: str) -> None:
    """Hold that samples are voltages, with errors above zero."""
    for name, variable in cube.data_vars.items():
        values = variable.values
        if values.dtype.kind != "f" or not str(name).startswith(("in_ph", "quadr")):
            continue
        there = values[~np.isnan(values)]
        assert np.all(np.abs(there) <= 1e15), (case, name)
        if str(name).endswith("_uncertainty"):
            assert np.all(there > 0), (case, name)


def _sound_points(shown: Any, case: str) -> None:
    """Hold that what is drawn has places, and triangles between them."""
    position = shown.position if shown.faces is None else shown.position[shown.faces]
    assert np.all(np.isfinite(position)), case
    assert np.all(np.isfinite(shown.centre)), case
    assert np.all(np.abs(shown.centre) <= 1e9), case


def _sound_triangles(found: Any, case: str) -> None:
    """Hold that triangles are finite and have an area."""
    corners = found if isinstance(found, np.ndarray) else found[0][found[1]]
    assert np.all(np.isfinite(corners)), case
    assert len(corners), case


def texts(folder: Path, plate_text: str) -> dict[str, Reader]:
    """Return the readers of descriptions; the files that those name are in the folder.

    Parameters
    ----------
    folder : pathlib.Path
        Where they will be written.
    plate_text : str
        A survey.

    Returns
    -------
    dict of str to Reader
        By what they read.
    """
    for file in (EXAMPLES / "surveys").iterdir():
        shutil.copy(file, folder)
    for name in ("left", "right"):
        io.write_cube(plane((0.0, 0.0, 1.0), 1.5), folder / f"{name}.nc")
    surveys = {
        file.name: file.read_bytes() for file in (EXAMPLES / "surveys").glob("*.toml")
    }
    layers = folder / "two_layers.toml"

    def of_table(path: Path) -> Survey:
        return Survey.from_toml(layers if path.name != "brdf.csv" else brdf)

    brdf = folder / "own.toml"
    brdf.write_text(
        plate_text.replace(
            "reflectance = 0.1",
            'reflectance = 0.1\nsurface = {kind = "tabulated", file = "brdf.csv"}',
        )
    )
    tables = {
        name: (EXAMPLES / "surveys" / name).read_bytes()
        for name in ("brdf.csv", "phase_function.csv")
    }
    plain: dict[str, tuple[Callable[[Path], Any], str]] = {
        "site": (Site.from_toml, SITE),
        "devices": (Settings.from_toml, DEVICES),
        "calibration": (Calibration.from_toml, CALIBRATION),
        "checks": (read_checks, CHECKS),
        "pose": (read_pose, POSE),
        "map": (RecordingMap.from_toml, MAP),
        "project": (read_project, PROJECT),
    }
    return {
        "survey": Reader(
            read=Survey.from_toml,
            files={**surveys, "plate.toml": plate_text.encode()},
            mutations=TEXT,
            judge=_sound_survey,
        ),
        "table": Reader(read=of_table, files=tables, mutations=TEXT, judge=_sound),
        **{
            name: Reader(
                read=read,
                files={f"{name}.toml": text.encode()},
                mutations=TEXT,
                judge=lambda result, case: (
                    _sound(result, case) if hasattr(result, "model_dump") else None
                ),
            )
            for name, (read, text) in plain.items()
        },
    }


def arrays(folder: Path, plate: Survey) -> dict[str, Reader]:
    """Return the readers of cubes, histograms and recordings.

    Parameters
    ----------
    folder : pathlib.Path
        Where they will be written.
    plate : Survey
        What is recorded.

    Returns
    -------
    dict of str to Reader
        By what they read.
    """
    survey = plate.with_(
        {"scan.columns": 4, "scan.rows": 3,
         "scan.open_water": {"columns": 2, "rows": 2, "repeats": 2}}
    )  # fmt: skip
    cube = simulate(survey, rng=4)
    io.write_cube(cube, folder / "samples.nc")
    image = plane((0.0, 0.0, 1.0), 1.5)
    io.write_cube(image, folder / "image.nc")
    files = {name: (folder / name).read_bytes() for name in ("samples.nc", "image.nc")}
    whole = {"samples.nc": io.read_cube(folder / "samples.nc"),
             "image.nc": io.read_cube(folder / "image.nc")}  # fmt: skip

    def unchanged(found: xr.Dataset, name: str, content: bytes) -> None:
        # What is accepted of a file with a digest is what was written.
        xr.testing.assert_identical(found, whole[name])

    counts = np.random.default_rng(1).poisson(30, (2, 2, 3, 40))
    np.savez(folder / "scenes.npz", counts=counts, bin_width_s=1e-10)
    np.savez_compressed(
        folder / "slabs.npz", counts=counts[0, 0], bin_width_s=1e-10,
        thickness_inch=[1.0, 2.0, 3.0], direct_counts=counts[0, 0, 0],
    )  # fmt: skip
    names = ("scenes.npz", "slabs.npz")
    histograms = {name: (folder / name).read_bytes() for name in names}

    def transients(path: Path) -> xr.Dataset:
        several = path.name == "scenes.npz"
        return io.read_transients(path, [1e8, 2e8], scene=1 if several else None)

    clean = {name: transients(folder / name) for name in names}

    def same_light(found: xr.Dataset, name: str, content: bytes) -> None:
        # A zip file has checksums: other counts are never read.
        np.testing.assert_array_equal(found["in_phase"], clean[name]["in_phase"])

    return {
        "cube": Reader(read=io.read_cube, files=files, mutations=(hdf5,),
                       judge=_sound_cube),
        "cube bytes": Reader(read=io.read_cube, files=files, mutations=BYTES,
                             whole=unchanged),
        "transients": Reader(read=transients, files=histograms,
                             mutations=(npz, npz, npy_header), judge=_sound_cube),
        "transients bytes": Reader(read=transients, files=histograms, mutations=BYTES,
                                   whole=same_light),
        "recording": _recording(folder, survey, cube),
    }  # fmt: skip


def _recording(folder: Path, survey: Survey, cube: xr.Dataset) -> Reader:
    """Return the reader of recordings, as text and as HDF5."""
    columns = ("x", "y", "az", "el", "f", "pol", "what")
    rows: list[tuple[Any, ...]] = []
    for what, part in (("scan", cube), ("open_water", cube.amulor.open_water)):
        at = [
            np.degrees(part[name].values).ravel() for name in ("azimuth", "elevation")
        ]
        for f, frequency in enumerate(cube["modulation_frequency"].values):
            for p, pair in enumerate(cube["polarization"].values):
                x, y = (part[name].values[f, p].ravel()
                        for name in ("in_phase", "quadrature"))  # fmt: skip
                rows += [(*one, frequency, str(pair), what)
                         for one in zip(x, y, *at, strict=True)]  # fmt: skip
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    (folder / "own_map.toml").write_text(MAP)
    as_hdf5 = MAP.replace('"csv"', '"hdf5"')
    (folder / "own_map_h5.toml").write_text(as_hdf5)
    with h5py.File(folder / "record.h5", "w") as file:
        for name, values in zip(columns, zip(*rows, strict=True), strict=True):
            text = isinstance(values[0], str)
            file[name] = np.array(values, dtype="S10" if text else float)
    text_map, array_map = (
        RecordingMap.from_toml(folder / f"{name}.toml")
        for name in ("own_map", "own_map_h5")
    )

    def read(path: Path) -> xr.Dataset:
        described = text_map if path.suffix == ".csv" else array_map
        return read_recordings(path, described, survey)

    return Reader(
        read=read,
        files={
            "record.csv": "\n".join(lines).encode(),
            "record.h5": (folder / "record.h5").read_bytes(),
        },
        mutations=(hdf5, *TEXT),
        judge=_sound_cube,
    )


def shapes(folder: Path) -> dict[str, Reader]:
    """Return the readers of meshes and clouds.

    Parameters
    ----------
    folder : pathlib.Path
        Where they will be written.

    Returns
    -------
    dict of str to Reader
        By what they read.
    """
    box = trimesh.creation.box((0.2, 0.1, 0.04))
    meshes: dict[str, bytes] = {}
    for name in ("box.stl", "box.ply", "box.obj", "box.glb"):
        box.export(folder / name)
        meshes[name] = (folder / name).read_bytes()
    for file in ("tile.ply", "tile.glb"):
        meshes[file] = (EXAMPLES / "surveys" / file).read_bytes()
    cloud = imaging.point_cloud(plane((0.0, 0.0, 1.0), 1.5))
    clouds: dict[str, bytes] = {}
    for name in ("cloud.ply", "cloud.laz", "cloud.las", "cloud.e57", "cloud.xyz"):
        io.write_cloud(cloud, folder / name)
        clouds[name] = (folder / name).read_bytes()

    def target(path: Path) -> Any:
        known = {"kind": "mesh", "file": path, "reflectance": 0.3, "unit": "m",
                 "position": (0.0, 0.0, 1.0)}  # fmt: skip
        return scene.triangles(Mesh.model_validate(known))

    def shown(path: Path) -> Any:
        own = path.suffix in (".stl", ".obj") or path.name in ("box.ply", "tile.ply")
        return space.opened(path, unit=1.0 if own else None)

    mutations = (*BYTES, glb, glb, other := TEXT[0], other, TEXT[3])
    return {
        "target mesh": Reader(read=target, files=meshes, mutations=mutations,
                              judge=_sound_triangles),
        "reference mesh": Reader(
            read=lambda path: references.read_mesh(path, unit=1.0), files=meshes,
            mutations=mutations, judge=_sound_triangles),
        "shown": Reader(read=shown, files={**meshes, **clouds}, mutations=mutations,
                        judge=_sound_points),
    }  # fmt: skip


def shown(folder: Path, form: str) -> Reader:
    """Return the reader of what is drawn, for the files of one format.

    Parameters
    ----------
    folder : pathlib.Path
        Where the files will be written.
    form : str
        How the names of its files end, such as `ply`; LAS counts as `laz`.

    Returns
    -------
    Reader
        Reader of meshes and clouds of the format.
    """
    place = folder / form
    place.mkdir()
    reader = shapes(place)["shown"]
    suffixes = (".laz", ".las") if form == "laz" else (f".{form}",)
    by_format = {"laz": las, "e57": e57}.get(form, TEXT[0])
    files = {
        name: content
        for name, content in reader.files.items()
        if name.endswith(suffixes)
    }
    return replace(reader, files=files, mutations=(*BYTES, *6 * (by_format,)))


def journals(folder: Path, plate: Survey) -> Reader:
    """Return the reader of journals, of which any bytes may be damaged.

    Parameters
    ----------
    folder : pathlib.Path
        Where the scan will be written.
    plate : Survey
        What is recorded.

    Returns
    -------
    Reader
        Reader of the journal in a folder named `scan`.
    """
    survey = plate.with_(
        {"scan.columns": 3, "scan.rows": 2, "scan.dwell": "50 ms",
         "scan.open_water": {"columns": 2, "rows": 2, "repeats": 2}}
    )  # fmt: skip
    acquisition.acquire(survey, folder / "scan", scene=scene_light)
    name = f"scan/{FILE_NAME}"

    def read(path: Path) -> None:
        with acquisition.Journal.read(path.parent) as journal:
            acquisition.build(journal)
            journal.damage()

    return Reader(read=read, files={name: (folder / name).read_bytes()},
                  mutations=BYTES)  # fmt: skip
