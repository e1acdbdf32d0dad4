"""Surfaces and targets of a survey: brightness by closed forms, and refusals."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError

from amulor.errors import SurveyError
from amulor.survey import (
    Calibration,
    Disc,
    Glossy,
    Mesh,
    Mounting,
    Plate,
    Survey,
    reach,
)
from amulor.survey.surface import OrenNayar, TabulatedSurface, brightness

ANGLES = {
    "incidence": np.array([0.1, 0.3]),
    "leaving": np.array([0.2, 0.3]),
    "azimuth": np.array([0.0, 1.0]),
}
TEXTURE = np.array([1.0, 0.5])


def test_a_matte_surface_has_the_brightness_of_its_texture() -> None:
    """Without a surface, and without roughness, light is that of Lambert's law."""
    plain = brightness(None, reflectance=0.3, texture=TEXTURE, **ANGLES)
    assert plain.tolist() == [1.0, 0.5]
    smooth = OrenNayar(kind="oren-nayar", roughness=0.0)
    found = brightness(smooth, reflectance=0.3, texture=TEXTURE, **ANGLES)
    assert_allclose(found, TEXTURE)


def test_a_rough_surface_is_brighter_straight_back() -> None:
    """Oren and Nayar: 1 - s2 / (2 s2 + 0.66) + 0.45 s2 / (s2 + 0.09) sin a tan b."""
    rough = OrenNayar(kind="oren-nayar", roughness=0.5)
    found = brightness(rough, reflectance=0.3, texture=TEXTURE, **ANGLES)
    again = brightness(rough, reflectance=0.6, texture=TEXTURE, **ANGLES)
    # More light is reflected twice where more is reflected once.
    assert np.all(again > found)
    ahead = {**ANGLES, "azimuth": np.array([math.pi, math.pi])}
    other = brightness(rough, reflectance=0.3, texture=TEXTURE, **ahead)
    assert np.all(found > other)
    double = brightness(rough, reflectance=0.3, texture=2 * TEXTURE, **ANGLES)
    assert_allclose(double, 2 * found)


def test_facets_mirror_a_part_of_the_light_beside_the_texture() -> None:
    """Their light is in proportion to the gloss, and not to the texture."""

    def found(gloss: float, reflectance: float, texture: Any) -> Any:
        surface = Glossy(kind="glossy", gloss=gloss, rms_slope=0.2)
        return brightness(surface, reflectance=reflectance, texture=texture, **ANGLES)

    one = found(0.1, 0.3, TEXTURE) - TEXTURE
    assert np.all(one > 0)
    assert_allclose(found(0.2, 0.3, TEXTURE) - TEXTURE, 2 * one)
    assert_allclose(found(0.1, 0.6, TEXTURE) - TEXTURE, one / 2)
    assert_allclose(found(0.1, 0.3, 0 * TEXTURE), one)


def table(values: Any, azimuth: tuple[float, ...] = (0.0, 2.0)) -> TabulatedSurface:
    """Return a table of two incidences and three reflections."""
    return TabulatedSurface(
        kind="tabulated", incidence=(0.0, 1.0), reflection=(0.0, 0.5, 1.0),
        azimuth=azimuth, values=tuple(np.ravel(values).tolist()),
    )  # fmt: skip


def test_a_table_is_interpolated_between_its_angles() -> None:
    """A function that is linear in each angle comes through."""
    grid = product((0.0, 1.0), (0.0, 0.5, 1.0), (0.0, 2.0))
    surface = table([0.01 * (1 + i + 2 * r + 4 * a) for i, r, a in grid])
    found = brightness(surface, reflectance=0.3, texture=TEXTURE, **ANGLES)
    expected = 0.01 * (1 + np.array([0.1 + 0.4 + 0.0, 0.3 + 0.6 + 4.0]))
    assert_allclose(found, TEXTURE * np.pi * expected)
    # One azimuth stands for all of them.
    grid = product((0.0, 1.0), (0.0, 0.5, 1.0))
    surface = table([0.01 * (1 + i + 2 * r) for i, r in grid], azimuth=(0.0,))
    found = brightness(surface, reflectance=0.3, texture=TEXTURE, **ANGLES)
    assert_allclose(found, TEXTURE * np.pi * 0.01 * np.array([1.5, 1.9]))


@pytest.mark.parametrize(
    ("name", "angle", "words"),
    [
        ("incidence", 1.001, "incidence from 0 to 57.2958 deg, but a beam meets the "
         "target at 57.4 deg; extend the table"),
        ("leaving", 1.1, "reflection from 0 to 57.2958 deg, but a beam meets"),
        ("azimuth", 2.1, "azimuth from 0 to 114.592 deg, but a beam meets"),
        ("azimuth", -0.1, "target at -5.73 deg"),
    ],
)  # fmt: skip
def test_a_beam_outside_of_a_table_is_named(name, angle, words) -> None:
    """Rounding at the ends of the table is none."""
    surface = table(np.full(12, 0.1))
    beyond = {**ANGLES, name: np.array([0.2, angle])}
    with pytest.raises(SurveyError, match=words):
        brightness(surface, reflectance=0.3, texture=TEXTURE, **beyond)
    edge = {**ANGLES, "incidence": np.array([-5e-10, 1 + 5e-10])}
    found = brightness(surface, reflectance=0.3, texture=TEXTURE, **edge)
    assert_allclose(found, TEXTURE * np.pi * 0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"values": None}, "needs a file, or incidence, reflection, azimuth and val"),
        ({"file": "a.csv"}, "needs a file, or incidence, reflection, azimuth and val"),
        ({"values": (0.1,) * 11}, "found 11 values for 2 incidences, 3 reflections and "
         "2 azimuths; needed are 12"),
        ({"incidence": (0.0,), "values": (0.1,) * 6}, "incidence needs at least two"),
        ({"reflection": (0.0,), "values": (0.1,) * 4}, "reflection needs at least two"),
        ({"azimuth": (2.0, 2.0)}, "must rise; found 114.592, 114.592 deg"),
        ({"incidence": (1.0, 0.0)}, "must rise; found 57.2958, 0 deg"),
        ({"values": (0.8,) * 12}, "times the light that it gets; a BRDF is in 1/sr"),
    ],
)  # fmt: skip
def test_a_table_of_a_surface_has_values_for_all_angles(changes, words) -> None:
    """A table that is stated twice, or not at all, is refused."""
    stated: dict[str, Any] = {
        "kind": "tabulated", "incidence": (0.0, 1.0), "reflection": (0.0, 0.5, 1.0),
        "azimuth": (0.0, 2.0), "values": (0.1,) * 12,
    }  # fmt: skip
    TabulatedSurface.model_validate(stated)
    with pytest.raises(ValidationError, match=words):
        TabulatedSurface.model_validate(stated | changes)
    with pytest.raises(ValidationError, match="needs a file"):
        TabulatedSurface(kind="tabulated")


def test_a_table_of_a_surface_is_read_in_any_order(tmp_path: Path) -> None:
    """Rows are sorted by their angles, the azimuth fastest."""
    rows = [
        (i, r, a, 0.01 + 1e-4 * i + 1e-5 * r + 1e-6 * a)
        for i, r, a in product((0, 40), (0, 30, 60), (0, 90))
    ]
    path = tmp_path / "brdf.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in rows[::-1]))
    named = TabulatedSurface(kind="tabulated", file=Path("brdf.csv"))
    found = named.settled(tmp_path, where="tank: surface")
    assert found.file is None
    assert found.incidence == pytest.approx(np.radians([0, 40]))
    assert found.reflection == pytest.approx(np.radians([0, 30, 60]))
    assert found.azimuth == pytest.approx(np.radians([0, 90]))
    assert found.values == pytest.approx([row[3] for row in rows])
    assert found.settled(tmp_path / "gone", where="x") is found
    message = (
        r"^tank: surface\.file: brdf\.csv must hold every combination of its 2 "
        r"incidences, 3 reflections and 2 azimuths once$"
    )
    for wrong in (rows[1:], [*rows, rows[0]]):
        path.write_text("\n".join(",".join(map(str, row)) for row in wrong))
        with pytest.raises(SurveyError, match=message):
            named.settled(tmp_path, where="tank: surface")


PLACE = {"position": (0.0, 0.0, 1.0), "reflectance": 0.6}


def test_gloss_and_reflectance_are_shares_of_the_light() -> None:
    """Together they are at most 1."""
    stated: dict[str, Any] = {"kind": "plate", "width": 1.0, "height": 1.0, **PLACE}
    glossy = {"kind": "glossy", "gloss": 0.4, "rms_slope": 0.1}
    assert Plate.model_validate(stated | {"surface": glossy}).reflectance == 0.6
    words = r"surface.gloss \(0.41\) and reflectance \(0.6\) together must not exceed 1"
    with pytest.raises(ValidationError, match=words):
        Plate.model_validate(stated | {"surface": glossy | {"gloss": 0.41}})


def test_a_disc_is_bent_by_more_than_its_radius() -> None:
    """A half circle has no edge to look at."""
    stated: dict[str, Any] = {"kind": "disc", "diameter": 0.2, **PLACE}
    bent = Disc.model_validate(stated | {"curvature_radius": 0.101})
    assert bent.curvature_radius == 0.101
    for radius in (0.1, 0.09):
        with pytest.raises(ValidationError, match="must exceed half the diameter"):
            Disc.model_validate(stated | {"curvature_radius": radius})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"unit": "mm"}, ""),
        ({"file": "a.GLB"}, ""),
        (
            {"file": "a.GLB", "unit": "mm"},
            "unit is 'mm', but coordinates of a GLB file",
        ),
        ({"texture": "image", "texture_channel": "red"}, ""),
        ({"texture": "image"}, ""),
        (
            {"texture_channel": "red"},
            "texture_channel is 'red', but texture is missing",
        ),
    ],
)
def test_a_mesh_has_the_unit_and_texture_of_its_file(changes, words) -> None:
    """GLB files are in meters."""
    stated: dict[str, Any] = {"kind": "mesh", "file": "a.ply", **PLACE}
    if not words:
        assert Mesh.model_validate(stated | changes).position == (0.0, 0.0, 1.0)
        return
    with pytest.raises(ValidationError, match=words):
        Mesh.model_validate(stated | changes)


def test_a_mesh_is_named_by_its_full_path(tmp_path: Path) -> None:
    """A full path is not looked for, a relative one is."""
    stated: dict[str, Any] = {"kind": "mesh", "file": "a.ply", **PLACE}
    mesh = Mesh.model_validate(stated)
    words = r"^targets\.0\.file: found 'a\.ply', but there is no such file in "
    with pytest.raises(SurveyError, match=words):
        mesh.settled(tmp_path, where="targets.0")
    (tmp_path / "a.ply").touch()
    settled = mesh.settled(tmp_path, where="targets.0")
    assert settled.file == (tmp_path / "a.ply").resolve()
    (tmp_path / "a.ply").unlink()
    assert settled.settled(Path("elsewhere"), where="targets.0") == settled


def test_boxes_enclose_each_kind_of_target(tmp_path: Path) -> None:
    """A staircase has a box for each tread, from left to right."""
    plate = Plate.model_validate(
        {"kind": "plate", "width": 0.4, "height": 0.2, **PLACE}
    )
    ((low, high),) = reach._boxes(plate) or []
    assert low.tolist() == [-0.2, -0.1, 0.0]
    assert high.tolist() == [0.2, 0.1, 0.0]
    disc = Disc.model_validate({"kind": "disc", "diameter": 0.6, **PLACE})
    ((low, high),) = reach._boxes(disc) or []
    assert low.tolist() == [-0.3, -0.3, 0.0]
    assert high.tolist() == [0.3, 0.3, 0.0]
    bent = disc.model_copy(update={"curvature_radius": 0.5})
    ((_, high),) = reach._boxes(bent) or []
    # A triangle of 3, 4 and 5.
    assert high == pytest.approx([0.3, 0.3, 0.1])
    stairs: Any = {
        "kind": "staircase", "tread_width": 0.1, "step_heights": (0.02, 0.03),
        "height": 0.5, **PLACE,
    }  # fmt: skip
    boxes = reach._boxes(
        Survey.preset("amulor-2010").with_({"targets": [stairs]}).targets[0]
    )
    assert boxes is not None
    assert [low.tolist() for low, _ in boxes] == [
        pytest.approx([-0.15, -0.25, 0.0]), pytest.approx([-0.05, -0.25, -0.02]),
        pytest.approx([0.05, -0.25, -0.05]),
    ]  # fmt: skip
    assert [high.tolist() for _, high in boxes] == [
        pytest.approx([-0.05, 0.25, 0.0]), pytest.approx([0.05, 0.25, -0.02]),
        pytest.approx([0.15, 0.25, -0.05]),
    ]  # fmt: skip
    path = tmp_path / "a.obj"
    path.write_text("v -10 0 5\nv 20 30 5\nv 0 40 7\nf 1 2 3\n")
    mesh = Mesh.model_validate({"kind": "mesh", "file": path, "unit": "cm", **PLACE})
    ((low, high),) = reach._boxes(mesh) or []
    assert low == pytest.approx([-0.1, 0.0, 0.05])
    assert high == pytest.approx([0.2, 0.4, 0.07])


def test_targets_turn_about_right_then_down_then_forward() -> None:
    """A quarter turn about an axis turns the next axis to the one after it."""
    quarter = math.pi / 2
    for axis in range(3):
        angles = [0.0, 0.0, 0.0]
        angles[axis] = quarter
        turn = reach._rotation((angles[0], angles[1], angles[2]))
        following, last = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        assert_allclose(turn @ following, last, atol=1e-12)
        assert_allclose(turn @ last, -following, atol=1e-12)
    # About right first: forward goes up, and a turn about down then leaves it there.
    both = reach._rotation((quarter, quarter, 0.0))
    assert_allclose(both @ [0, 0, 1], [0, -1, 0], atol=1e-12)


def test_uncertainties_of_a_mounting_are_stated_once() -> None:
    """One number stands for three, and both are too many."""
    three = (0.1, 0.2, 0.3)
    for name in ("lever_arm", "boresight"):
        one: dict[str, Any] = {f"{name}_uncertainty": 0.1}
        Mounting.model_validate(one)
        Mounting.model_validate({f"{name}_uncertainties": three})
        words = f"{name}_uncertainty and {name}_uncertainties are both stated; state"
        with pytest.raises(ValidationError, match=words):
            Mounting.model_validate(one | {f"{name}_uncertainties": three})


def test_a_correlation_of_errors_is_one_of_real_errors() -> None:
    """Eight rows of eight, symmetric, 1 with itself, and no negative variance."""
    good = np.eye(8)
    good[0, 1] = good[1, 0] = 0.999
    assert Mounting(correlation=tuple(map(tuple, good.tolist()))).correlation
    odd, off, wild = good.copy(), good.copy(), good.copy()
    odd[0, 1] = 0.5
    off[3, 3] = 0.9
    # Two errors agree with a third one, and oppose each other.
    wild[2, 0] = wild[0, 2] = 0.9
    wild[2, 1] = wild[1, 2] = -0.9
    for matrix, words in (
        (good[:7], "correlation needs eight rows of eight numbers"),
        (good[:, :7], "correlation needs eight rows of eight numbers"),
        (odd, "correlation must be symmetric, with 1 in its diagonal"),
        (off, "correlation must be symmetric, with 1 in its diagonal"),
        (wild, "correlation has the eigenvalue -0.[0-9]+; the matrix of real errors"),
    ):
        with pytest.raises(ValidationError, match=words):
            Mounting(correlation=tuple(map(tuple, matrix.tolist())))


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({}, ""),
        ({"delay_uncertainty": 1e-10, "date": "2026-05-01", "delay_growth": 1e-12}, ""),
        ({"temperature_uncertainty": 0.1, "salinity_uncertainty": 0.1}, ""),
        ({"group_index_uncertainty": 1e-4}, ""),
        ({"group_index_uncertainty": 1e-4, "salinity_uncertainty": 0.1}, "stated twi"),
        ({"group_index_uncertainty": 1e-4, "temperature_uncertainty": 1}, "stated t"),
        ({"date": "2026-05-01"}, "date is that of the delay, but delay_uncertainty is"),
        ({"delay_uncertainty": 1e-10, "delay_growth": 1e-12}, "but date is missing"),
        ({"delay_uncertainty": 1e-10, "delay_per_degree": 1e-12}, "belong together"),
        ({"instrument_temperature_uncertainty": 5}, "belong together; state both"),
        ({"delay_per_degree": 1e-12, "instrument_temperature_uncertainty": 5},
         "delay_per_degree adds to delay_uncertainty, which is missing"),
        ({"delay_per_degree": 1e-12, "instrument_temperature_uncertainty": 5,
          "delay_uncertainty": 1e-10}, ""),
    ],
)  # fmt: skip
def test_a_calibration_states_what_belongs_together(stated, words) -> None:
    """Ages need a date, and a date needs an uncertainty."""
    if not words:
        Calibration.model_validate(stated)
        return
    with pytest.raises(ValidationError, match=words):
        Calibration.model_validate(stated)
