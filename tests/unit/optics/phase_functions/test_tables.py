"""Claims about phase functions from tables, and Petzold's in particular."""

import csv
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import special

from amulor.optics import phase_functions
from amulor.optics.phase_functions import mie
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.phase_functions.tables import (
    STATIONS,
    from_cumulative,
    petzold,
    tabulated,
)

REFERENCE = Path(__file__).parents[3] / "reference"
NODE = np.array([1e-3, 0.01, 0.1, 0.5, 1.5, 2.5, np.pi])
stations = pytest.mark.parametrize("station", [*STATIONS, "average_particle"])


def printed() -> list[list[str]]:
    with (REFERENCE / "petzold_1972_shapes.csv").open(encoding="utf-8") as lines:
        return list(csv.reader(line for line in lines if not line.startswith("#")))


def fine_sum(model, *, split, k):
    """Return the transform by a plain rule, with five points an oscillation."""
    edges = np.concatenate(
        [
            np.geomspace(1e-12, 1e-6, 150),
            np.geomspace(1e-6, split, 8000),
            np.arange(1e-4, split, 2.0 / max(k, 10.0)),
        ]
    )
    edges = np.unique(edges[edges < split * (1 - 1e-12)])
    edges = np.append(edges, split)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    half = np.diff(edges)[:, np.newaxis] / 2
    angle = edges[:-1, np.newaxis] + half * (nodes + 1)
    share = model(angle) * np.sin(angle) * half * weights
    head = float(model(1e-12)) * 1e-24 / (2 - model.head_exponent)
    return (np.sum(share * special.j0(k * angle)) + head) / (share.sum() + head)


@pytest.mark.parametrize("row", printed(), ids=lambda row: row[0])
def test_petzold_meets_what_the_report_prints(row):
    station, *numbers = row
    scattering, backscatter, median = map(float, numbers)
    water = petzold(station)
    # Three decimals are printed, and the report integrates by another rule: 0.3 %.
    assert_allclose(water.integral, scattering, rtol=3e-3, atol=5e-4)
    assert_allclose(water.backscatter_fraction, backscatter, rtol=0, atol=8e-4)
    below = float(water.cumulative(np.radians(median)))
    # Half lies below the median angle; 0.3 % of the integral moves it.
    assert_allclose(below, 0.5, rtol=0, atol=2e-3)


def test_petzold_holds_the_values_of_the_report():
    # NUC 2040 at 0.1, 10, 90 and 180 degrees, 1/(m sr).
    harbour = petzold("NUC 2040")
    angle = np.minimum(np.radians([0.1, 10, 90, 180]), np.pi)
    source = resources.files("amulor.optics").joinpath("data", "petzold_1972_vsf.csv")
    with source.open(encoding="utf-8") as lines:
        table = np.loadtxt(lines, delimiter=",")
    rows = [int(np.argmin(np.abs(table[:, 0] - d))) for d in (0.1, 10, 90, 180)]
    expected = table[rows, 1 + STATIONS.index("NUC 2040")]
    assert_allclose(harbour.integral * harbour(angle), expected, rtol=1e-12)
    assert table.shape == (55, 9)
    # The first row as printed.
    assert_allclose(expected[0], 3262, rtol=0, atol=0.5)


def test_average_particle_has_the_published_asymmetry():
    asymmetry, backscatter = np.loadtxt(
        REFERENCE / "mobley_1993_checks.csv", delimiter=","
    )
    water = petzold("average_particle")
    # Three decimals.
    assert_allclose(water.asymmetry, asymmetry, rtol=0, atol=5.1e-4)
    # 1 less the table's own share at 90 degrees, 0.981908, is 0.0181: the published
    # fraction was integrated by another rule.
    assert_allclose(water.backscatter_fraction, 1 - 0.981908, rtol=0, atol=1e-12)
    assert_allclose(water.backscatter_fraction, backscatter, rtol=0, atol=3e-4)


def test_average_particle_goes_through_the_shares_of_its_table():
    name = "mobley_1993_average_particle.csv"
    source = resources.files("amulor.optics").joinpath("data", name)
    with source.open(encoding="utf-8") as lines:
        degrees, share = np.loadtxt(lines, delimiter=",", unpack=True)
    water = petzold("average_particle")
    angle = np.minimum(np.radians(degrees), np.pi)
    assert_allclose(water.cumulative(angle), share, rtol=0, atol=1e-11)
    # Its first shares rise by 0.060055 / 0.051653 over 0.1 in the decimal logarithm
    # of the angle, which is given to five figures.
    expected = 2 - np.log10(0.060055 / 0.051653) / 0.1
    assert_allclose(water.head_exponent, expected, rtol=0, atol=2e-4)


@stations
def test_petzold_says_what_lies_in_its_head(station):
    water = petzold(station)
    assert_allclose(water.head_angle, np.radians(0.1), rtol=1e-12)
    share = float(water.cumulative(water.head_angle))
    assert "below 0.1 deg" in water.description
    assert f"{100 * share:.2g} % of the scattering" in water.description
    assert "without data" in water.description
    # Below 0.1 degree a pure power law.
    angle = np.array([1e-9, 1e-6, 1e-4])
    slope = np.diff(np.log(water(angle))) / np.diff(np.log(angle))
    assert_allclose(slope, -water.head_exponent, rtol=1e-6)
    assert_allclose(
        water.cumulative(1e-4) / share,
        (1e-4 / water.head_angle) ** (2 - water.head_exponent),
        rtol=1e-6,
    )


@stations
@pytest.mark.parametrize(("split", "k"), [(np.pi / 2, 30.0), (0.3, 1e4), (1.5, 1e5)])
def test_transform_is_that_of_a_plain_rule(station, split, k):
    water = petzold(station)
    found = water.hankel(k, split_angle=split)
    # Kinks at the nodes cost the plain rule 1e-10.
    assert_allclose(found, fine_sum(water, split=split, k=k), rtol=0, atol=1e-9)


@stations
def test_forward_split_is_that_of_the_adaptive_rule(station):
    water = petzold(station)
    found = water.forward_split(np.pi / 2)
    expected = phase_functions.forward_split(water, split_angle=np.pi / 2)
    # Below 1e-18 rad, where the adaptive rule ends, lies 1e-7 at AUTEC 7.
    assert_allclose(found, expected, rtol=3e-7)


@stations
def test_angles_drawn_from_the_table_have_the_cumulative_within_its_error(station):
    water = petzold(station)
    table = water.sampling_table(1024)
    share = (np.arange(5000) + 0.5) / 5000
    off = np.abs(water.cumulative(table.angle(share)) - share).max()
    # The stated error is the largest at 15 points a cell.
    assert off <= 1.05 * table.error
    assert table.error < 1e-4
    assert np.all(np.diff(table.cumulative) >= 0)


def test_transform_of_a_fine_table_is_that_of_a_plain_rule():
    pytest.importorskip("miepython")
    beads = mie.size_distribution(
        4e-6,
        number=1.0,
        wavelength=532e-9,
        particle_index=1.5,
        medium_index=1.34,
    ).phase_function
    for k in (20.0, 3e4):
        found = beads.hankel(k, split_angle=1.0)
        expected = fine_sum(beads, split=1.0, k=k)
        # The plain rule meets the kinks of 721 nodes at second order.
        assert_allclose(found, expected, rtol=0, atol=1e-7)


def test_a_pure_inverse_angle_integrates_to_sine_integrals():
    table = tabulated(NODE, value=3.0 / NODE)
    total = 2 * np.pi * special.sici(np.pi)[0]
    assert_allclose(table.integral, 3 * total, rtol=1e-11)
    assert_allclose(table.head_exponent, 1, rtol=1e-13)
    angle = np.array([1e-8, 1e-3, 0.2, 2.0])
    expected = special.sici(angle)[0] / special.sici(np.pi)[0]
    assert_allclose(table.cumulative(angle), expected, rtol=1e-10)
    assert_allclose(table(angle), 1 / (angle * total), rtol=1e-11)


def test_a_constant_table_from_0_is_isotropic():
    table = tabulated(np.linspace(0, np.pi, 5), value=np.full(5, 7.0))
    assert_allclose(table.integral, 28 * np.pi, rtol=1e-12)
    assert_allclose(table([0.0, 1.0, np.pi]), 1 / (4 * np.pi), rtol=1e-12)
    assert_allclose(table.asymmetry, 0, atol=1e-12)
    assert table.head_angle == 0
    assert table.description == "tabulated"


def test_a_dense_table_of_henyey_greenstein_tends_to_it():
    angle = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 800)])
    angle[-1] = np.pi
    model = henyey_greenstein_function(asymmetry=0.9)
    table = tabulated(angle, value=model(angle))
    # A log-log chord over 1 % of the angle is off by 1e-4 / 8 of a curvature of 3.
    assert_allclose(table.integral, 1, rtol=0, atol=4e-5)
    assert_allclose(table.asymmetry, 0.9, rtol=0, atol=4e-5)
    k = np.geomspace(0.1, 1e5, 20)
    assert_allclose(
        table.hankel(k, split_angle=1.5),
        model.hankel(k, split_angle=1.5),
        rtol=0,
        atol=8e-5,
    )
    shares = from_cumulative(angle[1:], cumulative=model.cumulative(angle[1:]))
    # A monotone cubic over 1 % of the angle; end slopes are worse.
    assert_allclose(shares(angle[5:-5]), model(angle[5:-5]), rtol=1e-3)
    assert_allclose(shares.asymmetry, 0.9, rtol=0, atol=1e-5)


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.floats(-3, 3), min_size=7, max_size=7),
    st.floats(1e-6, 1e6),
    st.floats(0, 1.9),
)
def test_the_unit_of_the_table_does_not_matter(logs, unit, head):
    value = np.exp(logs)
    one = tabulated(NODE, value=value, head_exponent=head)
    other = tabulated(NODE, value=unit * value, head_exponent=head)
    assert_allclose(other.integral, unit * one.integral, rtol=1e-12)
    angle = np.array([1e-5, 0.03, 1.0, 3.0])
    assert_allclose(other(angle), one(angle), rtol=1e-11)
    assert_allclose(one.panels.mean(np.ones_like), 1, rtol=1e-12)
    assert 0 < one.backscatter_fraction < 1


@settings(deadline=None, max_examples=25)
@given(
    st.lists(st.floats(-3, 3), min_size=7, max_size=7),
    st.floats(0.02, 3.0),
    st.floats(0, 1.9),
)
def test_a_further_point_on_the_line_changes_nothing(logs, angle, head):
    one = tabulated(NODE, value=np.exp(logs), head_exponent=head)
    nodes = np.unique(np.append(NODE, angle))
    other = tabulated(nodes, value=one(nodes), head_exponent=head)
    assert_allclose(other.integral, 1, rtol=1e-11)
    assert_allclose(other.asymmetry, one.asymmetry, rtol=0, atol=1e-11)
    assert_allclose(
        other.hankel([3.0, 300.0], split_angle=1.2),
        one.hankel([3.0, 300.0], split_angle=1.2),
        rtol=0,
        atol=1e-10,
    )


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(0.01, 1), min_size=7, max_size=7))
@example([1.0, 0.75, 0.4375, 0.3828125, 0.20430530073197564, 0.8515625, 0.013671875])
def test_shares_of_any_rising_table_are_kept(steps):
    share = np.cumsum(steps) / np.sum(steps)
    share[-1] = 1.0
    model = from_cumulative(NODE, cumulative=share)
    # Panels end at the nodes; between them the integrand is smooth.
    assert_allclose(model.cumulative(NODE), share, rtol=0, atol=1e-9)
    assert np.all(model(np.linspace(1e-4, np.pi, 200)) >= 0)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"value": -np.ones(7)}, "value must be finite and above 0"),
        ({"value": np.ones(3)}, "1-D, of one length"),
        ({"angle": NODE[::-1]}, "rise strictly and end at pi"),
        ({"angle": NODE / 2}, "end at pi rad .* extend the table first"),
        ({"angle": np.append(1e-10, NODE[1:])}, "at least 1e-9 rad"),
        ({"head_exponent": 2.0}, "exponent below 2"),
        ({"value": NODE**-2.5}, "exponent below 2"),
        ({"angle": np.append(0, NODE[1:]), "head_exponent": 1.0}, "starts at 0 rad"),
    ],
)
def test_what_is_no_table_is_refused(arguments, text):
    options = {"angle": NODE, "value": np.ones(7), **arguments}
    with pytest.raises(ValueError, match=text):
        tabulated(options.pop("angle"), **options)


def test_what_is_no_cumulative_or_station_is_refused():
    with pytest.raises(ValueError, match="rise to 1"):
        from_cumulative(NODE, cumulative=np.linspace(0.1, 0.9, 7))
    with pytest.raises(ValueError, match="at least 4 values above 0"):
        from_cumulative(np.append(0, NODE[1:]), cumulative=np.linspace(0.1, 1, 7))
    with pytest.raises(ValueError, match=r"station must be .* got 'Black Sea'"):
        petzold("Black Sea")


def test_near_0_a_table_is_a_lobe_and_beyond_a_power_law():
    node = np.array([0.0, 0.01, 0.1, 1.0, np.pi])
    value = np.array([900.0, 100.0, 5.0, 0.1, 0.05])
    table = tabulated(node, value=value)
    level = float(table(0.01)) / 100.0
    assert_allclose(table(node[1:]), level * value[1:], rtol=1e-9)
    # ln of the lobe is linear in the square of the angle: a quarter of the way at half.
    half = 900.0 * (100.0 / 900.0) ** 0.25
    assert_allclose(table(0.005), level * half, rtol=1e-9)
    assert_allclose(table(1e-9), level * 900.0, rtol=1e-9)
    # Between the others it is a power of the angle: the geometric mean of both.
    for low in (1, 2):
        middle = np.sqrt(node[low] * node[low + 1])
        expected = level * np.sqrt(value[low] * value[low + 1])
        assert_allclose(table(middle), expected, rtol=1e-9)
