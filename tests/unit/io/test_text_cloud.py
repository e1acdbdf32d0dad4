"""A text file holds the points as numpy and the csv module read them."""

import csv

import numpy as np
import pytest

from amulor.errors import FormatError
from amulor.io import write_text
from amulor.io.text_cloud import read_text


def test_columns_come_back_under_their_names(point_cloud, tmp_path):
    path = tmp_path / "cloud.csv"
    write_text(point_cloud, path)
    with path.open(newline="") as file:
        lines = [line for line in file if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    assert len(rows) == point_cloud.sizes["point"]
    for name, variable, rounding in (
        ("x [m]", "x", 5e-7),
        ("z [m]", "z", 5e-7),
        ("sigma_range [m]", "slant_range_uncertainty", 5e-7),
        ("quality_flag [1]", "quality_flag", 0),
        ("row [1]", "row", 0),
    ):
        found = np.array([float(row[name]) for row in rows])
        np.testing.assert_allclose(found, point_cloud[variable], rtol=0, atol=rounding)


def test_spaces_set_columns_apart_after_a_header(point_cloud, tmp_path):
    path = tmp_path / "cloud.xyz"
    write_text(point_cloud, path)
    found = np.loadtxt(path)
    for number, axis in enumerate("xyz"):
        np.testing.assert_allclose(found[:, number], point_cloud[axis], atol=5.1e-7)
    head = [line for line in path.read_text().splitlines() if line.startswith("#")]
    assert "x right, y down, z forward" in head[0]
    assert head[-1].split()[1:4] == ["x[m]", "y[m]", "z[m]"]
    assert any("simulate plate.toml" in line for line in head)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 2 3\n", {}),
        ("1 2 3 7\n", {"intensity": 7}),
        ("1 2 3 7 8\n", {"column 4": 7, "column 5": 8}),
        # Named by the last comment, or by a line without numbers.
        ("# made by a scanner\n# x[m] y[m] z[m] sigma[mm]\n1 2 3 7\n", {"sigma": 7}),
        ('"Z [m]";X;Y;Heat;\n3;1;2;7;8\n', {"heat": 7, "unnamed": 8}),
        ("//X,Y,Z,a,a\n1,2,3,7,8\n", {"a": 7, "a 5": 8}),
        # Light below 1 is no color of 0 to 255.
        ("x y z r g b\n1 2 3 0.5 1 0\n", {"red": 0.5, "green": 1, "blue": 0}),
        ("1\n1 2 3\n", {}),
    ],
)
def test_columns_have_the_names_of_the_header_or_the_usual_ones(
    tmp_path, text, expected
):
    path = tmp_path / "cloud.txt"
    path.write_text(text)
    shape = read_text(path, unit=0.5)
    np.testing.assert_array_equal(shape.position, [[0.5, 1.0, 1.5]])
    assert {name: values[0] for name, values in shape.scalars.items()} == expected


def test_columns_of_red_green_and_blue_are_colors(tmp_path):
    path = tmp_path / "cloud.txt"
    for text in ("1 2 3 255 0 7\n", "x y z r g b\n1 2 3 255 0 7\n"):
        path.write_text(text)
        shape = read_text(path, unit=1.0)
        assert shape.colour.tolist() == [[255, 0, 7]]
        assert shape.scalars == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no line with x, y and z in it"),
        ("1 2\n", "line 1: '1 2' are no coordinates"),
        ("a b c\nd e f\n1 2 3\n", "line 2: 'd e f' are no coordinates"),
        ("1 2 3\n4 5\n", "cannot be read as columns of numbers"),
    ],
)
def test_text_that_is_no_cloud_is_refused(tmp_path, text, message):
    path = tmp_path / "cloud.txt"
    path.write_text(text)
    with pytest.raises(FormatError, match=rf"cloud\.txt.*{message}"):
        read_text(path, unit=1.0)
