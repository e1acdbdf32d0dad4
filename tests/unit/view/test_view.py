"""Figures show the data they are given; reports are whole and escape text."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

from amulor import imaging, rejection
from amulor.errors import CubeError, FormatError
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.view import (
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    figures,
    image_report,
    write_report,
)
from amulor.view.report import png
from amulor.view.style import new_figure


@pytest.fixture(scope="module")
def samples(plate: Survey) -> xr.Dataset:
    return simulate(plate, rng=1)


@pytest.fixture(scope="module")
def images(samples: xr.Dataset) -> dict[str, xr.Dataset]:
    return {
        "before": imaging.range_image(rejection.keep_water(samples), polarization="VV"),
        "after": imaging.range_image(rejection.open_water(samples), polarization="VV"),
    }


def test_amplitude_and_phase_are_drawn_for_every_channel(samples: xr.Dataset) -> None:
    figure = figures.signal_images(samples)
    pictures = [axis.images[0] for axis in figure.axes if axis.images]
    assert len(pictures) == 4
    np.testing.assert_allclose(
        pictures[0].get_array(), samples.amulor.amplitude.values[0, 0] * 1e3
    )
    # The phase is drawn about its mean, without a wrap.
    phase = np.asarray(pictures[1].get_array())
    assert abs(phase.mean()) < 1
    assert np.ptp(phase) < 30


def test_both_ranges_share_their_colours(images: dict[str, xr.Dataset]) -> None:
    figure = figures.range_images(images["before"], images["after"])
    pictures = [axis.images[0] for axis in figure.axes if axis.images]
    assert pictures[0].get_clim() == pictures[1].get_clim()
    np.testing.assert_allclose(
        np.asarray(pictures[2].get_array()),
        images["after"]["slant_range_uncertainty"].values * 1e3,
    )


def test_every_row_is_a_profile(images: dict[str, xr.Dataset]) -> None:
    figure = figures.profiles({"VV": images})
    assert [len(axis.lines) for axis in figure.axes] == [6, 6]


def test_drawing_changes_no_global_setting(images: dict[str, xr.Dataset]) -> None:
    before = dict(mpl.rcParams)
    png(figures.surfaces({"one": images["after"]}))
    assert dict(mpl.rcParams) == before


@pytest.mark.slow
def test_the_same_figure_is_the_same_file(images: dict[str, xr.Dataset]) -> None:
    first, second = (png(figures.image_overview(images["after"])) for _ in range(2))
    assert first == second
    assert first.startswith(b"\x89PNG")


def test_an_image_without_any_range_can_be_drawn(images: dict[str, xr.Dataset]) -> None:
    empty = images["after"].copy(deep=True)
    for name in ("slant_range", "slant_range_uncertainty"):
        empty[name].values[:] = np.nan
    empty["quality_flag"].values[:] = 4
    figure = figures.image_overview(empty)
    assert png(figure).startswith(b"\x89PNG")
    pictures = [axis.images[0] for axis in figure.axes if axis.images]
    drawn = [
        np.ma.filled(np.ma.asarray(p.get_array(), float), np.nan) for p in pictures
    ]
    # Range and uncertainty are empty; the brightness is there as it was measured.
    assert not np.isfinite(drawn[0]).any()
    assert not np.isfinite(drawn[1]).any()
    np.testing.assert_allclose(drawn[2], empty["intensity"].values * 1e3)


def test_a_report_escapes_what_it_is_given(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    evil = "<script>alert(1)</script>"
    parts = [
        Heading(evil),
        Paragraph(evil),
        Table([evil], [[evil], [f"!{evil}"]], evil),
        Listing(evil, evil),
        Picture(new_figure(1, 1), evil),
    ]
    write_report(path, evil, parts)
    page = path.read_text()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 12
    with pytest.raises(FormatError, match="overwrite"):
        write_report(path, evil, parts)


def test_the_report_of_images_says_whether_they_are_simulated(
    tmp_path: Path, images: dict[str, xr.Dataset]
) -> None:
    path = tmp_path / "images.html"
    measured = images["after"].copy()
    measured.attrs["simulated"] = 0
    image_report.write(path, {"real": measured, "made": images["after"]})
    page = path.read_text()
    assert "Measured data, but for made, which are simulated." in page
    assert "Plate in a small tank" in page


def test_the_report_refuses_what_is_no_range_image(
    tmp_path: Path, samples: xr.Dataset
) -> None:
    with pytest.raises(CubeError, match="range_image"):
        image_report.write(tmp_path / "x.html", {"samples": samples})
    assert not (tmp_path / "x.html").exists()
