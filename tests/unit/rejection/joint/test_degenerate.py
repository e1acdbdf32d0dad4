"""Joint estimation where the samples settle nothing: flagged, never an exception."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.rejection import joint
from amulor.simulation import simulate
from amulor.simulation.models import SmallAngleModel
from amulor.studies.trust.scenes import models
from amulor.studies.trust.surveys import survey

WATER = {"absorption": 0.15, "scattering": 0.35, "asymmetry": 0.95, "split_angle": 15.0}


@pytest.mark.parametrize(
    ("seed", "has_shots"),
    [
        (0, True),
        pytest.param(1, True, marks=pytest.mark.slow),
        (1, False),
        pytest.param(5, False, marks=pytest.mark.slow),
    ],
)
def test_empty_water_of_another_model_ends_without_a_target(
    seed: int, has_shots: bool
) -> None:
    # The echo of a candidate can shrink to nothing while its path is looked for.
    scan = survey(
        2,
        water=WATER,
        pairs=("VV",),
        columns=8,
        rows=6,
        shot_columns=3,
        shot_rows=1,
        repeats=4,
    )
    cube = simulate(scan, rng=seed, model=SmallAngleModel())
    if not has_shots:
        names = [name for name in cube.data_vars if str(name).startswith("open_water")]
        cube = cube.drop_vars(names)
    found = joint(cube)
    trusted = (found["quality_flag"].values == 0) & np.isfinite(
        found["joint_slant_range"].values
    )
    # Of 48 pixels 0.05 lie beyond five standard errors by chance.
    assert np.count_nonzero(trusted.all(axis=(0, 1))) == 0


def test_water_without_a_target_and_without_shots_shows_no_wall() -> None:
    case = models.empty(2, 1)
    names = [n for n in case.samples.data_vars if str(n).startswith("open_water")]
    found = joint(case.samples.drop_vars(names), interval=case.interval)
    assert not np.isfinite(found["joint_slant_range"].values).any()
