"""The report of a design says what was found, and what must give."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import paper_goal
import pytest

from amulor.design.confirm import Confirmation, Scans
from amulor.design.requirements import Requirement, Shortfall
from amulor.design.sensitivity import Sensitivity, Uncertain
from amulor.design.trade import Trade, Turn
from amulor.view.design import report

pytestmark = pytest.mark.slow


def _reasons(said: tuple[str, ...] = ()) -> report.Reasons:
    time = np.array([100.0, 200.0, 400.0])
    scans = Scans(
        distance=1.5, predicted=2e-3, achieved=2.5e-3, ratio=1.25, ratio_error=0.02,
        offset=1e-5, offset_error=2e-5, residual_bias=0.0, ranges=1728,
    )  # fmt: skip
    numbers = tuple(
        Uncertain(axis=name, label=name, low=1.0, high=2.0, stated=True)
        for name in ("attenuation", "reflectance")
    )
    return report.Reasons(
        trade=Trade(
            error=np.array([3e-3, 2e-3, 1e-3]),
            scan_time=time,
            top_frequency=39e6 * time,
            best=1,
        ),
        sensitivity=Sensitivity(
            numbers=numbers,
            total=np.array([0.3, 0.7]),
            total_error=np.full(2, 0.02),
            first=np.array([0.3, 0.7]),
            first_error=np.full(2, 0.02),
            spread=np.log(2),
        ),
        turns=(
            Turn(label="phase floor", value=1e-3, unit="rad", turns_at=3e-3, factor=3),
            Turn(
                label="dark counts", value=1e3, unit="1/s", turns_at=None, factor=None
            ),
        ),
        confirmations=(
            Confirmation(name="best", scans=scans, photons=None, late=0.0, said=said),
        ),
    )


def _plain(path: Path) -> str:
    return " ".join(re.sub(r"<[^>]+>|data:image[^\"]+", " ", path.read_text()).split())


def test_reasons_are_written_down(tmp_path: Path) -> None:
    path = tmp_path / "r.html"
    report.write(path, paper_goal.choice(), _reasons(("best: the light differs",)))
    text = _plain(path)
    assert "depends most on: reflectance" in text
    assert "factor of 2.00" in text
    assert "phase floor 0.001 rad 0.003 rad 3" in text
    assert "dark counts 1e+03 1/s not within a factor of 10" in text
    assert "best: the light differs." in text
    # A ratio that does not hold is marked.
    assert '<td class="warning">1.250 ± 0.020</td>' in path.read_text()


def test_an_impossible_goal_names_what_must_give_first(tmp_path: Path) -> None:
    short = Shortfall(
        requirement="scan time", value=1200.0, limit=600.0, factor=2.0, unit="s",
        alone=True, text="scan time: 20 min in place of 10 min would do alone",
    )  # fmt: skip
    found = replace(paper_goal.choice(), impossible=(short,), runner_up=None)
    path = tmp_path / "r.html"
    report.write(path, found, replace(_reasons(), confirmations=()))
    text = _plain(path)
    assert "No instrument of these components does it" in text
    assert "Requirement to relax: scan time: 20 min in place of 10 min" in text
    assert "Build this" not in text
    assert "Assumptions that would change the answer" not in text
    assert "Confirmed" not in text
    assert path.read_text().count("data:image/png") == 3


def test_a_margin_beyond_all_measure_is_no_number() -> None:
    def required(margin: float) -> Requirement:
        return Requirement(
            name="total error at 2 m", met=True, value=1e-3 / margin, limit=1e-3,
            margin=margin, unit="m", binding="reference",
        )  # fmt: skip

    margins = (1.234, 9.51e274, np.inf)
    choice = SimpleNamespace(requirements=[required(margin) for margin in margins])
    table = report._requirements(choice)
    assert [row[4] for row in table.rows] == ["1.23", "above 1000", "above 1000"]
