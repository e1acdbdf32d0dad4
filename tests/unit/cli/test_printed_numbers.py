"""Numbers that commands print: those of their results, each in its unit.

Each result has a value of its own in every field, so that no line can show another's.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from amulor import io, rejection
from amulor.cli import calibrate, design, water


def test_the_fit_of_the_water(printed, monkeypatch, tmp_path) -> None:
    result = SimpleNamespace(
        names=("reduced_attenuation", "spread", "forward_scattering"),
        identified=(True, True, False),
        reduced_attenuation=0.4123, reduced_attenuation_uncertainty=0.0123,
        spread=0.02345, spread_uncertainty=0.00234, forward_scattering=1.2345,
        forward_scattering_uncertainty=0.345, depth_of_maximum=0.4567,
        depth_of_maximum_uncertainty=0.0456, cut_off=56.78e6, cut_off_uncertainty=5.6e6,
        fluctuation=0.0234, misfit=1.056,
    )  # fmt: skip
    monkeypatch.setattr(water, "check_inputs", lambda *_: None)
    monkeypatch.setattr(io, "read_cube", lambda path: path)
    monkeypatch.setattr(rejection, "water_fit", lambda cube, *, no_target: result)
    water.fit(tmp_path / "a.nc")
    assert printed() == [
        "reduced attenuation k' 0.4123 +- 0.012 1/m",
        "spread b_f <theta^2> 0.02345 +- 0.0023 rad^2/m",
        "forward scattering b_f 1.234 +- 0.34 1/m (not settled by these data)",
        "depth of the maximum 0.4567 +- 0.046 m",
        "cut-off 56.78 +- 5.6 MHz",
        "fluctuation 2.34%",
        "misfit 1.06 (1 if the model is right)",
    ]


def _choice(**changes: object) -> SimpleNamespace:
    fields: dict[str, object] = {
        "parameters": "P", "error": 3.456e-3, "worst_distance": 2.345, "share": 0.87,
        "scan_time": 234.0, "cost": 0.0, "binding": "shot_noise", "requirements": (),
        "between": SimpleNamespace(error=3.4e-3, distance=1.7), "shares": None,
        "lines": None,
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def _recommended(best: SimpleNamespace, **changes: object) -> SimpleNamespace:
    goal = SimpleNamespace(name="Tank", accuracy=SimpleNamespace(total_error=5e-3))
    fields: dict[str, object] = {
        "goal": goal, "looked_at": 1234, "impossible": (), "best": best,
        "bounds": (), "runner_up": None,
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    from amulor.design import requirements

    monkeypatch.setattr(requirements, "parameters_text", lambda value: f"<{value}>")
    monkeypatch.setattr(
        requirements, "quantity_text", lambda name, value: f"{value:g} {name[0]}"
    )


@pytest.mark.usefixtures("plain")
def test_a_recommendation(printed, tmp_path) -> None:
    best = _choice(
        cost=456.0, shares=SimpleNamespace(error=3.1e-3, even=3.5e-3, share=(0.3, 0.7)),
        requirements=(
            SimpleNamespace(
                name="range", met=True, value=1.5, limit=2.5, binding="", margin=1
            ),
            SimpleNamespace(
                name="time", met=False, value=9.0, limit=7.0, binding="dwell_time",
                margin=-1,
            ),
        ),
        between=SimpleNamespace(error=6.78e-3, distance=1.789),
    )  # fmt: skip
    found = _recommended(
        best, bounds=(SimpleNamespace(text="B"),), runner_up=_choice(error=4.5e-3)
    )
    files = [tmp_path / name for name in ("best.toml", "second.toml", "third.toml")]
    design._print(found, files)
    lines = printed()
    assert lines[0] == "Tank: 1234 candidates"
    assert lines[1] == "best: <P>"
    assert lines[2] == (
        "total error 3.46 mm of 5 mm at 2.345 m, accuracy met in 87% of the draws; "
        "3.9 min, price 456; largest term: shot noise"
    )
    assert lines[3].startswith("dwell shared 30 : 70 between the frequencies: 3.1 mm")
    assert {"met: range 1.5 r of 2.5 r", "MISSED: time 9 t of 7 t; dwell time"} <= {
        *lines
    }
    assert "bound: B" in lines
    (note,) = [line for line in lines if line.startswith("note:")]
    assert "the error is 6.78 mm at 1.79 m" in note
    assert any(line.startswith("total error 4.5 mm of 5 mm") for line in lines)
    written = [line for line in lines if line.endswith(": survey written")]
    assert written == [f"{file}: survey written" for file in files[:2]]


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(
    ("error", "even", "between", "parts"),
    [(3.0e-3, 3.5e-3, 5.2e-3, {"dwell", "note:"}), (3.5e-3, 3.5e-3, 5e-3, set())],
)
def test_a_note_of_a_recommendation_needs_a_reason(
    printed, error, even, between, parts
) -> None:
    best = _choice(
        shares=SimpleNamespace(error=error, even=even, share=(0.5, 0.5)),
        between=SimpleNamespace(error=between, distance=1.0),
    )
    design._print(_recommended(best), [])
    words = {line.split()[0] for line in printed()}
    assert words & {"dwell", "note:"} == parts
    impossible = (SimpleNamespace(text="I"),)
    design._print(_recommended(best, impossible=impossible), [])
    lines = printed()
    assert lines[1] == "impossible: I"
    assert lines[2] == "nearest to the goal: <P>"
    assert "price" not in lines[3]


def test_reasons_for_a_recommendation(printed, tmp_path) -> None:
    import numpy as np

    total = np.array([0.1, 0.67, 0.2])
    reasons = SimpleNamespace(
        sensitivity=SimpleNamespace(
            total=total, largest=SimpleNamespace(label="scattering")
        ),
        turns=(
            SimpleNamespace(label="the price", factor=1.234),
            SimpleNamespace(label="the rest", factor=None),
        ),
        confirmations=(
            SimpleNamespace(
                name="best", said=("by much",),
                scans=SimpleNamespace(ranges=480, ratio=1.0234, ratio_error=0.0345),
            ),
        ),
    )  # fmt: skip
    design.print_reasons(SimpleNamespace(), reasons, tmp_path / "a.html", None)
    assert printed() == [
        "measure first: scattering (67% of the variance of the error)",
        "the runner-up wins with the price at 1.23 times what is stated",
        "confirmed: best, 480 simulated ranges scatter by 1.023 ± 0.035 of what is "
        "predicted",
        "differs: by much",
        f"{tmp_path / 'a.html'}: written",
    ]
    design.print_reasons(SimpleNamespace(), None, None, None)
    assert printed() == []


def test_a_calibration_by_temperatures_and_plates(printed) -> None:
    made = SimpleNamespace(
        temperature=(
            SimpleNamespace(
                modulation_frequency=39e6, phase_per_degree=4.9e-3, uncertainty=0.12e-3
            ),
        ),
        reference_temperature=21.34,
        frequencies=(
            SimpleNamespace(
                modulation_frequency=39e6, amplitudes=(1.5e-3, 25e-3),
                phases=(0.1234, -0.4567), phase_uncertainties=(0.0012, 0.0034),
            ),
            SimpleNamespace(
                modulation_frequency=50e6, amplitudes=(2e-3,), phases=(1.25,),
                phase_uncertainties=None,
            ),
        ),
        delay_uncertainty=12.3e-12,
        filters=(
            SimpleNamespace(density=0.5, transmission=0.3162, uncertainty=0.0021),
        ),
        gain_change=-0.0123, gain_change_uncertainty=0.0045, group_index=1.37891,
        group_index_uncertainty=0.00123,
    )  # fmt: skip
    calibrate._print_temperature(made)
    text = " ".join(printed())
    # 4.9 mrad at 39 MHz are 20.0 ps.
    delay = 4.9e-3 / (2 * math.pi * 39e6) * 1e12
    for part in ("39 MHz", "+4.900", "0.120", f"{delay:+.2f}", "refer to 21.3 degC"):
        assert part in text
    calibrate._print_phases(made)
    text = " ".join(printed())
    for part in (
        "1.5 +0.1234 0.0012", "25 -0.4567 0.0034", "50 MHz 2 +1.2500 nan",
        "uncertainty of the delay: 12 ps", "0.5 0.3162 0.0021",
        "largest amplitude: -1.2 +- 0.45 %",
        "group index by the distances: 1.3789 +- 0.0012 (not applied)",
    ):  # fmt: skip
        assert part in text, part
    made.delay_uncertainty, made.group_index_uncertainty, made.filters = None, None, ()
    made.gain_change = None
    calibrate._print_phases(made)
    text = " ".join(printed())
    assert "uncertainty of the delay unknown: state --distance-uncertainty" in text
    assert "by the distances: 1.3789 (not applied)" in text
    assert "change of the gain" not in text
    made.temperature, made.frequencies = (), ()
    calibrate._print_temperature(made)
    calibrate._print_phases(made)
    assert printed() == []
