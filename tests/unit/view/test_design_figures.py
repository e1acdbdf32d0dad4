"""Figures of a design are drawn from the numbers that they are given."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.contour import QuadContourSet
from numpy.testing import assert_allclose

from amulor.view.design import figures
from amulor.view.report import png


def _found() -> xr.Dataset:
    """Return an error that grows as distance squared, 1 mm at 1 m."""
    distance, attenuation = np.linspace(0.5, 5, 46), np.geomspace(0.1, 2, 9)
    clear, near = np.meshgrid(attenuation, distance, indexing="ij")
    values = {
        "total_error": 1e-3 * near**2,
        "ambiguous": near > 4,
        "saturated": near < 0.8,
        "model_not_valid": clear > 1.5,
    }
    return xr.Dataset(
        {name: (("attenuation", "distance"), one) for name, one in values.items()},
        coords={"attenuation": attenuation, "distance": distance},
    )


def test_lines_of_the_map_stand_where_the_error_has_their_value() -> None:
    figure = figures.error_map(_found(), asked=[(2.0, 0.4)], title="plate")
    (lines,) = (
        one
        for one in figure.axes[0].collections
        if isinstance(one, QuadContourSet) and not one.filled
    )
    ends = {}
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        ends[round(float(np.exp(level)), 6)] = path.vertices[:, 0].mean()
    # 1, 3 and 10 mm at the roots of 1, 3 and 10 m.
    assert ends == pytest.approx({1.0: 1.0, 3.0: 3**0.5, 10.0: 10**0.5}, rel=1e-3)
    texts = {text.get_text() for text in figure.axes[0].get_legend().get_texts()}
    assert texts == {
        "asked for", "ambiguous", "detector saturated", "model not valid"
    }  # fmt: skip
    assert png(figure).startswith(b"\x89PNG")


def test_a_map_without_regions_has_no_words_of_them() -> None:
    found = _found()
    for name, _, _ in figures.REGIONS:
        found[name] = found[name] & False
    assert figures.error_map(found).axes[0].get_legend() is None


def test_fronts_mark_what_is_recommended_and_the_knee() -> None:
    time = np.geomspace(60, 6000, 21)
    error = np.maximum(0.06 / time, 1e-4) - 1e-9 * time / 60
    figure = figures.fronts(
        error, scan_time=time, top_frequency=1e8 / time, best=4, target=1e-3
    )
    marks = {line.get_label(): line.get_xydata() for line in figure.axes[0].get_lines()}
    assert_allclose(marks["recommended"][0], [time[4] / 60, error[4] * 1e3])
    assert marks["knee"][0][0] == pytest.approx(10, rel=1e-6)
    assert png(figure).startswith(b"\x89PNG")


def test_the_largest_share_stands_on_top() -> None:
    figure = figures.sensitivity_bars(["a", "b", "c"], [0.2, 0.7, 0.1], [0.02, 0.03, 0])
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["c", "a", "b"]
    widths = [bar.get_width() for bar in figure.axes[0].patches]
    assert widths == [0.1, 0.2, 0.7]
