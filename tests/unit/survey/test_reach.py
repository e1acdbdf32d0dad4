"""Where the beams of a survey meet its own targets, without a ray caster."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amulor.simulation import geometry
from amulor.survey import Survey
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
