"""A text file holds the points as numpy and the csv module read them."""

import csv

import numpy as np

from amulor.io import write_text


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
