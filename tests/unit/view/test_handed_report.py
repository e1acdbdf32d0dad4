"""The report as a person reads it: maps of one shape, labels whole, what it states."""

from __future__ import annotations

import re
import shutil
import subprocess
from itertools import pairwise

import exact_scenes as scenes
import numpy as np
import pytest
import skips
from matplotlib.backends.backend_agg import FigureCanvasAgg
from pdf_files import letter_sizes

from amulor.cli import main
from amulor.imaging import error_budget
from amulor.view import figures, image_report
from amulor.view.accuracy import budget_figure
from amulor.view.pdf import write_pdf
from amulor.view.style import style


def drawn(figure):
    """Return the figure as it is laid out on paper."""
    with style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return canvas.get_renderer()


@pytest.mark.parametrize(
    ("rows", "columns"),
    [
        (200, 30),
        (30, 200),
        (12, 6),
        pytest.param(60, 60, marks=pytest.mark.slow),
        pytest.param(400, 20, marks=pytest.mark.slow),
    ],
)
def test_maps_are_of_one_shape_and_no_label_is_clipped_or_covered(
    rows, columns
) -> None:
    image = scenes.plane((0.02, 0.01, 1), 1.5, rows=rows, columns=columns)
    figure = figures.image_overview(image)
    renderer = drawn(figure)
    maps = [axis for axis in figure.axes if axis.images]
    sizes = {tuple(np.round(axis.get_window_extent().size, 3)) for axis in maps}
    assert len(maps) == 4
    assert len(sizes) == 1
    (wide, high) = sizes.pop()
    # Angles are drawn alike across and upwards, but for very slender scans.
    assert high / wide == pytest.approx(np.clip(rows / columns, 1 / 8, 8), rel=0.06)
    assert min(wide, high) > 0.4 * figure.dpi
    page = figure.bbox
    for axis in figure.axes:
        rulers = [shown(axis.xaxis, renderer), shown(axis.yaxis, renderer)]
        texts = (axis.xaxis.label, axis.yaxis.label, axis.title)
        labels = [t.get_window_extent(renderer) for t in texts if t.get_text()]
        for box in (*labels, *rulers[0], *rulers[1]):
            assert page.x0 - 1 <= box.x0
            assert box.x1 <= page.x1 + 1
            assert page.y0 - 1 <= box.y0
            assert box.y1 <= page.y1 + 1
        assert all(one.x1 <= other.x0 + 1 for one, other in pairwise(rulers[0]))
        assert all(one.y1 <= other.y0 + 1 for one, other in pairwise(rulers[1]))


def shown(ruler, renderer):
    """Return the places of the numbers of an axis that are drawn, in order."""
    low, high = sorted(ruler.get_view_interval())
    room = 1e-9 * (high - low)
    boxes = [
        tick.label1.get_window_extent(renderer)
        if tick.label1.get_visible()
        else tick.label2.get_window_extent(renderer)
        for tick in ruler.get_major_ticks()
        if low - room <= tick.get_loc() <= high + room
    ]
    boxes = [box for box in boxes if box.width > 0]
    return sorted(boxes, key=lambda box: box.x0 if ruler.axis_name == "x" else box.y0)


def test_colours_mean_one_thing() -> None:
    image = scenes.plane((0, 0, 1), 1.5)
    names = [
        axis.images[0].get_cmap().name
        for figure in (
            figures.image_overview(image),
            figures.range_images(image, image),
        )
        for axis in figure.axes
        if axis.images
    ]
    assert names[:3] == ["viridis", "cividis", "gray"]
    assert names[4:] == ["viridis", "viridis", "cividis", "RdBu_r"]


def test_a_thousand_profiles_are_a_band_of_quantiles() -> None:
    rng = np.random.default_rng(3)
    image = scenes.drawn(scenes.plane((0, 0, 1), 1.5, rows=1000, columns=12), rng, 1e-3)
    # All rows at one height: what varies from row to row is noise of 1 mm.
    image["slant_range"].values[:] = 1.5 + rng.normal(scale=1e-3, size=(1000, 12))
    image = image.assign_coords(elevation=image["elevation"] * 0)
    figure = figures.profiles({"wall": {"range image": image}})
    (axis,) = figure.axes
    assert len(axis.lines) == 1
    widths = []
    for band in axis.collections:
        x, y = band.get_paths()[0].vertices.T
        widths.append([np.ptp(y[x == place]) for place in np.unique(x)])
    wide, narrow = np.mean(widths, axis=1)
    # 2 x 1.96 and 2 x 0.99 standard deviations of 1 mm, each known to 3 %.
    assert wide == pytest.approx(3.92, abs=0.15)
    assert narrow == pytest.approx(1.99, abs=0.08)


@pytest.fixture(scope="module")
def page(tmp_path_factory, plate_text):
    """Return a report with two checks, one of which must fail."""
    from amulor import io

    folder = tmp_path_factory.mktemp("report")
    survey = plate_text + (
        '[pose]\nheading = "30 deg"\nposition = ["1 m", "2 m", "-9 m"]\n'
        'crs = "EPSG:32632"\nposition_uncertainty = "2 cm"\n'
    )
    image = scenes.ladder(own=2e-4, shared=1e-4).assign_attrs(survey=survey)
    io.write_cube(image, folder / "ladder.nc")
    (folder / "checks.toml").write_text(
        '[[checks]]\nname = "first step"\nkind = "relief"\nfirst = [10, 6]\n'
        'second = [10, 18]\nexpected = "40 mm"\ntolerance = "1 mm"\n'
    )
    words = ["report", str(folder / "ladder.nc"), "-o", str(folder / "r.html")]
    words += ["--checks", str(folder / "checks.toml"), "--check", "10,6 10,18 33mm"]
    assert main(words) == 0
    return folder / "r.html"


def test_the_report_states_instrument_water_registration_and_accuracy(page) -> None:
    text = re.sub(r"<[^>]+>", "|", page.read_text().split("srcdoc")[0])
    for claim in (
        "405 nm",
        "39 MHz",
        "0.255 1/m",
        "EPSG:32632",
        "1, 2, -9",
        "30, 0, 0",
        "not known: heading, level",
        "coverage factor k = 2",
        "JCGM 100",
        "IMCA S 019",
        "1 of 2 check distances pass",
    ):
        assert claim in text, claim
    # 0.2 mm and 0.1 mm: combined 0.224 mm, expanded 0.447 mm.
    assert re.search(
        r"\|0\.2\|.*\|0\.1\|.*\|0\.224\|.*\|0\.447\|", text, flags=re.DOTALL
    )
    rows = re.findall(r"<tr>.*?</tr>", page.read_text().split("srcdoc")[0])
    (step,) = [row for row in rows if "first step" in row]
    assert ">40.00<" in step
    assert ">pass<" in step
    (other,) = [row for row in rows if "check 1" in row]
    assert '<td class="warning text">fail</td>' in other


def test_the_first_picture_comes_first_and_the_survey_last(page) -> None:
    text = re.sub(r'srcdoc="[^"]*"', "", page.read_text())
    body = text[text.index("<main>") :]
    picture, table = body.index("<figure>"), body.index("<table>")
    annex = body.index('<h2 class="page">Annex')
    assert picture < table < annex
    # Listings are preformatted; the survey is one.
    assert body.index("<pre>") > annex
    assert "<h2" not in body[annex + 4 :]


def test_the_accuracy_statement_has_what_an_inspector_asks_for(page) -> None:
    text = re.sub(r'srcdoc="[^"]*"', "", page.read_text())
    rows = dict(
        re.findall(r"<tr><td[^>]*>([^<]*)</td><td[^>]*>([^<]*)</td></tr>", text)
    )
    # 0.2 mm and 0.1 mm: combined 0.224 mm, doubled.
    assert rows["expanded uncertainty"] == "U = 0.447 mm (median)"
    assert "k = 2" in rows["coverage"]
    # Treads of 1.43 to 1.5 m, seen at up to 40 mrad.
    assert rows["conditions"].startswith("distances of 1.43 to 1.5 m")
    assert "405 nm" in rows["conditions"]
    assert "group index 1.38" in rows["traceability"]
    assert "no date of a delay calibration" in rows["traceability"]
    assert rows["verification"] == "1 of 2 known lengths confirm it"
    assert rows["not included"].endswith("directions of the beams")


@pytest.mark.slow
def test_a_browser_prints_it_on_a4(page) -> None:
    browser = skips.need_browser()
    pdf = page.with_suffix(".pdf")
    subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--no-pdf-header-footer"),
            f"--print-to-pdf={pdf}",
            page.as_uri(),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    content = pdf.read_bytes()
    boxes = set(re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content))
    assert len(boxes) == 1
    size = [float(v) / 72 * 25.4 for v in boxes.pop()]
    assert size == pytest.approx([210, 297], abs=0.7)
    assert 3 <= len(re.findall(rb"/Type ?/Page\b", content)) <= 9
    if shutil.which("pdfimages") is not None:
        words = ["pdfimages", "-list", str(pdf)]
        listed = subprocess.run(words, capture_output=True, text=True, check=True)
        # Two lines of header; the first column is the page.
        assert listed.stdout.splitlines()[2].split()[0] == "1"


@pytest.mark.parametrize(
    "check",
    ["10,6 10,18", "10 10 40mm", "10,6 10,18 40", "1,1 2,2 4mm 1mm x", "a,b c,d 1mm"],
)
def test_a_check_that_is_none_is_refused_before_the_work(
    check, tmp_path, capsys
) -> None:
    words = ["report", "none.nc", "-o", str(tmp_path / "r.html"), "--check", check]
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_another_ending_is_refused_before_the_work(tmp_path, capsys) -> None:
    assert main(["report", "none.nc", "-o", str(tmp_path / "r.pdf")]) == 2
    assert ".html" in capsys.readouterr().err


@pytest.mark.slow
def test_a_large_tall_scan_is_reported(tmp_path) -> None:
    image = scenes.plane((0.02, 0.01, 1), 1.5, rows=150, columns=20)
    image_report.write(tmp_path / "r.html", {"tall": image})
    text = (tmp_path / "r.html").read_text()
    assert "the bands that hold 68 and 95 of 100" in text
    assert "No check distances were given" in text


def test_letters_of_all_figures_have_seven_points_and_more(tmp_path) -> None:
    image = scenes.plane((0.02, 0.01, 1), 1.5, own=2e-4, shared=1e-4)
    drawn_figures = {
        "overview": figures.image_overview(image),
        "before and after": figures.range_images(image, image),
        "profiles": figures.profiles({"wall": {"range image": image}}),
        "surfaces": figures.surfaces({"wall": image}),
        "budget": budget_figure({"wall": error_budget(image)}),
    }
    for name, figure in drawn_figures.items():
        path = tmp_path / f"{name}.pdf"
        write_pdf([figure], path, title=name)
        assert min(letter_sizes(path)) >= 7, name
