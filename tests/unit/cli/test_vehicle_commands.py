"""Commands on vehicles and other inputs: summaries of tracks, lines and records."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import io
from amulor.cli import main, patch_test, trajectory, watch
from amulor.platform import Trajectory

pytestmark = pytest.mark.usefixtures("next_commands")

INPUTS = ("a.nc", "b.nc", "a.npz", "s.toml", "t.csv", "u.csv", "m.toml")

Named: Any = SimpleNamespace


def track(**changes: Any) -> Trajectory:
    """Return a track to the east at 0.5 m/s, which turns by 2 degrees a second."""
    time = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    fields: dict[str, Any] = {
        "time": time,
        "position": np.stack([0.5 * time, 0 * time, 0 * time], axis=1),
        "heading": np.radians(2.0) * time,
    }
    return Trajectory.of_angles(**(fields | changes))


def test_a_track_is_summed_up_by_speed_and_turn() -> None:
    """The interval is the median one."""
    found = trajectory._summary(track())
    assert found["poses"] == 5
    assert found["duration_s"] == pytest.approx(5.0)
    assert found["interval_s"] == pytest.approx(1.0)
    assert found["largest_speed_m_s"] == pytest.approx(0.5, rel=1e-3)
    assert found["largest_turn_rate_deg_s"] == pytest.approx(2.0, rel=1e-3)
    assert (found["gaps_s"], found["crs"], found["remarks"]) == ([], "", [])
    assert found["crs_offset_m"] == [0.0, 0.0, 0.0]
    assert found["position_uncertainty_m"] is None
    assert found["attitude_uncertainty_deg"] is None


def test_poses_in_gaps_are_no_part_of_a_summary() -> None:
    """Middles of intervals up to the longest gap are looked at."""
    whole = track()
    places: list[Any] = []
    shown: Any = Named(
        time=whole.time, longest_gap=1.5, at=lambda time: places.append(time.tolist())
    )
    trajectory._middle(shown)
    shown.longest_gap = 1.0
    trajectory._middle(shown)
    assert places == [[0.5, 1.5, 4.5]] * 2


def test_a_track_has_median_errors_of_coordinates_and_axes(monkeypatch) -> None:
    """Standard errors of 1, 2, 3 mm, and of 0.1, 0.2, 0.3 degrees."""
    position, attitude = np.array([1.0, 2.0, 3.0]) * 1e-3, np.radians([0.1, 0.2, 0.3])
    errors = np.diag(np.concatenate([position, attitude]) ** 2)
    poses = Named(covariance=np.stack([errors, errors]))
    monkeypatch.setattr(trajectory, "_middle", lambda track: poses)
    nothing: Any = None
    assert trajectory._uncertainties(nothing) == pytest.approx((2e-3, 0.2))
    poses.covariance[1, 4, 4] = np.nan
    assert trajectory._uncertainties(nothing) == (pytest.approx(2e-3), None)
    poses.covariance = np.zeros((0, 6, 6))
    assert trajectory._uncertainties(nothing) == (None, None)


@pytest.fixture
def imported(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the words with which a log is read and written."""
    calls: list[Any] = []
    monkeypatch.setattr(
        trajectory, "_read", lambda *words: calls.append(words) or track()
    )
    monkeypatch.setattr(
        "amulor.io.trajectories.write_trajectory",
        lambda track, path, overwrite: calls.append((path, overwrite)),
    )
    monkeypatch.setattr(
        "amulor.view.trajectory.write_figure",
        lambda path, track, overwrite: calls.append((path, overwrite)),
    )
    monkeypatch.setattr(trajectory, "print_next", lambda c: print(f"next: {c}"))
    return calls


IMPORT = ["import", "trajectory", "t.csv", "-o", "o.csv"]


def test_a_log_is_converted_and_drawn(imported, printed, monkeypatch) -> None:
    """Errors are printed if both are known."""
    assert main([*IMPORT, "--columns", "m.toml"]) == 0
    lines = [
        "o.csv, o.png: 5 poses over 5.0 s",
        "every 1 s (median), speed up to 0.5 m/s, turn rate up to 2 deg/s",
    ]
    end = (
        "next: amulor export image.nc --trajectory o.csv --mounting rov.toml -o "
        "cloud.laz"
    )
    assert printed() == [*lines, end]
    assert imported == [
        (Path("t.csv"), Path("m.toml"), None, None, None, None),
        (Path("o.png"), False), (Path("o.csv"), False),
    ]  # fmt: skip
    monkeypatch.setattr(trajectory, "_uncertainties", lambda track: (2e-3, 0.25))
    assert main([*IMPORT, "--overwrite"]) == 0
    assert printed()[2] == (
        "standard uncertainty, median between poses: 2 mm a coordinate, 0.25 deg an "
        "axis"
    )
    assert imported[-1] == (Path("o.csv"), True)
    monkeypatch.setattr(trajectory, "_uncertainties", lambda track: (2e-3, None))
    assert main([*IMPORT, "--json"]) == 0
    content = json.loads("".join(printed()))
    assert (content["file"], content["figure"]) == ("o.csv", "o.png")
    assert content["poses"] == 5


@pytest.mark.parametrize("name", ["o.csv", "o.png"])
@pytest.mark.usefixtures("imported")
def test_a_track_and_its_figure_are_kept(inputs, capsys, name) -> None:
    """Neither is replaced unasked."""
    (inputs / name).touch()
    assert main(IMPORT) == 1
    assert f"{name} exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "kind"),
    [("a.NMEA", "nmea"), ("a.nma", "nmea"), ("a.log", "nmea"), ("a.XTF", "xtf")],
)
def test_logs_are_read_in_a_reference_system(monkeypatch, name: str, kind: str) -> None:
    """Offset and uncertainties are stated as three quantities."""
    for place, function in (
        ("amulor.io.navigation_logs", "trajectory_from_nmea"),
        ("amulor.io.xtf_log", "trajectory_from_xtf"),
    ):
        monkeypatch.setattr(
            f"{place}.{function}",
            lambda file, *, kind=function[-4:], **more: (kind.strip("_"), file, more),
        )
    read: Any = trajectory._read
    path = Path(name)
    found = read(path, None, "EPSG:1", None, None, None)
    assert found == (kind.rjust(4, "_").strip("_"), path, {"crs": "EPSG:1"})
    stated = "1km,2m,0m", "2cm,0.2deg,0.1deg"
    more = read(path, None, "EPSG:1", *stated, None)[2]
    assert more == {
        "crs": "EPSG:1", "crs_offset": (1000.0, 2.0, 0.0),
        "uncertainty": pytest.approx((0.02, np.radians(0.2), np.radians(0.1))),
    }  # fmt: skip


def test_bags_and_tables_are_read_by_their_endings(monkeypatch) -> None:
    """A bag may have topics, a table needs its columns."""
    monkeypatch.setattr(
        "amulor.io.navigation_logs.trajectory_from_bag", lambda file, topic: topic
    )
    tables = "amulor.io.trajectories"
    monkeypatch.setattr(
        f"{tables}.trajectory_from_table", lambda file, map: (file, map)
    )
    monkeypatch.setattr(f"{tables}.TrajectoryMap.from_toml", lambda path: f"map {path}")
    read: Any = trajectory._read
    assert read(Path("a.MCAP"), None, None, None, None, "/pose") == "/pose"
    found = read(Path("a.h5"), Path("m.toml"), None, None, None, None)
    assert found == (Path("a.h5"), "map m.toml")


def patched(**changes: Any) -> Any:
    """Return the result of a patch test with eight quantities."""
    fields: dict[str, Any] = {
        "mounting": Named(model_dump=lambda mode, exclude_none: {"pitch": 0.5}),
        "change": np.array([1e-3, -2e-3, 0.0, np.radians(0.5), 0, 0, 2e-3, 3e-6]),
        "uncertainty": np.array([1e-4, 2e-4, 0.0, np.radians(0.1), 0, 0, 1e-4, 1e-6]),
        "start_uncertainty": np.array(
            [5e-3, 5e-3, 5e-3, *np.radians([1.0, 1.0, 1.0]), 1e-2, 1e-5]
        ),
        "covariance": np.eye(8), "undetermined": (), "points": 123, "misfit": 1.25,
        "position_walk": 2.5e-3, "attitude_walk": np.radians(0.05),
    }  # fmt: skip
    return Named(**(fields | changes))


def test_a_patch_test_prints_quantities_in_their_units(printed) -> None:
    """Quantities that are not estimated have an empty change."""
    from amulor.imaging.patch_test import QUANTITIES

    patch_test._print_quantities(patched())
    lines = printed()
    assert lines[:2] == ["Mounting", "change uncertainty before"]
    units = ["mm"] * 3 + ["deg"] * 3 + ["ms", "ppm"]
    values = ["1 0.1 5", "-2 0.2 5", "not estimated 5", "0.5 0.1 1",
              "not estimated 1", "not estimated 1", "2 0.1 10", "3 1 10"]  # fmt: skip
    assert lines[2:] == [
        f"{name} [{unit}] {text}"
        for name, unit, text in zip(QUANTITIES, units, values, strict=True)
    ]


def test_a_patch_test_advises_a_line(printed) -> None:
    """A quantity that no line shows is measured directly."""
    from amulor.imaging.patch_test import QUANTITIES

    entry = {"uncertainty": 4e-3, "start_uncertainty": 5e-3, "with_line": 1e-3}
    first = Named(quantity=QUANTITIES[1], line="a line across", **entry)
    last = Named(quantity=QUANTITIES[6], line="", **entry)
    texts = patch_test._advice(patched(undetermined=(first, last)))
    assert texts == [
        f"{QUANTITIES[1]}: not determined by these lines (4 mm, before 5 mm); add a "
        "line across (1 mm)",
        f"{QUANTITIES[6]}: not determined by these lines (4 ms, before 5 ms); no "
        "further line helps much; measure it directly",
    ]


PLATFORM = ["calibrate", "platform", "a.nc", "b.nc", "--trajectory", "t.csv", "-o"]


@pytest.fixture
def lines_of(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the inputs of a comparison of lines, and the files of its result."""
    calls: list[Any] = []

    def compare(images: Any, **more: Any) -> Any:
        calls.append((images, more))
        return patched()

    monkeypatch.setattr(io, "read_cube", lambda path: f"image {path}")
    monkeypatch.setattr("amulor.imaging.patch_test", compare)
    monkeypatch.setattr(
        "amulor.io.trajectories.read_trajectory", lambda path: f"track {path}"
    )
    monkeypatch.setattr("amulor.platform.read_mounting", lambda path: f"on {path}")
    monkeypatch.setattr(
        "amulor.platform.mounting.mounting_text", lambda mounting: "[mounting]\n"
    )
    monkeypatch.setattr(
        "amulor.view.patch_test.write_patch_test",
        lambda path, result, overwrite: path.write_text("plot"),
    )
    monkeypatch.setattr(patch_test, "_print_quantities", lambda result: None)
    return calls


def test_a_mounting_is_written_with_the_digests_of_its_inputs(
    lines_of, printed
) -> None:
    """The start values are an input, too."""
    from amulor import cube as cubes

    assert main([*PLATFORM, "c.toml", "--mounting", "m.toml"]) == 0
    assert printed() == [
        "c.toml, c.png: 123 points of 2 lines, scatter 1.25 times the stated noise",
        "errors of the trajectory in one second: 2.5 mm, 0.05 deg",
        "next: amulor export scan.nc --trajectory t.csv --mounting c.toml -o cloud.laz",
    ]
    assert lines_of == [
        (["image a.nc", "image b.nc"],
         {"trajectories": ["track t.csv"], "mounting": "on m.toml"}),
    ]  # fmt: skip
    names = ("a.nc", "b.nc", "t.csv", "m.toml")
    digests = [f"#   {name} {cubes.digest(Path(name))}" for name in names]
    assert Path("c.toml").read_text().splitlines() == [
        "# By amulor calibrate platform, from:", *digests, "[mounting]"
    ]  # fmt: skip
    again = [*PLATFORM, "c.toml", "--trajectory", "u.csv"]
    assert main(again) == 1
    assert main([*again, "--overwrite", "--json"]) == 0
    content = json.loads("".join(printed()))
    assert (content["output"], content["plot"]) == ("c.toml", "c.png")
    assert (content["points"], content["mounting"]) == (123, {"pitch": 0.5})
    assert content["change"][:2] == [1e-3, -2e-3]
    assert lines_of[-1][1] == {
        "trajectories": ["track t.csv", "track u.csv"], "mounting": None
    }  # fmt: skip


def test_a_mounting_needs_lines_tracks_and_a_file(inputs, capsys) -> None:
    """Without lines the steps are printed."""
    assert main(["calibrate", "platform"]) == 0
    assert capsys.readouterr().out.startswith("Overlapping lines show lever arm")
    for words, message in (
        (["a.nc", "-o", "c.toml"], "--trajectory is missing: the poses of the vehicle"),
        (["a.nc", "--trajectory", "t.csv"], "--output is missing; state it, such as"),
    ):
        assert main(["calibrate", "platform", *words]) == 2
        assert message in capsys.readouterr().err


class Live:
    """Running scan that ends after some looks."""

    def __init__(self, *states: dict[str, Any]) -> None:
        self.states, self.looks, self.stopped = list(states), 0, False
        self.polarizations = ("VV", "VH")

    @property
    def status(self) -> dict[str, Any]:
        return self.states[min(self.looks, len(self.states) - 1)]

    def look(self) -> None:
        self.looks += 1

    def stop(self) -> None:
        self.stopped = True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the time, which goes on by half a second with each pause."""
    now = [100.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(watch.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(watch.time, "sleep", sleep)
    place = "amulor.view.terminal"
    monkeypatch.setattr(f"{place}.signal_to_noise", lambda live, channel: channel)
    monkeypatch.setattr(
        f"{place}.going", lambda status, ratio, now: f"{status['n']} {ratio}"
    )
    return now


def words_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Return the printed lines without the time of day."""
    return [line.partition(" ")[2] for line in capsys.readouterr().out.splitlines()]


def test_a_running_scan_has_a_line_at_intervals(clock, capsys) -> None:
    """Each advice is printed once, and at once; the end is printed, too."""
    running = [{"state": "running", "n": n} for n in range(5)]
    running[2]["advice"] = ["slower"]
    running[3] |= {"advice": ["slower"], "error": "lost"}
    live: Any = Live(*running, {"state": "finished", "n": 5, "error": "lost"},
                     {"state": "finished", "n": 6})  # fmt: skip
    watch._in_lines(live, "VH", 1.0, once=False)
    # Lines after one second: 0 and 2; 3 has an error; 5 and the end.
    assert words_of(capsys) == [
        "0 VH", "2 VH", "note: slower", "3 VH", "note: lost", "5 VH", "6 VH"
    ]  # fmt: skip
    assert clock[0] == 103.0


def test_a_state_is_shown_once(clock, capsys) -> None:
    """The scan goes on, and the command ends."""
    live: Any = Live({"state": "running", "n": 7, "advice": ["a", "b"]})
    watch._in_lines(live, "VV", 10.0, once=True)
    assert words_of(capsys) == ["7 VV", "note: a", "note: b"]
    assert (live.looks, clock[0]) == (0, 100.0)


def test_a_scan_that_is_watched_has_the_channel(
    clock, monkeypatch, capsys, here
) -> None:
    """The first channel by default; an interrupt ends the display alone."""
    made: list[Any] = []

    def opened(folder: Path) -> Live:
        made.append(Live({"state": "finished", "n": 1}))
        return made[-1]

    monkeypatch.setattr("amulor.view.page.Live", opened)
    assert main(["watch", "scan"]) == 0
    assert main(["watch", "scan", "--polarization", "vh"]) == 0
    assert words_of(capsys) == ["1 VV", "1 VH"]
    assert [(live.looks, live.stopped) for live in made] == [(1, True)] * 2
    assert main(["watch", "scan", "--polarization", "hh"]) == 2
    message = "--polarization: the scan has no channel 'HH', only VV, VH"
    assert message in capsys.readouterr().err
    monkeypatch.setattr(watch, "_in_lines", _interrupt)
    assert main(["watch", "scan"]) == 0
    assert made[-1].stopped


def _interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


SIMULATE = ["simulate", "s.toml", "-o", "o.nc"]


@pytest.fixture
def simulated(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the surveys that are simulated, with their options."""
    calls: dict[str, Any] = {"reason": "", "tracks": [], "rows": []}
    described = Named(
        platform=None, targets=[1], instrument=Named(modulation_frequencies=(1.0,))
    )
    calls["survey"] = described

    def by_rows(survey: Any, output: Path, **more: Any) -> Any:
        calls["rows"].append((output, more))
        return Named(sizes={"row": 9}, hit=0.5, saturated=0.125)

    monkeypatch.setattr("amulor.survey.Survey.from_toml", lambda path: described)
    monkeypatch.setattr("amulor.scale.simulated.simulate_file", by_rows)
    monkeypatch.setattr("amulor.survey.directions.samples_of", lambda survey: 100)
    monkeypatch.setattr(
        "amulor.survey.reach.unsettled_interval",
        lambda survey, modulation_frequency: calls["reason"],
    )
    monkeypatch.setattr(
        "amulor.simulation.measured_trajectory", lambda survey, rng: f"track {rng}"
    )
    monkeypatch.setattr(
        "amulor.io.trajectories.write_trajectory",
        lambda track, path, overwrite: calls["tracks"].append((track, path)),
    )
    return calls


def test_a_simulation_by_rows_states_shares(simulated, printed) -> None:
    """A survey without targets has none; ambiguous ranges are noted."""
    words = ["--tile-rows", "3", "--seed", "7", "--overwrite", "--model", "closure"]
    assert main([*SIMULATE, *words]) == 0
    end = "next: amulor reject o.nc --method auto -o target.nc"
    share = (
        "50.0% of the beams meet a target, 12.5% of the samples overload the detector"
    )
    assert printed() == ["o.nc: row 9", share, end]
    ((output, more),) = simulated["rows"]
    assert output == Path("o.nc")
    assert type(more.pop("model")).__name__ == "ClosureModel"
    assert more == {"rng": 7, "rows": 3, "overwrite": True}
    simulated["reason"] = "far"
    assert main([*SIMULATE, "--tile-rows", "1"]) == 0
    note = "note: far; amulor image will need --nearest and --farthest"
    assert printed() == ["o.nc: row 9", share, note, end]
    simulated["survey"].targets = []
    assert main([*SIMULATE, "--tile-rows", "1"]) == 0
    assert printed() == ["o.nc: row 9", end]


def test_a_simulated_vehicle_has_a_trajectory(
    simulated, printed, inputs, capsys
) -> None:
    """It has the noise of the seed, and an existing one is kept."""
    simulated["survey"].platform = "vehicle"
    assert main([*SIMULATE, "--tile-rows", "1", "--seed", "5"]) == 0
    assert printed()[1] == (
        "o.trajectory.csv: trajectory, for amulor export --trajectory"
    )
    assert simulated["tracks"] == [("track 5", Path("o.trajectory.csv"))]
    (inputs / "o.trajectory.csv").touch()
    assert main([*SIMULATE, "--tile-rows", "1"]) == 1
    assert "o.trajectory.csv exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "name", "settings"),
    [
        ([], "SmallAngleModel", {}),
        (["--model", "diffusion"], "DiffusionModel", {}),
        (["--model", "photons", "--error", "2 %", "--seed", "3"], "PhotonModel",
         {"relative_error": 0.02, "seed": 3}),
        (["--model", "photons"], "PhotonModel", {"relative_error": 0.005, "seed": 1}),
    ],
)  # fmt: skip
def test_a_simulation_has_the_model_that_is_named(
    simulated, words: list[str], name: str, settings: dict[str, Any]
) -> None:
    """Photons stop at a relative error of half a percent by default."""
    assert main([*SIMULATE, *words, "--tile-rows", "1"]) == 0
    model = simulated["rows"][0][1]["model"]
    assert type(model).__name__ == name
    assert {key: getattr(model, key) for key in settings} == pytest.approx(settings)


def test_records_are_imported_with_gate_and_side(inputs, monkeypatch, printed) -> None:
    """An overlap of echoes above 3 % is noted."""
    asked: list[Any] = []
    overlap = [0.03]
    monkeypatch.setattr(
        "amulor.io.transients.read_transients",
        lambda file, frequencies, **more: (
            asked.append((file, frequencies, more)) or xr.Dataset(sizes_of())
        ),
    )
    monkeypatch.setattr(
        "amulor.io.transients.medium_from_minimum",
        lambda file, frequencies: Named(attrs={"echo_overlap": [0.01, overlap[0]]}),
    )
    monkeypatch.setattr("amulor.cube.attach", lambda cube, shots, name: cube)
    monkeypatch.setattr(io, "write_cube", lambda *_, **__: None)
    words = ["import", "transients", "a.npz", "-o", "o.nc", "--frequency", "50MHz"]
    assert main(words) == 0
    lines = [
        "o.nc: 2 x 3 pixels at 4 frequencies",
        "next: amulor reject o.nc --method auto -o target.nc",
    ]
    assert printed() == lines
    more = ["--scan-side", "60 cm", "--repetition", "10 MHz", "--gate", "1ns,4ns"]
    assert main([*words, *more, "--scene", "2", "--medium"]) == 0
    assert printed() == lines
    overlap[0] = 0.05
    assert main([*words, "--medium"]) == 0
    note = printed()[1]
    assert note.startswith("note: the echoes of the scenes overlap in time; 5% of the")
    nothing = dict.fromkeys(
        ("scene", "scan_side", "repetition_frequency", "gate"), None
    )
    stated = {
        "scene": 2, "scan_side": 0.6, "repetition_frequency": 1e7,
        "gate": pytest.approx((1e-9, 4e-9)),
    }  # fmt: skip
    assert asked == [
        (Path("a.npz"), [5e7], settings) for settings in (nothing, stated, nothing)
    ]


def sizes_of() -> dict[str, Any]:
    """Return a variable with 2 rows, 3 columns and 4 frequencies."""
    dims = ("row", "column", "modulation_frequency")
    return {"x": (dims, np.zeros((2, 3, 4)))}


def test_arrivals_are_summed_up_by_share_and_error(
    inputs, monkeypatch, printed
) -> None:
    """Without a usable pixel there is no error."""
    asked: list[Any] = []
    ranges = np.array([[1.0, np.nan], [2.0, 3.0]])
    image = xr.Dataset(
        {
            "slant_range": (("row", "column"), ranges),
            "slant_range_uncertainty": (("row", "column"), 1e-3 * ranges),
        },
        attrs={"side_lobe": 0.0456},
    )
    monkeypatch.setattr(
        io, "read_arrivals", lambda file, **more: asked.append(more) or image
    )
    monkeypatch.setattr(io, "write_cube", lambda *_, **__: None)
    words = ["import", "arrivals", "a.npz", "-o", "o.nc", "--group-index", "1.34"]
    assert main(words) == 0
    start = "o.nc: range image, 75.0% of the pixels usable"
    assert printed() == [
        f"{start}, median uncertainty 2.00 mm, largest side lobe 0.046",
        "next: amulor view o.nc",
    ]
    image["slant_range"].values[:] = np.nan
    more = ["--scan-side", "60 cm", "--repetition", "10 MHz", "--gate", "1ns,4ns"]
    assert main([*words, *more, "--scene", "2", "--neighbors", "1"]) == 0
    assert printed()[0] == (
        "o.nc: range image, 0.0% of the pixels usable, largest side lobe 0.046"
    )
    nothing = dict.fromkeys(
        ("scene", "scan_side", "repetition_frequency", "gate"), None
    )
    assert asked[0] == nothing | {"neighbors": 0, "group_index": 1.34}
    assert asked[1] == {
        "scene": 2, "scan_side": 0.6, "repetition_frequency": 1e7, "neighbors": 1,
        "gate": pytest.approx((1e-9, 4e-9)), "group_index": 1.34,
    }  # fmt: skip
    assert main([*words, "--neighbors=-1"]) == 2
