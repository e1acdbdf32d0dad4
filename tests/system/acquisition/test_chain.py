"""What was acquired comes out as what is simulated: rejected, imaged and exported."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from shared_light import scene_light

from amulor import acquisition, imaging, rejection
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.cli import main
from amulor.cube import UNUSABLE
from amulor.io import read_cube
from amulor.simulation import simulate
from amulor.survey import Survey

#: Columns, rows and repeats of the open-water shots.
PLANS = [(2, 2, 3), (3, 2, 4), (5, 3, 4), (2, 3, 6), (9, 3, 10)]
JITTERS = ["0 rad", "2e-6 rad", "5e-5 rad"]
#: Pairs of both that are not left to the studies.
CHECKED = {
    ((2, 2, 3), "0 rad"),
    ((5, 3, 4), "2e-6 rad"),
    ((2, 3, 6), "5e-5 rad"),
    ((9, 3, 10), "5e-5 rad"),
}


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a range image is worth."""

    trusted: float
    error: float
    pulls: float
    drift_uncertainty: float


def quality(cube: xr.Dataset, truth: np.ndarray, channel: str = "VH") -> Quality:
    """Return what the range image of a cube is worth, the truth being known."""
    target = rejection.open_water(cube)
    image = imaging.range_image(target.sel(polarization=[channel]))
    good = (image["quality_flag"].values & UNUSABLE) == 0
    off = (image["slant_range"].values - truth)[good]
    stated = image["slant_range_uncertainty"].values[good]
    return Quality(
        trusted=float(good.mean()),
        error=float(np.sqrt(np.mean(off**2))),
        pulls=float(np.sqrt(np.mean((off / stated) ** 2))),
        drift_uncertainty=float(target.attrs["open_water_drift_uncertainty"].max()),
    )


class Broken:
    """Ends a scan before some sample."""

    def __init__(self, at: int) -> None:
        self.left = at

    def pause_wanted(self) -> bool:
        self.left -= 1
        return self.left == -1

    def go_on(self) -> bool:
        return False


def acquired(
    survey: Survey, folder: Path, jitter: str, *, breaks: int, **more: Any
) -> xr.Dataset:
    """Return the cube of a scan that was broken off some times."""
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2, "position_tolerance": "1 mrad"},
            "simulation": {"position_error": jitter},
            **more,
        },
        context={"from_text": True},
    )
    size = survey.scan.rows * survey.scan.columns
    for number in range(breaks):
        acquisition.acquire(
            survey, folder, settings=settings, scene=scene_light,
            resume=number > 0, control=Broken(size // 2 + 10),
        )  # fmt: skip
    outcome = acquisition.acquire(
        survey, folder, settings=settings, scene=scene_light, resume=breaks > 0
    )
    assert outcome.finished
    with Journal.read(folder) as journal:
        return acquisition.build(journal)


def planned(make: Callable[..., Survey], plan: tuple[int, int, int], size: int):
    """Return a survey with a plan of shots."""
    columns, rows, repeats = plan
    shots = {"columns": columns, "rows": rows, "repeats": repeats}
    survey = make(columns=2 * size, rows=size)
    return survey.with_({"scan.open_water": shots})


def compare(survey: Survey, cube: xr.Dataset, channel: str = "VH") -> None:
    """Compare an acquired cube with simulated ones of its survey."""
    runs = [simulate(survey, rng=seed) for seed in range(3)]
    truth = runs[0]["truth_slant_range"].values
    expected = [quality(run, truth, channel) for run in runs]
    found = quality(cube, truth, channel)
    trusted = [one.trusted for one in expected]
    pixels = truth.size
    # A binomial fraction, five standard errors wide, beside what the runs show.
    room = 5 * np.sqrt(
        max(np.mean(trusted) * (1 - np.mean(trusted)), 1 / pixels) / pixels
    )
    assert found.trusted >= min(trusted) - room
    # The error of the reference is shared by all pixels: among simulated runs of the
    # plan of fewest shots it makes errors that differ by a factor of about 1.5.
    largest = max(one.error for one in expected)
    assert found.error < 1.6 * largest
    assert found.pulls < 1.6 * max(1.0, *(one.pulls for one in expected))
    assert np.isfinite(found.drift_uncertainty)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "jitter", "breaks"),
    [((2, 2, 3), "5e-5 rad", 1)],
)
def test_a_scan_by_a_scanner_that_jitters_is_worth_what_a_simulated_one_is(
    sized, folder, plan, jitter, breaks
) -> None:
    survey = planned(sized, plan, 6)
    compare(survey, acquired(survey, folder, jitter, breaks=breaks))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "jitter"),
    [
        pytest.param(
            *each, marks=() if each in CHECKED else pytest.mark.study, id=str(each)
        )
        for each in product(PLANS, JITTERS)
    ],
)
def test_plans_of_shots_and_jitters_with_breaks(sized, folder, plan, jitter) -> None:
    survey = planned(sized, plan, 8)
    compare(survey, acquired(survey, folder, jitter, breaks=2))


SMALL = {
    "scan.columns": 14,
    "scan.rows": 8,
    "scan.open_water": {"columns": 3, "rows": 2, "repeats": 6},
}
CIRCULAR = {"R": "45 deg", "L": "135 deg"}


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "change", "channel"),
    [
        ("ladder_clear", {}, "VH"),
        ("ladder_milk", {}, "VH"),
        ("plate", {"instrument.modulation_frequencies": ["30 MHz", "41 MHz"]}, "VH"),
        ("plate", {"instrument.polarizations": ["RR", "RL"]}, "RR"),
        ("plate", {"scan.moves": "both"}, "VH"),
        ("plate", {"scan.order": "serpentine", "water.scattering": "0.2 1/m"}, "VV"),
    ],
)
def test_six_surveys_are_worth_as_much_as_their_simulations(
    plate, folder, name, change, channel
) -> None:
    if name == "plate":
        survey = plate
    else:
        examples = files("amulor.survey") / "examples"
        survey = Survey.from_text((examples / f"{name}.toml").read_text("utf-8"))
    survey = survey.with_({**SMALL, **change})
    angles = {"V": "0 deg", "H": "90 deg", **CIRCULAR}
    more = {"launch": {"angles": angles}, "analyser": {"angles": angles}}
    compare(survey, acquired(survey, folder, "2e-5 rad", breaks=2, **more), channel)


@pytest.mark.slow
def test_commands_take_an_acquired_cube_to_a_point_cloud(
    sized, folder, monkeypatch
) -> None:
    monkeypatch.chdir(folder)
    today = datetime.datetime.now(datetime.UTC).date()
    survey = planned(sized, (2, 2, 3), 5).with_(
        {
            "calibration": {
                "date": (today - datetime.timedelta(days=50)).isoformat(),
                "delay_uncertainty": "1 ps",
                "delay_growth": "2 ps",
            }
        }
    )
    Path("tank.toml").write_text(survey.to_toml())
    for words in (
        ["acquire", "tank.toml", "-o", "scan"],
        ["reject", "scan/cube.nc", "--method", "open-water", "-o", "target.nc"],
        ["image", "target.nc", "--polarization", "VH", "-o", "range.nc"],
        ["export", "range.nc", "-o", "cloud.ply"],
    ):
        assert main(words) == 0
    image = read_cube("range.nc")
    # The scan is of now, so the delay is known to 0.1 ns, two ways of 15 mm in vacuum.
    aged = np.nanmedian(image["slant_range_uncertainty_delay"].values)
    assert aged == pytest.approx(0.0998 * 299.792458e-3 / 2 / 1.38, rel=0.04)
    good = (image["quality_flag"].values & UNUSABLE) == 0
    # The plate fills the scan: with shots that repeat, every pixel sees it.
    assert good.mean() > 0.9
    lines = Path("cloud.ply").read_bytes().split(b"end_header")[0].decode().split("\n")
    (count,) = [int(line.split()[2]) for line in lines if "element vertex" in line]
    assert count == good.sum()
