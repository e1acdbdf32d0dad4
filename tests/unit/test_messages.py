"""Errors name what was found and what is needed, with units.

A case is a call that goes wrong, its error, and the words that matter of its message.
Tests beside the code look at other messages.
"""

from __future__ import annotations

import math
import socket
import sys
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
import trimesh
import xarray as xr
from exact_scenes import plane

from amulor import design, imaging, io, optics, pipeline, samples
from amulor.acquisition import bluesky
from amulor.acquisition.cube import calibrate
from amulor.acquisition.cube.calibration import Calibration
from amulor.acquisition.demodulation import demodulate
from amulor.acquisition.drivers.analog import LockInOutputs
from amulor.acquisition.journal.record import Record
from amulor.acquisition.journal.rows import refuse_another, refuse_impossible
from amulor.acquisition.laser_safety import hazard
from amulor.acquisition.links.lines import DirectLink
from amulor.acquisition.plan import Key
from amulor.acquisition.settings import Settings
from amulor.acquisition.settings.parts import PanTiltSettings
from amulor.cli._arguments import UsageError
from amulor.cli.site import epochs_of
from amulor.design.candidates import fits as schemes_of
from amulor.design.evaluate import scheme_of
from amulor.errors import (
    CubeError,
    FormatError,
    InstrumentError,
    MissingExtraError,
    SurveyError,
)
from amulor.handover.archive import write
from amulor.handover.page import PageProducts
from amulor.imaging.measure import fits
from amulor.imaging.measure.figures import Check
from amulor.io import drawings, laz, ply, shapes
from amulor.io.recording_table import RecordingMap, read_table
from amulor.optics.small_angle._columns import panels
from amulor.optics.water.milk import measured_milk
from amulor.scale import tasks
from amulor.simulation import scene
from amulor.site.merging import tiles
from amulor.survey import Mesh, Survey, files, scan
from amulor.survey.surface import TabulatedSurface
from amulor.survey.waters.named import SphereWater
from amulor.transport.tally import Tally
from amulor.view import figures, pdf
from amulor.view.explanations import reasons
from amulor.view.page import measuring, space
from amulor.view.page.notes import Notes

Call = Callable[[Path], object]
Case = tuple[Call, type[Exception], str]

GOAL = (Path(__file__).parents[2] / "examples/goals/paper_milk.toml").read_text("utf-8")
CALIBRATION = """[[frequencies]]
modulation_frequency = "39 MHz"
amplitudes = ["2 mV", "1 mV"]
phases = ["0.2 rad", "0.21 rad"]
"""


def _changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


def _survey(old: str, new: str) -> Call:
    return lambda folder: Survey.from_text(
        _changed((folder / "plate.toml").read_text(), old, new)
    )


def _goal(old: str, new: str) -> Call:
    return lambda _: design.Goal.from_text(_changed(GOAL, old, new))


def _settings(text: str) -> Call:
    def call(folder: Path) -> None:
        path = folder / "devices.toml"
        path.write_text(text)
        Settings.from_toml(path)

    return call


def _written(name: str, content: bytes | str, call: Call) -> Call:
    """Write a file, then call with its path."""

    def write(folder: Path) -> None:
        raw = content if isinstance(content, bytes) else content.encode()
        (folder / name).write_bytes(raw)
        call(folder / name)

    return write


def _mesh(**options: Any) -> Call:
    def call(folder: Path) -> None:
        path = folder / "bare.ply"
        path.write_bytes(trimesh.creation.box().export(file_type="ply"))
        scene.Texture(
            Mesh(
                kind="mesh",
                file=path,
                reflectance=0.1,
                position=("0 m", "0 m", "1 m"),
                **options,
            )
        )

    return call


def _image() -> xr.Dataset:
    return plane((0.0, 0.0, 1.0), 1.5)


def _npz(entries: Callable[[zipfile.ZipFile], None]) -> Call:
    def call(folder: Path) -> None:
        with zipfile.ZipFile(folder / "photons.npz", "w") as archive:
            entries(archive)
        io.read_histograms(folder / "photons.npz")

    return call


def _damaged_field(archive: zipfile.ZipFile) -> None:
    archive.writestr("counts.npy", b"\x93NUMPY\x01\x00")


def _unequal_arrays(folder: Path) -> None:
    with h5py.File(folder / "run.h5", "w") as file:
        file["x"], file["y"] = np.ones(3), np.ones(2)
    described = RecordingMap.model_validate(
        {
            "table": {"format": "hdf5"},
            "columns": {"in_phase": "x", "quadrature": "y"},
            "constants": {"frequency": "39 MHz", "polarization": "VH"},
        }
    )
    read_table(folder / "run.h5", described)


def _other_group(folder: Path) -> None:
    """Cut a dimension of a group, as another program may."""
    cube = samples.cube("ladder")
    open_water = cube.amulor.open_water.isel(polarization=slice(0, 1))
    io.write_cube(cube, folder / "whole.nc")
    raw = (folder / "whole.nc").read_bytes()
    (folder / "cut.nc").write_bytes(raw[: raw.rindex(b"\namulor ")])
    with h5py.File(folder / "cut.nc", "r+") as file:
        for name in list(file["open_water"]):
            del file[f"open_water/{name}"]
    open_water.to_netcdf(
        folder / "cut.nc", mode="a", group="open_water", engine="h5netcdf"
    )
    io.read_cube(folder / "cut.nc")


def _record(**changes: Any) -> None:
    good = {
        "in_phase": 0.1, "quadrature": 0.2, "mean": None, "readings": 1,
        "full_scale": 1.0, "flags": 0,
    }  # fmt: skip
    key = Key("scan", 1, 2, 39e6, "VH", 0)
    fields = dict.fromkeys(Record.__dataclass_fields__)
    refuse_impossible(key, Record(**{**fields, **good, **changes}))


def _closed_link(_: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = DirectLink(f"tcp://127.0.0.1:{server.getsockname()[1]}", timeout=1)
        link.close()
        link.ask("*IDN?")


def _slow_modulation(folder: Path) -> None:
    text = (folder / "plate.toml").read_text().replace('"39 MHz"', '"100 kHz"')
    hazard(
        Survey.from_text(text), beam_diameter=2e-3, divergence=1e-3, laser_class="3B"
    )


def _fine_contours(_: Path) -> None:
    raster = SimpleNamespace(height=np.array([[0.0, 1.0]]))
    imaging.products.contours(raster, interval=1e-6)


def _site(*epochs: str) -> Any:
    return SimpleNamespace(epoch=[SimpleNamespace(name=name) for name in epochs])


def _raw_twice(folder: Path) -> None:
    (folder / "raw").mkdir()
    (folder / "a.nc").write_bytes(b"1")
    twice = SimpleNamespace(name="left", raw=[folder / "a.nc", folder / "a.nc"])
    write._copy_raw(twice, folder)


def _changed_notes(folder: Path) -> None:
    notes = Notes(folder / "scan.nc")
    notes.write({"revision": 7})


CASES: dict[str, Case] = {
    # Surveys.
    "a line of a table with a column too many": (
        _written("p.csv", "0 1\n1 2 3\n", lambda path: files.columns(
            path, count=2, where="water.phase_function")),
        SurveyError,
        r"water.phase_function: .*p.csv, line 2: found '1 2 3'; "
        "needed is a text of 2 columns of numbers",
    ),
    "frequencies that fall": (
        _survey('["39 MHz"]', '["39 MHz", "20 MHz"]'),
        SurveyError,
        "must increase and hold each one once; found 39 MHz, 20 MHz",
    ),
    "a count beyond all counts": (
        _survey("columns = 12", "columns = 10000000000000000000"),
        SurveyError,
        r"scan.columns: found 1e\+19; nothing is counted so far",
    ),
    "a channel without texture": (
        lambda folder: Mesh(
            kind="mesh", file=folder / "a.ply", reflectance=0.1, texture_channel="red",
            position=("0 m", "0 m", "1 m"),
        ),
        ValueError,
        "texture_channel is 'red', but texture is missing: state texture = "
        '"vertex-colours" or "image"',
    ),
    "a mesh without colors": (
        _mesh(texture="vertex-colours"),
        SurveyError,
        "bare.ply: has no colors of vertices; export them, or leave out texture",
    ),
    "a mesh without image": (
        _mesh(texture="image"),
        SurveyError,
        "bare.ply: has no image with coordinates .* export them, or leave out texture",
    ),
    "spheres by two numbers": (
        lambda _: SphereWater(kind="spheres", diameter="1 um", particle_index=1.2),
        ValueError,
        "spheres need a volume_fraction or a scattering, not both",
    ),
    "angles of a surface that fall": (
        lambda _: TabulatedSurface(
            kind="tabulated",
            incidence=("30 deg", "0 deg"),
            reflection=("0 deg", "30 deg"),
            azimuth=("0 deg",),
            values=(0.1, 0.1, 0.1, 0.1),
        ),
        ValueError,
        "angles of a tabulated surface must rise; found 30, 0 deg",
    ),
    # Goals.
    "an interval that ends before it begins": (
        _goal('"0 m"\nfarthest = "1.56 m"', '"2 m"\nfarthest = "1.5 m"'),
        SurveyError,
        r"farthest \(1.5 m\) must lie beyond nearest \(2 m\)",
    ),
    "a grid from high to low": (
        _goal(
            'sets = [["36.8 MHz"], ["39 MHz"], ["138 MHz"]]',
            'lowest = "50 MHz"\nhighest = "20 MHz"',
        ),
        SurveyError,
        r"highest \(2e\+07 Hz\) must lie above lowest \(5e\+07 Hz\)",
    ),
    "a set that falls": (
        _goal('[["36.8 MHz"],', '[["39 MHz", "36.8 MHz"],'),
        SurveyError,
        "frequencies must increase and hold each one once; found 39 MHz, 36.8 MHz",
    ),
    "values that fall": (
        _goal('values = ["7 cm"]', 'values = ["7 cm", "5 cm"]'),
        SurveyError,
        "values must increase; found 0.07, 0.05",
    ),
    "a price too many": (
        _goal('values = ["7 cm"]', 'values = ["7 cm"]\nprices = [1, 2]'),
        SurveyError,
        "1 values need as many prices, found 2",
    ),
    "two lasers of one name": (
        _goal(
            '[[components.lasers]]\nname = "diode 405 nm"',
            '[[components.lasers]]\nname = "diode 405 nm"\nwavelength = "405 nm"\n'
            'powers = ["1 W"]\n[[components.lasers]]\nname = "diode 405 nm"',
        ),
        SurveyError,
        "two lasers are called 'diode 405 nm'",
    ),
    "no scheme that a method takes": (
        lambda _: list(schemes_of(design.Goal.from_text(_changed(
            GOAL, 'methods = ["none", "open-water"]', 'methods = ["polarization"]')))),
        SurveyError,
        r'no polarization scheme fits a method; .* need a pair such as "VV\+VH"',
    ),
    "a state that is none": (
        lambda _: scheme_of("VV+XX"),
        SurveyError,
        "polarization: .*'?X",
    ),
    "frequency and frequencies": (
        lambda _: design.evaluate(
            design.Goal.from_text(GOAL), frequencies=[[39e6]], frequency=[39e6]),
        SurveyError,
        "state frequency, or frequencies, not both",
    ),
    "a set of no frequency": (
        lambda _: design.evaluate(design.Goal.from_text(GOAL), frequencies=[[]]),
        SurveyError,
        "frequencies: each set needs one frequency at least",
    ),
    # Files.
    "a cloud of an unknown ending": (
        lambda folder: io.write_cloud(xr.Dataset(), folder / "a.obj"),
        FormatError,
        r"a\.obj.*\.ply",
    ),
    "parts of a cloud of an unknown ending": (
        lambda folder: io.write_cloud_parts(
            lambda: iter(()), 0, folder / "a.obj", shape=(1, 1)),
        FormatError,
        r"a\.obj.*\.ply",
    ),
    "a device": (
        lambda _: io.read_cube("/dev/null"),
        FormatError,
        "/dev/null is a device or a pipe; name a regular file",
    ),
    "a file that exists": (
        _written("a.nc", "", lambda path: io.write_cube(
            samples.cube("ladder"), path)),
        FormatError,
        "a.nc exists already; choose another name, or replace it with --overwrite",
    ),
    "a classic netCDF": (
        _written("a.nc", b"CDF\x01", io.read_cube),
        FormatError,
        "a.nc is a netCDF-3 file, needed is netCDF-4; .* nccopy -k netCDF-4",
    ),
    "complex numbers": (
        lambda folder: io.write_cube(
            samples.cube("ladder").assign(user_echo=("row", np.full(40, 1j))),
            folder / "a.nc"),
        CubeError,
        "'user_echo' holds complex128, which a netCDF file cannot; store real numbers",
    ),
    "a group of another size": (
        _other_group,
        FormatError,
        "group 'open_water' has ['1].*polarization.*make the file again",
    ),
    "a histogram that is cut": (
        _npz(_damaged_field),
        FormatError,
        "field 'counts' is damaged; copy the file again, or make it again",
    ),
    "an entry that the directory lost": (
        lambda folder: _written("a.npz", b"PK\5\6" + bytes(6) + b"\1" + bytes(11),
                                io.read_histograms)(folder),
        FormatError,
        "is not an npz file, or is damaged",
    ),
    "arrays of unequal length": (
        _unequal_arrays,
        FormatError,
        "run.h5: arrays differ in length, or are empty: x: 3, y: 2",
    ),
    "corners that are no triangles": (
        lambda folder: io.write_ply(
            imaging.point_cloud(_image()), folder / "a.ply", faces=np.zeros((2, 4))),
        ValueError,
        r"faces must have the shape \(m, 3\), got \(2, 4\)",
    ),
    "a mesh without triangles": (
        _written("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", partial(
            shapes.read_mesh, unit=1.0)),
        FormatError,
        "a.obj (holds no triangle|cannot be read as a mesh)",
    ),
    "an attribute that readers take as theirs": (
        lambda folder: io.write_cube(
            samples.cube("ladder").assign_attrs(_FillValue=1.0), folder / "a.nc"
        ),
        CubeError,
        "attribute '_FillValue' of the cube would change how a reader takes",
    ),
    "values of a cloud that are too many": (
        lambda folder: io.write_ply(
            imaging.point_cloud(_image()),
            folder / "a.ply",
            scalars={"depth": (np.ones(2), "m")},
        ),
        ValueError,
        r"scalars must have \d+ values each, as many as points; depth has 2",
    ),
    # Cubes and images.
    "a tile of no row": (
        lambda _: next(pipeline.run_step(lambda cube: cube, samples.cube("ladder"),
                                         rows=0)),
        ValueError,
        "a tile has 1 row at least, got 0",
    ),
    "a covariance of too many pixels": (
        lambda _: imaging.correlation.covariance(
            plane((0.0, 0.0, 1.0), 1.5, rows=80, columns=80), np.ones((80, 80), bool)),
        CubeError,
        r"\d{4} pixels are too many for a covariance matrix, at most \d+ fit; take a "
        "smaller region",
    ),
    "a check outside of the image": (
        lambda _: imaging.measure.compared(_image(), Check(
            name="bar", first=(0, 0), second=(5000, 0), expected="40 mm")),
        CubeError,
        "check 'bar': .*5000",
    ),
    "a channel that is not stated": (
        lambda _: imaging.observation.channel_of(samples.cube("ladder"), None),
        CubeError,
        "the cube has the channels VV, VH; choose one with polarization",
    ),
    "contours beyond counting": (
        _fine_contours,
        CubeError,
        r"1000001 contour levels are too many, at most \d+; take an interval above "
        r"[\d.]+ mm",
    ),
    "a section between equal points": (
        lambda _: imaging.products.section(
            SimpleNamespace(), SimpleNamespace(), start=(0.1, 0.2), end=(0.1, 0.2)),
        CubeError,
        "the line of the section has no length; give two points apart",
    ),
    # Optics, rejection.
    "a milk that was not measured": (
        lambda _: measured_milk(450e-9, kind="goat"),
        ValueError,
        "kind must be \"skim\" or \"whole\", got 'goat'",
    ),
    "a sweep that rises": (
        lambda _: optics.low_pass.fit_of_power([1e6, 2e6, 4e6], [1.0, 2.0, 3.0]),
        ValueError,
        r"between 1e\+06 and 4e\+06 Hz do not show where they fall to 1/sqrt\(2\)",
    ),
    "an overlap that never settles": (
        lambda _: panels(
            lambda depth: np.where(np.random.default_rng(0).random(
                depth.shape) > 0.5, 1.0, 0.0),
            lambda depth: np.ones_like(depth),
            loss=0.1, length=1.0, step=0.1, end=2.0, partial_sum=0.0),
        ArithmeticError,
        r"the water column does not settle about [\d.]+ m; receiver_radius or "
        "acceptance_angle may be far too small",
    ),
    # Acquisition.
    "amplitudes that fall": (
        lambda _: Calibration.from_text(CALIBRATION),
        FormatError,
        "amplitudes must increase; found 2 mV, 1 mV",
    ),
    "a calibration from no plate": (
        lambda _: calibrate.from_plates([], distance=1.5),
        CubeError,
        "no cube was given; record the plate first",
    ),
    "a calibration from two temperatures": (
        lambda _: calibrate.from_temperatures([samples.cube("ladder")] * 2),
        CubeError,
        "2 cubes; at least 3 are needed, at different temperatures",
    ),
    "a record that is too short": (
        lambda _: demodulate(np.zeros(11), sample_rate=1e6, frequencies=[1e5]),
        ValueError,
        r"1 frequencies need a record of at least 12 samples, got an array of shape "
        r"\(11,\)",
    ),
    "a lock-in without outputs": (
        lambda _: LockInOutputs(SimpleNamespace(identity=lambda: "SR000")),
        InstrumentError,
        "SR000 has no outputs to turn mirrors by; choose other scanner.analog.outputs",
    ),
    "an infinite reading": (
        lambda _: _record(in_phase=math.inf),
        FormatError,
        "sample .*39000000.*: in_phase is infinite; look at what the instrument",
    ),
    "a reading that is no number": (
        lambda _: _record(quadrature=math.nan),
        FormatError,
        "quadrature is not a number; look at what the instrument answers",
    ),
    "a journal of another version": (
        lambda path: refuse_another(path, path / "j", {"journal_schema": "0"}, {}),
        FormatError,
        "the journal has schema '0', this amulor knows '.+'; use the amulor that began",
    ),
    "a slow modulation": (
        _slow_modulation,
        ValueError,
        r"a modulation of 100000 Hz is so slow .* take the rules for pulses",
    ),
    "a link that is closed": (
        _closed_link,
        InstrumentError,
        r"the link to tcp://127.0.0.1:\d+ is closed; open it again",
    ),
    "settling where nothing settles": (
        _settings(
            '[procedure]\nmode = "continuous"\noutput_filter = "known"\n'
            'readings = "buffer"\nsettled_by = "samples"\n'
        ),
        InstrumentError,
        "settled_by is 'samples', but with mode = \"continuous\" nothing settles",
    ),
    "a pan that ends before it begins": (
        lambda _: PanTiltSettings(lowest_pan="20 deg", highest_pan="-20 deg"),
        ValueError,
        r"lowest_pan \(20 deg\) must be less than highest_pan \(-20 deg\)",
    ),
    "a half of a range of tilts": (
        lambda _: PanTiltSettings(lowest_tilt="-20 deg"),
        ValueError,
        "both or none of scanner.pan_tilt.lowest_tilt and highest_tilt is needed; "
        "state it",
    ),
    # Sites and archives.
    "an archive that exists": (
        lambda folder: write.write_archive(SimpleNamespace(), folder),
        FormatError,
        "exists already; choose another name",
    ),
    "a file that went away": (
        lambda folder: tasks.Record(folder).identity(folder / "none.nc"),
        FormatError,
        "none.nc",
    ),
    "one of two epochs": (
        lambda _: epochs_of(_site("spring", "autumn"), "spring", None),
        UsageError,
        "--first and --second must be given together",
    ),
    "a comparison of one epoch": (
        lambda _: epochs_of(_site("spring"), None, None),
        UsageError,
        "the site has one epoch, 'spring'; a comparison needs two",
    ),
    "two raw files of one name": (
        _raw_twice,
        SurveyError,
        "scan left: two raw files are called a.nc; rename one",
    ),
    "a surface that lacks a combination": (
        _written("brdf.csv", "0 0 0 0.1\n0 30 0 0.1\n30 0 0 0.1\n", lambda path: (
            TabulatedSurface(kind="tabulated", file="brdf.csv").settled(
                path.parent, where="targets.0.surface"))),
        SurveyError,
        "targets.0.surface.file: brdf.csv must hold every combination of its 2 "
        "incidences, 2 reflections and 1 azimuths once",
    ),
    # Pages and pictures.
    "points on a line for a circle": (
        lambda _: fits._round(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])),
        CubeError,
        "the pixels lie too straight for a round shape; take more",
    ),
    "a product without interval": (
        lambda _: PageProducts()._order("contours", {}, _image(), None),
        CubeError,
        "contour lines need an interval, from 0.00001 to 10 m; none is stated",
    ),
    "numbers that a cloud lacks": (
        lambda _: space.Space.values(
            SimpleNamespace(name="a.ply", scalars={}), "salinity"),
        CubeError,
        "a.ply has no numbers 'salinity'",
    ),
    "a part of light that was not followed": (
        lambda _: Tally.part(SimpleNamespace(parts=("water", "target")), "air"),
        ValueError,
        "the parts are 'water', 'target'; got 'air'",
    ),
    "flags of a picture": (
        lambda _: reasons(Path("a.ply"), 0, 0),
        FormatError,
        r"a\.ply has no flags",
    ),
    "a picture of an unknown kind": (
        lambda path: figures.write_response_curves(path / "a.jpg", np.ones(1), {}),
        FormatError,
        r"a.jpg: pictures are written as .png or .svg; rename it",
    ),
    "a PDF file without trailer": (
        lambda _: pdf._archival(b"%PDF-1.4\nstartxref\n9\n%%EOF\n", {}),
        FormatError,
        "matplotlib wrote a PDF file without a plain trailer",
    ),
    "a PDF file without catalog": (
        lambda _: pdf._archival(
            b"trailer\n<< /Root 1 0 R /Info 2 0 R /Size 3 >>\nstartxref\n9\n", {}),
        FormatError,
        "matplotlib wrote a PDF file without a catalog",
    ),
    "an axis of no length": (
        lambda _: measuring._axis((0, 0, 0)),
        CubeError,
        "an axis of 0, 0, 0 has no direction; needed is a length above 0",
    ),
    "notes of another window": (
        _changed_notes,
        CubeError,
        "these notes were changed in another window; reload the page",
    ),
    "notes that are none": (
        lambda folder: Notes(folder / "scan.nc").write({"revision": "many"}),
        CubeError,
        "notes: revision: .*integer",
    ),
    "a mesh without unit": (
        _written("a.stl", "", partial(space.opened, unit=None)),
        FormatError,
        "a.stl.*unit",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_message_names_what_was_found_and_what_is_needed(
    case: str, tmp_path: Path, plate_text: str
) -> None:
    call, kind, words = CASES[case]
    (tmp_path / "plate.toml").write_text(plate_text)
    with pytest.raises(kind, match=words) as caught:
        call(tmp_path)
    assert kind is ValueError or "\n" not in str(caught.value)


#: Modules that may be missing, what needs them, and the extra that installs them.
MISSING: dict[str, tuple[str, Call, str]] = {
    "pyproj": ("pyproj", lambda _: scan._pyproj(), "export"),
    "ezdxf": ("ezdxf", lambda _: drawings._ezdxf(), "export"),
    "tifffile": ("tifffile", lambda _: drawings._tifffile(), "export"),
    "laspy": ("laspy", lambda _: laz._laspy("reading"), "export"),
    "tiles": ("laspy", lambda _: tiles._laspy(), "export"),
    "ply": ("trimesh.exchange", lambda path: ply.read_ply(path, unit=1.0), "scene"),
    "mesh": ("trimesh", lambda path: shapes.read_mesh(path, unit=1.0), "scene"),
    "bluesky": (
        "bluesky.plan_stubs",
        lambda _: next(bluesky.scan(None, None)),
        "bluesky",
    ),
}


@pytest.mark.parametrize("case", MISSING)
def test_a_missing_package_is_named_with_its_extra(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, call, extra = MISSING[case]
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"pip install .*amulor\[{extra}\]"):
        call(tmp_path)
