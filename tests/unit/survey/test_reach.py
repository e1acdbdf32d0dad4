"""Where the beams of a survey meet its own targets, without a ray caster."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.errors import SurveyError
from amulor.simulation import geometry
from amulor.survey import Disc, Survey, course, properties, reach
from amulor.survey.directions import scan_directions
from amulor.survey.platform import HoverCourse
from amulor.survey.reach import target_reach

WINDOW = '\n[instrument.window]\ndistance = "20 cm"\nthickness = "2 cm"\n'
TARGETS = {
    "plate": """
kind = "plate"
position = ["5 cm", "0 m", "1.5 m"]
rotation = ["10 deg", "35 deg", "5 deg"]
width = "1 m"
height = "1 m"
""",
    "staircase": """
kind = "staircase"
position = ["0 m", "0 m", "1.5 m"]
tread_width = "2 cm"
step_heights = ["4 cm", "1 cm"]
height = "50 cm"
""",
    "disc": """
kind = "disc"
position = ["0 m", "0 m", "1.5 m"]
rotation = ["0 deg", "20 deg", "0 deg"]
diameter = "1 m"
""",
}


def _survey(text: str, target: str, *, window: bool = False) -> Survey:
    start, end = text.index("[[targets]]"), text.index("[instrument]")
    text = text[:start] + f"[[targets]]\nreflectance = 0.1\n{target}\n" + text[end:]
    return Survey.from_text(text + (WINDOW if window else ""))


@pytest.mark.parametrize("window", [False, True])
@pytest.mark.parametrize("name", list(TARGETS))
def test_the_reach_holds_what_the_ray_caster_meets(
    plate_text: str, name: str, window: bool
) -> None:
    survey = _survey(plate_text, TARGETS[name], window=window)
    traced = geometry.trace(geometry.Setup(survey)).slant_range
    met = traced[np.isfinite(traced)]
    reach = target_reach(survey)
    assert reach is not None
    # The same beams and flat shapes: only rounding is left between the two.
    assert reach == pytest.approx((met.min(), met.max()), rel=1e-9)


def test_a_bent_disc_reaches_as_deep_as_it_is_bent(plate_text: str) -> None:
    disc = TARGETS["disc"].replace(
        'rotation = ["0 deg", "20 deg", "0 deg"]', 'curvature_radius = "60 cm"'
    )
    survey = _survey(plate_text, disc)
    traced = geometry.trace(geometry.Setup(survey)).slant_range
    reach = target_reach(survey)
    assert reach is not None
    assert reach[0] == pytest.approx(np.nanmin(traced), abs=1e-4)
    sagitta = 0.6 - math.sqrt(0.6**2 - 0.5**2)
    # The corner beams are longer by the inverse cosine of two degrees.
    assert reach[1] == pytest.approx(1.5 + sagitta, rel=2e-3)
    assert reach[1] > np.nanmax(traced[np.isfinite(traced)])


def test_no_target_in_the_beam_has_no_reach(plate_text: str) -> None:
    aside = TARGETS["plate"].replace('"5 cm"', '"5 m"')
    assert target_reach(_survey(plate_text, aside)) is None
    start, end = plate_text.index("[[targets]]"), plate_text.index("[instrument]")
    empty = Survey.from_text(plate_text[:start] + plate_text[end:])
    assert target_reach(empty) is None


def test_a_mesh_is_read_where_it_is_and_unknown_elsewhere(
    plate_text: str, tmp_path
) -> None:
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "box.stl"
    trimesh.creation.box(extents=(300, 300, 200)).export(file)
    mesh = f"""
kind = "mesh"
position = ["0 m", "0 m", "1.5 m"]
file = "{file}"
unit = "mm"
"""
    survey = _survey(plate_text, mesh)
    reach = target_reach(survey)
    # A box from 1.4 to 1.6 m; beams up to 2.05 degrees off the middle.
    assert reach == pytest.approx((1.4, 1.6), rel=2e-3)
    file.unlink()
    assert target_reach(survey) is None


@pytest.mark.parametrize(
    ("place", "along", "expected"),
    [
        # A box from -1 to 1 in each coordinate, and beams along the third axis.
        ((0.0, 0.0, -5.0), (0, 0, 1), (4.0, 6.0)),
        ((0.0, 0.0, 0.5), (0, 0, 1), (0.0, 0.5)),
        ((0.0, 0.0, 5.0), (0, 0, 1), None),
        ((0.99, 0.0, -5.0), (0, 0, 1), (4.0, 6.0)),
        ((-0.99, 0.0, -5.0), (0, 0, 1), (4.0, 6.0)),
        ((1.01, 0.0, -5.0), (0, 0, 1), None),
        ((-1.01, 0.0, -5.0), (0, 0, 1), None),
        ((0.0, 1.01, -5.0), (0, 0, 1), None),
        ((0.0, -1.01, -5.0), (0, 0, 1), None),
        # Through two edges: from x = -1 to z = 1.
        ((-3.0, 0.0, -2.0), (0.6, 0, 0.8), (2 / 0.6, 3 / 0.8)),
        ((-3.0, 0.0, -0.5), (0.6, 0, 0.8), None),
    ],
)
def test_a_beam_enters_and_leaves_a_box(
    place: tuple[float, ...], along: tuple[float, ...],
    expected: tuple[float, float] | None,
) -> None:  # fmt: skip
    offset = np.array([7.0, -3.0, 2.0])
    beam: Any = SimpleNamespace(
        entry=np.array([place]) + offset, direction=np.array([along], dtype=float)
    )
    low, high = np.full(3, -1.0), np.full(3, 1.0)
    (found,) = reach._crossing(beam, np.eye(3), offset, low, high)
    if expected is None:
        assert np.isnan(found).all()
    else:
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(("columns", "rows"), [(1, 6), (2, 6), (12, 1), (12, 2)])
def test_beams_go_to_the_edges_of_a_scan_of_several_lines(
    plate_text: str, columns: int, rows: int
) -> None:
    text = plate_text.replace("columns = 12", f"columns = {columns}")
    survey = Survey.from_text(text.replace("rows = 6", f"rows = {rows}"))
    beams = reach._beams(survey).direction.reshape(rows, columns, 3)
    right, down = beams[0, :, 0], beams[:, 0, 1]
    scan = survey.scan
    if columns == 1:
        assert right == pytest.approx(np.sin(scan.azimuth), abs=1e-3)
    else:
        expected = 2 * np.sin(scan.azimuth_span / 2)
        assert right[-1] - right[0] == pytest.approx(expected, rel=0.02)
    if rows > 1:
        expected = 2 * np.sin(scan.elevation_span / 2)
        assert down[-1] - down[0] == pytest.approx(expected, rel=0.02)


def test_directions_of_a_scan_beyond_memory_are_those_of_some_rows(
    plate_text: str,
) -> None:
    text = plate_text.replace("columns = 12\nrows = 6", "columns = 20000\nrows = 20000")
    survey = Survey.from_text(text)
    with pytest.raises(SurveyError, match="fit into memory here"):
        scan_directions(survey)
    azimuth, _, time = scan_directions(survey, rows=slice(3, 5), columns=slice(0, 7))
    assert azimuth.shape == time.shape == (2, 7)


def test_water_that_states_no_scattering_has_no_moments() -> None:
    survey: Any = SimpleNamespace(water=SimpleNamespace(split_angle=0.5))
    optics: Any = SimpleNamespace(phase_function=None, scattering=0.0)
    assert properties._moments(survey, optics) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("frequencies", "step"),
    [([20e6, 50e6, 90e6], 20e6), ([50e6, 60e6, 90e6], 10e6), ([39e6], 39e6)],
)
def test_phases_repeat_by_the_smallest_step_of_frequencies_and_zero(
    frequencies: list[float], step: float
) -> None:
    expected = 299_792_458.0 / (2 * 1.35 * step)
    found = reach.repetition(frequencies, group_index=1.35)
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("hovers", [False, True])
def test_the_speed_of_a_vehicle_has_course_current_and_swell(hovers: bool) -> None:
    wave = SimpleNamespace(
        period=4.0, position=0.1, current=(0.3, 0.4, 0.0), heading=0.02, pitch=0.1,
        roll=0.05,
    )  # fmt: skip
    moving: Any = SimpleNamespace(speed=0.7)
    at_rest = HoverCourse.model_construct()
    platform: Any = SimpleNamespace(
        course=at_rest if hovers else moving, disturbance=wave
    )
    steady = 0.5 if hovers else 1.2
    swell = 2 * math.pi / 4 * 0.1
    assert course.planned_speed(platform) == pytest.approx(steady + swell)
    # By hand: directions at random, quicker waves by 1.16, and 1 m of lever.
    turn = (0.02**2 + 0.1**2 + 0.05**2) ** 0.5
    size = (0.1**2 + turn**2) ** 0.5
    rate, change = course.range_rate(platform)
    quick = 1.16 * 2 * math.pi / 4 * size
    assert rate == pytest.approx((steady**2 / 3 + quick**2) ** 0.5)
    assert change == pytest.approx(1.69 * (math.pi / 2) ** 2 * size)


@pytest.mark.parametrize(
    ("amplitude", "complaint"),
    [
        ('"1 mV"', ""),
        ('["1 mV"]', ""),
        (
            '["1 mV", "2 mV"]',
            "errors.crosstalk.amplitude has 2 values for 1 modulation",
        ),
    ],
)
def test_crosstalk_has_a_value_for_all_frequencies_or_for_each(
    plate_text: str, amplitude: str, complaint: str
) -> None:
    text = f"{plate_text}\n[instrument.errors.crosstalk]\namplitude = {amplitude}\n"
    if complaint:
        with pytest.raises(SurveyError, match=complaint):
            Survey.from_text(text)
    else:
        assert Survey.from_text(text).instrument.errors is not None


@pytest.mark.parametrize(
    ("holes", "complaint"),
    [
        ({}, ""),
        ({"central_hole": "19.9 cm"}, ""),
        ({"central_hole": "20 cm"}, r"central_hole \(0.2 m\) must be smaller than dia"),
        # Holes of 2 cm on a circle of 14 cm reach from 6 to 8 cm off the middle.
        ({"circle": "14 cm"}, ""),
        ({"circle": "14 cm", "central_hole": "11.9 cm"}, ""),
        (
            {"circle": "14 cm", "central_hole": "12.1 cm"},
            "reach from 0.06 to 0.08 m off",
        ),
        ({"circle": "17.9 cm"}, ""),
        ({"circle": "18.1 cm"}, "reach from 0.0805 to 0.1005 m off the middle"),
        ({"circle": "14 cm", "hole_diameter": "0 cm"}, "hole_diameter must be above 0"),
    ],
)
def test_the_holes_of_a_disc_lie_between_its_middle_and_its_rim(
    holes: dict[str, str], complaint: str
) -> None:
    content: dict[str, Any] = {
        "kind": "disc", "position": ("0 m", "0 m", "1.5 m"), "reflectance": "20 %",
        "diameter": "20 cm", "central_hole": holes.get("central_hole", "0 cm"),
    }  # fmt: skip
    if "circle" in holes:
        content |= {
            "hole_count": 6, "hole_circle": holes["circle"],
            "hole_diameter": holes.get("hole_diameter", "2 cm"),
        }  # fmt: skip
    if complaint:
        with pytest.raises(ValueError, match=complaint):
            Disc.model_validate(content)
    else:
        assert Disc.model_validate(content).diameter == 0.2
