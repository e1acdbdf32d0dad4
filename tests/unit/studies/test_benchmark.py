"""The benchmark of the rejection methods: scenes, light, rows, regret, command."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cli import main
from amulor.errors import FormatError, SurveyError
from amulor.optics.polarization import mueller
from amulor.simulation import SmallAngleModel, simulate
from amulor.studies.benchmark import light, scenes, summary, table
from amulor.studies.benchmark.table import Row
from amulor.survey.mueller import matrix

SCENES = {scene.name: scene for scene in scenes.read()}


def row(scene: str, method: str, **values: object) -> Row:
    """Return a row of a valid result, with changes."""
    valid = Row(
        scene=scene,
        digest="0",
        method=method,
        trusted=1.0,
        phantoms=math.nan,
        inside_68=0.68,
        inside_95=0.95,
        worst=3.0,
        bias=0.3,
        noise=0.4,
        stated=0.5,
        seconds=1.0,
        note="",
    )
    return replace(valid, **values)  # type: ignore[arg-type]


# Scenes and their light --------------------------------------------------------------


def test_there_are_forty_scenes_and_a_quick_form() -> None:
    assert len(SCENES) >= 40
    assert 5 <= sum(scene.quick for scene in SCENES.values()) <= 10
    lengths = [s.lengths for s in SCENES.values() if not math.isnan(s.lengths)]
    assert min(lengths) < 1.01
    assert max(lengths) > 8.9


def test_weights_between_nodes_reproduce_a_parabola() -> None:
    def parabola(x: np.ndarray) -> np.ndarray:
        return 3 - 2 * x + 5 * x**2

    nodes = parabola(np.array([-0.12, 0.0, 0.10]))
    assert_allclose(nodes @ light.lagrange(light.OFFSETS), parabola(light.OFFSETS))


def test_light_agrees_with_the_small_angle_form_on_and_between_the_nodes() -> None:
    planned = SCENES["coastal-plate"].case().samples.amulor.survey
    known = {"kind": "petzold", "station": "HAOCE 11"}
    planned = planned.with_(
        {"water.asymmetry": None, "water.phase_function": known, "scan.rows": 1}
    )
    frequency = np.array(planned.instrument.modulation_frequencies)
    table_light = light.read("coastal", 2.5, highest=frequency.max())
    chosen = np.searchsorted(light.ALL, frequency)
    passed = mueller.detected_fraction(matrix(planned.targets[0].mueller), pair="VV")
    ratios = []
    for offset in (0.0, 0.03):
        moved = planned.with_({"targets.0.position": [0.0, 0.0, 2.5 + offset]})
        cube = simulate(moved, rng=1, model=SmallAngleModel())
        expected = (
            cube["truth_target_in_phase"] + 1j * cube["truth_target_quadrature"]
        ).values[:, 0, 0, 0]
        place = list(light.OFFSETS).index(offset)
        ratios.append(expected / (table_light.echo[chosen, place] * float(passed)))
    # One gain from light to volts; photons confirm the form within 3 %.
    assert_allclose(ratios / np.mean(ratios), 1, atol=0.03)
    # The noise of the photons is that of the nodes, so the step is more precise.
    assert_allclose(ratios[1] / ratios[0], 1, atol=0.01)


def test_the_echo_of_facets_is_below_that_of_clear_water_and_early() -> None:
    scene = SCENES["coastal-glossy"]
    assert scene.water is not None
    assert scene.distance is not None
    echo = light.read(scene.water, scene.distance, highest=146e6).echo
    facets = light.read_facets(scene.water, scene.distance)
    at = int(np.flatnonzero(light.OFFSETS == 0)[0])
    # Facets with the Gaussian slope of half of the angle between laser and receiver;
    # Cook and Torrance 1982, at right angles, over a Lambertian plate.
    slope = light.BASELINE / scene.distance / 2
    clear = (
        light.GLOSS / (8 * light.SLOPE**2) * np.exp(-(slope**2 / 2) / light.SLOPE**2)
    )
    ratio = abs(facets[0, at]) / abs(echo[0, at]) * light.REFLECTANCE / clear
    assert 0.9 < ratio < 1.0
    delay = np.angle(facets[1:, at] / echo[1:, at])
    assert (delay[light.ALL[1:] < 150e6] < 0).all()
    late = scene.case().late
    assert np.unique(late).size == 2
    assert np.ptp(late) > 0.3e-3


def test_water_in_front_of_a_plate_agrees_with_photon_transport() -> None:
    with np.load(light.TABLE) as table:
        for name, distance in (("coastal", 2.5), ("clear", 6.6)):
            place = light.key(name, distance)
            water = light.read(name, distance, highest=146e6).water
            photons = table[f"{place} water"][:, 1]
            offset = list(light.OFFSETS).index(0.0)
            # A quarter of the open water is behind the nearer plate.
            difference = np.abs(photons - water[:, offset]) / np.abs(photons[0])
            assert difference.max() < 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[scenes]\n", "cannot be read as scenes"),
        ("scene = 1\n", "there is no list"),
        ('[[scenes]]\nname = "a b"\ntitle = ""\n', "pattern"),
        ('[[scenes]]\nname = "a"\ntitle = ""\ntrust = "b"\n', "no scene 'b'"),
        (
            '[[scenes]]\nname = "a"\ntitle = ""\nwater = "clear"\ndistance = 1.0\n',
            "no light for water 'clear' at 1.0 m",
        ),
        (
            2 * '[[scenes]]\nname = "a"\ntitle = ""\ntrust = "flat"\n',
            "two scenes have the same name",
        ),
        (
            '[[scenes]]\nname = "a"\ntitle = ""\nwater = "coastal"\ndistance = 2.5\n'
            'instrument = "b"\n',
            "no instrument error 'b'",
        ),
    ],
)
def test_a_wrong_file_of_scenes_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "scenes.toml"
    path.write_text(text)
    with pytest.raises(SurveyError, match=message):
        scenes.read(path)


def test_two_surfaces_in_a_beam_both_count_as_right() -> None:
    case = SCENES["coastal-two-surfaces-sweep"].case()
    assert_allclose(np.unique(case.surfaces), [2.38, 2.5])
    empty = SCENES["coastal-empty"].case()
    assert np.isnan(empty.surfaces).all()


# Rows --------------------------------------------------------------------------------


@pytest.mark.slow
def test_phasor_lines_of_glossy_spots_state_that_their_light_is_less_late() -> None:
    scene = SCENES["harbour-glossy-5-lengths"]
    found = table.row_of(scene, "phasor-lines", scene.case())
    assert found.trusted > 0.5
    assert abs(found.bias) > 10.0
    assert found.inside_95 > 0.93
    assert found.worst < 3.5


def test_rows_survive_their_table() -> None:
    rows = [row("a", "x"), row("b", "y", phantoms=0.0, note='refused: "no, none"')]
    again = list(table.written(table.text(rows)))
    assert [replace(r, phantoms=0.0) for r in again] == [
        replace(r, phantoms=0.0) for r in rows
    ]
    assert math.isnan(again[0].phantoms)


def test_another_table_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "benchmark.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(FormatError, match="no table of the benchmark"):
        table.run(path, [SCENES["coastal-empty"]], ["none"])


def test_an_interrupted_table_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "benchmark.csv"
    scene = SCENES["coastal-empty"]
    computed: list[str] = []

    def done(row: Row, number: int, count: int) -> None:
        computed.append(row.method)
        assert (number, count) == (len(computed), 2)

    first = table.run(path, [scene], ["none", "co-polarized"], done=done)
    assert computed == ["none", "co-polarized"]
    content = path.read_text()
    path.write_text(content[:-20])  # interrupted in the last line
    computed.clear()
    again = table.run(
        path,
        [scene],
        ["none", "co-polarized"],
        done=lambda row, number, count: computed.append(row.method),
    )
    assert computed == ["co-polarized"]
    assert [r.method for r in again] == [r.method for r in first]
    assert [*map(csv_line, again)] == [*map(csv_line, first)]


def csv_line(row: Row) -> str:
    """Return a row without its time."""
    return table.line(replace(row, seconds=0.0))


# Regret ------------------------------------------------------------------------------


def test_regret_is_relative_to_the_best_method_with_intervals_that_hold() -> None:
    rows = [
        # 0.5 mm for auto; the best valid method has 0.4 mm.
        row("a", "auto", note="x"),
        row("a", "x"),
        row("a", "y", bias=0.0, noise=0.4),
        row("a", "narrow", bias=0.0, noise=0.01, inside_95=0.5),
        row("a", "few", bias=0.0, noise=0.01, trusted=0.6),
        row("a", "refused", trusted=0.0, inside_95=math.nan, note="refused: no"),
        # Equal to the best.
        row("b", "auto"),
        row("b", "x"),
        # Fails where another method is valid.
        row("c", "auto", trusted=0.2),
        row("c", "x"),
        row("d", "auto", inside_95=0.8),
    ]
    found = summary.regret(rows)
    assert found is not None
    assert found.worst == pytest.approx(0.25)
    assert (found.worst_scene, found.scenes) == ("a", 2)
    assert found.median == pytest.approx(0.125)
    assert found.failures == ("c",)
    assert found.too_narrow == ("d",)
    counts = {tally.method: tally for tally in summary.tallies(rows)}
    assert counts["y"].wins == 1
    assert counts["x"].wins == 2
    assert counts["narrow"].too_narrow == 1
    assert (counts["refused"].refused, counts["refused"].compared) == (1, 0)
    page = summary.page(
        rows,
        [SCENES["coastal-plate"].model_copy(update={"name": n}) for n in "abcd"],
        figure="f.svg",
    )
    assert "| `x` | 0.5 | `y` | 0.4 | 25% |" in page


def test_a_target_in_empty_water_counts_as_intervals_that_do_not_hold() -> None:
    empty = row("a", "x", trusted=math.nan, phantoms=0.01, inside_95=math.nan)
    assert not empty.holds
    assert not empty.compared
    assert summary.regret([empty]) is None


# Command -----------------------------------------------------------------------------

#: Methods of another package: one that is half right, one with an error of its own.
PLUG_IN = """
from amulor import rejection


@rejection.method("twice-as-sure", needs=rejection.Needs(open_water=True))
def twice_as_sure(cube):
    target = rejection.open_water(cube)
    names = [name for name in target if "uncertainty" in name]
    names += [name for name in target if "covariance" in name]
    return target.assign({name: target[name] * 1e-3 for name in names})


@rejection.method("wrong")
def wrong(cube):
    return cube["no such variable"]
"""


@pytest.mark.study
def test_a_method_of_another_package_is_in_the_same_table(tmp_path: Path) -> None:
    packages = tmp_path / "packages"
    info = packages / "other-1.0.dist-info"
    info.mkdir(parents=True)
    (packages / "other.py").write_text(PLUG_IN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[amulor.rejection]\ntwice-as-sure = other:twice_as_sure\n"
        "wrong = other:wrong\nabsent = no_such_module:method\n"
    )
    paths = [str(packages), *filter(None, [os.environ.get("PYTHONPATH")])]
    words = ["benchmark", "--scenes", "coastal-plate", "-o", str(tmp_path / "out")]
    methods = "open-water,twice-as-sure,wrong,absent"
    ended = subprocess.run(
        [sys.executable, "-m", "amulor", *words, "--methods", methods, "--json"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=True,
    )
    rows = {entry["method"]: entry for entry in json.loads(ended.stdout)}
    assert list(rows) == methods.split(",")
    assert rows["open-water"]["inside_95"] > 0.9
    # Errors a thousand times too small: hardly any interval holds.
    assert (rows["twice-as-sure"]["inside_95"] or 0.0) < 0.2
    assert rows["wrong"]["note"].startswith("CRASH: KeyError")
    assert "cannot be loaded" in rows["absent"]["note"]
    page = (tmp_path / "out" / "benchmark.md").read_text()
    assert "| `twice-as-sure` | open water | 1 |" in page
    drawn = (tmp_path / "out" / "benchmark.svg").read_text()
    assert "twice-as-sure" in drawn


def test_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--quick", "--list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert len(listed) == sum(scene.quick for scene in SCENES.values())
    assert all(line.split()[0] in SCENES for line in listed)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenes", "nowhere"], "there is no scene 'nowhere'"),
        (["--methods", "magic"], "there is no method 'magic'"),
        (["--scenes", "spikes", "--quick"], "none of these scenes"),
    ],
)
def test_unknown_names_are_wrong_use(
    words: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["benchmark", *words, "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_a_file_of_scenes_is_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        '[[scenes]]\nname = "mine"\ntitle = "empty"\nwater = "coastal"\n'
        'distance = 2.5\nlayout = "empty"\n'
    )
    out = tmp_path / "out"
    out.mkdir()
    # Figure and page of an earlier run are replaced.
    for name in ("benchmark.svg", "benchmark.md"):
        (out / name).write_text("earlier")
    words = ["benchmark", "--scenes", str(path), "--methods", "none", "-o", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "mine" in printed
    assert "earlier" not in (out / "benchmark.md").read_text("utf-8")
    assert "<svg" in (out / "benchmark.svg").read_text("utf-8")
    assert sorted(file.name for file in out.iterdir()) == [
        "benchmark.csv",
        "benchmark.md",
        "benchmark.svg",
    ]
