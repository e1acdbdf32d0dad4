"""Surfaces, textures, names of materials and several meshes in a simulated scene."""

from __future__ import annotations

import re

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from PIL import Image

from amulor.errors import SurveyError
from amulor.optics.reflection import mirror_facets, oren_nayar
from amulor.simulation import DiffusionModel, simulate
from amulor.simulation.geometry import Setup, trace
from amulor.survey import Glossy, Survey
from amulor.survey.surface import brightness as surface_brightness

SQUARE = np.array([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def brightness(survey: Survey) -> np.ndarray:
    return trace(Setup(survey)).brightness


def echo(survey: Survey) -> np.ndarray:
    truth = simulate(survey, rng=1, model=DiffusionModel()).amulor.truth
    return np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values


@pytest.fixture(scope="module")
def small(plate: Survey) -> Survey:
    return plate.with_({"scan.columns": 9, "scan.rows": 5, "scan.open_water": None})


@pytest.mark.parametrize(
    "surface",
    [
        {"kind": "lambertian"},
        {"kind": "oren-nayar", "roughness": 0.0},
        {
            "kind": "tabulated",
            "incidence": [0.0, 1.0],
            "reflection": [0.0, 1.0],
            "azimuth": [0.0],
            "values": [1 / np.pi] * 4,
        },
    ],
)
def test_lambert_said_in_three_ways_is_lambert(small, surface):
    named = small.with_({"targets.0.surface": surface})
    assert_allclose(echo(named), echo(small), rtol=1e-12)


def test_a_rough_plate_is_as_bright_as_its_formula_says(small):
    turned = {"targets.0.rotation": (0.0, 0.7, 0.0), "scan.columns": 1, "scan.rows": 1}
    survey = small.with_(turned)
    rough = survey.with_(
        {"targets.0.surface": {"kind": "oren-nayar", "roughness": 0.5}}
    )
    # The beam runs forward, the receiver stands 7 cm to the right; the normal leans to
    # the left by the angle that the plate is turned by.
    back = np.arctan(0.07 / 1.5)
    expected = oren_nayar(
        incidence=0.7,
        reflection=0.7 + back,
        azimuth=0.0,
        roughness=0.5,
        reflectance=0.1,
    )
    found = echo(rough) / echo(survey)
    assert_allclose(found, np.pi * expected / 0.1, rtol=1e-9)
    level = rough.with_({"targets.0.rotation": None})
    # Turned away, it loses less than Lambert's law says.
    assert found.flat[0] > 1.1 * (echo(level) / echo(small)[..., 2:3, 4:5]).flat[0]


def test_a_glossy_plate_has_a_highlight_that_its_texture_does_not_dim(small):
    survey = small.with_({"scan.columns": 1, "scan.rows": 1})
    glossy = {"kind": "glossy", "gloss": 0.05, "rms_slope": 0.1}
    expected = mirror_facets(
        incidence=0.0, reflection=np.arctan(0.07 / 1.5), azimuth=0.0, rms_slope=0.1
    )
    found = echo(survey.with_({"targets.0.surface": glossy})) / echo(survey)
    assert_allclose(found, 1 + 0.05 * np.pi * expected / 0.1, rtol=1e-9)
    angle = np.zeros(2)
    dark = surface_brightness(
        Glossy(**glossy), reflectance=0.1, texture=np.array([0.0, 1.0]),
        incidence=angle, leaving=angle, azimuth=angle,
    )  # fmt: skip
    assert_allclose(np.diff(dark), 1, rtol=1e-9)
    with pytest.raises(SurveyError, match=r"surface\.gloss \(0\.05\) and reflectance"):
        survey.with_({"targets.0.surface": glossy, "targets.0.reflectance": 0.96})


def test_a_measured_table_is_read_and_travels_with_the_survey(
    small, plate_text, tmp_path
):
    rows = ["# incidence, reflection, azimuth, BRDF"]
    rows += [
        f"{i}, {r}, {a}, {(1 + 0.1 * i / 30) / np.pi!r}"
        for a in (0, 180)
        for r in (0, 60)
        for i in (0, 30, 60)
    ]
    (tmp_path / "brdf.csv").write_text("\n".join(rows))
    text = plate_text.replace(
        "reflectance = 0.1",
        'reflectance = 0.1\nrotation = ["0 deg", "15 deg", "0 deg"]\n'
        'surface = {kind = "tabulated", file = "brdf.csv"}',
    )
    survey = Survey.from_text(text, folder=tmp_path).with_(
        {"scan.columns": 1, "scan.rows": 1}
    )
    # Linear in the incidence: 15 of 30 degrees are half of the way to 1.1.
    assert_allclose(brightness(survey), 1.05, rtol=1e-9)
    (tmp_path / "brdf.csv").unlink()
    assert_allclose(brightness(Survey.from_text(survey.to_toml())), 1.05, rtol=1e-9)
    steep = survey.with_({"targets.0.rotation": (0.0, 1.1, 0.0)})
    with pytest.raises(
        SurveyError, match=r"surface: its table has incidence .* extend"
    ):
        brightness(steep)
    (tmp_path / "brdf.csv").write_text("\n".join(rows[:-1]))
    with pytest.raises(SurveyError, match=r"targets\.0\.surface\.file: .*combination"):
        Survey.from_text(text, folder=tmp_path)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"values": [3.0] * 8}, "times the light that it gets"),
        ({"values": [0.3] * 7}, "found 7 values .* needed are 8"),
        ({"incidence": [0.5, 0.0]}, "must rise"),
        ({"incidence": [0.0], "values": [0.3] * 4}, "at least two angles"),
        ({"azimuth": None}, "needs a file, or"),
        ({"file": "brdf.csv"}, "needs a file, or"),
    ],
)
def test_a_table_that_no_surface_can_have_is_refused(small, fields, words):
    table = {
        "kind": "tabulated",
        "incidence": [0.0, 1.5],
        "reflection": [0.0, 1.5],
        "azimuth": [0.0, np.pi],
        "values": [0.3] * 8,
    }
    assert small.with_({"targets.0.surface": table}) is not None
    with pytest.raises(SurveyError, match=words) as caught:
        small.with_({"targets.0.surface": {**table, **fields}})
    assert str(caught.value).startswith("survey: targets.0.surface")


def mesh(small: Survey, path, **fields: object) -> Survey:
    target = {
        "kind": "mesh",
        "file": str(path),
        "position": (0.0, 0.0, 1.5),
        "reflectance": 0.5,
        **fields,
    }
    return small.with_({"targets": [target]})


def test_colours_of_vertices_run_evenly_over_a_triangle(small, tmp_path):
    colours = np.zeros((4, 4), dtype=np.uint8)
    colours[:, 3] = 255
    colours[[1, 2], 2] = 255  # blue on the right, black on the left
    square = trimesh.Trimesh(SQUARE, FACES, vertex_colors=colours, process=False)
    square.export(tmp_path / "square.ply")
    survey = mesh(
        small,
        tmp_path / "square.ply",
        texture="vertex-colours",
        texture_channel="blue",
    )
    right = 1.5 * np.tan(trace(Setup(small)).azimuth)
    assert_allclose(brightness(survey), 0.5 + right / 0.4, atol=1e-6)
    third = survey.with_({"targets.0.texture_channel": "mean"})
    assert_allclose(brightness(third), brightness(survey) / 3, rtol=1e-9)
    plain = survey.with_({"targets.0.texture": None, "targets.0.texture_channel": None})
    # Without scattering, as the water blurs textures.
    clear = {"water.scattering": 0.0}
    share = echo(survey.with_(clear))[0, 0] / echo(plain.with_(clear))[0, 0]
    assert_allclose(share, brightness(survey), rtol=1e-9)


def test_an_image_lies_where_its_coordinates_say(small, tmp_path):
    # White above, black below; v of an image grows upwards, down is the second axis.
    pixels = np.zeros((64, 64, 3), dtype=np.uint8)
    pixels[:32] = 255
    visual = trimesh.visual.TextureVisuals(
        uv=np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]]),
        material=trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(pixels)
        ),
    )
    square = trimesh.Trimesh(SQUARE, FACES, visual=visual, process=False)
    square.export(tmp_path / "square.glb")
    survey = mesh(small, tmp_path / "square.glb", texture="image")
    elevation = trace(Setup(small)).elevation
    found = brightness(survey)
    assert_allclose(found[elevation > 0.005], 1.0, atol=1e-6)
    assert_allclose(found[elevation < -0.005], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("texture", "words"), [("vertex-colours", "no colors"), ("image", "no image")]
)
def test_a_mesh_without_a_texture_is_refused(small, tmp_path, texture, words):
    trimesh.Trimesh(SQUARE, FACES, process=False).export(tmp_path / "plain.stl")
    survey = mesh(small, tmp_path / "plain.stl", texture=texture)
    with pytest.raises(SurveyError, match=rf"plain\.stl: has {words}"):
        brightness(survey)


def test_several_meshes_stand_each_in_its_own_pose(small, tmp_path):
    trimesh.Trimesh(SQUARE / 20, FACES, process=False).export(tmp_path / "tile.stl")
    common = {"kind": "mesh", "file": str(tmp_path / "tile.stl"), "reflectance": 0.5}
    places = [(-0.03, 0.0, 1.2), (0.0, 0.0, 1.3), (0.03, 0.0, 1.4)]
    turns = [0.0, 0.3, -0.5]
    survey = small.with_(
        {
            "targets": [
                {**common, "position": place, "rotation": (0.0, turn, 0.0)}
                for place, turn in zip(places, turns, strict=True)
            ],
            "scan.columns": 300,
            "scan.rows": 1,
        }
    )
    found = trace(Setup(survey))
    for number, ((right, _, forward), turn) in enumerate(
        zip(places, turns, strict=True)
    ):
        met = found.target == number
        assert met.any()
        x = found.slant_range[met] * np.sin(found.azimuth[met])
        z = found.slant_range[met] * np.cos(found.azimuth[met])
        assert_allclose(z - forward, -np.tan(turn) * (x - right), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "matrix"),
    [
        ("painted-metal", [0.61, -0.61, -0.46]),
        ("smooth-metal", [1.0, -1.0, -1.0]),
        ("ideal-depolarizer", [0.0, 0.0, 0.0]),
    ],
)
def test_a_named_surface_is_its_published_matrix(small, name, matrix):
    named = small.with_({"targets.0.mueller": name})
    assert_allclose(
        echo(named), echo(small.with_({"targets.0.mueller": matrix})), rtol=1e-12
    )
    assert Survey.from_text(named.to_toml()) == named
    # VV and VH share the light as (1 + m22) / 2 and (1 - m22) / 2.
    parallel, crossed = echo(named)[0]
    assert_allclose(crossed * (1 + matrix[0]), parallel * (1 - matrix[0]), atol=1e-18)


@pytest.mark.parametrize("name", ["concrete", "ceramic", "sand"])
def test_a_surface_without_a_published_matrix_is_refused_by_name(plate_text, name):
    text = plate_text.replace(
        "reflectance = 0.1", f'reflectance = 0.1\nmueller = "{name}"'
    )
    with pytest.raises(SurveyError, match=r"targets\.0\.mueller") as caught:
        Survey.from_text(text)
    (line,) = str(caught.value).splitlines()
    assert re.search(rf"{name}.*painted-metal, smooth-metal", line)
