"""A scan with all that goes wrong in a day, and stated errors that cover the truth."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition, imaging, rejection
from amulor.acquisition import plan
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.cube import UNUSABLE
from amulor.errors import InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey

#: The interlock opens at this reading, for as many of them as dark readings follow.
OPENS, LASTS = 400, 30
#: Change of the water in one second: 3 % over the scan where nothing else runs, and
#: more where it takes longer.
DRIFT = 1.5e-4


def count(folder: Path) -> int:
    """Return how many samples are in a journal."""
    if not (folder / FILE_NAME).exists():
        return 0
    with Journal.read(folder) as journal:
        return journal.count()


def lose_power(survey: Survey, folder: Path, settings: Settings, after: int) -> None:
    """Go on in a process of its own, and kill it in the middle."""
    reached = count(folder) + after
    child = os.fork()
    if child == 0:
        try:
            acquisition.acquire(survey, folder, settings=settings, resume=True)
        except BaseException as error:
            os.write(2, f"{error}\n".encode())
        finally:
            os._exit(1)
    end = time.monotonic() + 240
    while count(folder) < reached and time.monotonic() < end:
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "the scan ended before it lost its power"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="SIGKILL and fork are needed")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_day_in_which_all_goes_wrong_ends_in_a_true_range_image(
    plate, folder
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 10,
            "scan.rows": 6,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 6},
            "instrument.modulation_frequencies": ["30 MHz", "41 MHz"],
            "instrument.polarizations": ["VV", "VH", "HV", "HH"],
        }
    )
    base = Settings.model_validate(
        {
            "procedure": {"references": 3, "dark_readings": 5},
            "simulation": {
                "faults": [f"interlock@{OPENS}x{LASTS}"],
                "water_drift": DRIFT,
                "position_error": 2e-5,
            },
        }
    )
    place = folder / "scan"
    with rehearse(survey, base, scene=scene_light, speed=50) as rehearsal:
        settings = rehearsal.settings
        # Somebody opens the lid.
        with pytest.raises(InstrumentError, match="interlock of the laser is open"):
            acquisition.acquire(survey, place, settings=settings)
        assert not rehearsal.bench.laser_on
        with Journal.read(place) as journal:
            kept = [record for _, record in journal.samples(SCAN)]
        assert not any(record.flags & SampleFlag.NO_LIGHT for record in kept)
        # The lid is closed, and the mains fail.
        lose_power(survey, place, settings, after=150)
        before = count(place)
        outcome = acquisition.acquire(survey, place, settings=settings, resume=True)
        assert outcome.finished
        assert not rehearsal.bench.laser_on
        changed = DRIFT * (rehearsal.bench.clock.now() - rehearsal.bench._begun)
    assert 0.01 < changed < 0.5
    with Journal.read(place) as journal:
        keys = journal.keys()
        assert journal.count() == len(keys) > before
        assert {step.key for step in plan.steps(survey, settings.procedure)} <= keys
        targets = {record.target for _, record in journal.samples(SCAN)}
        reasons = [part["reason"] for part in journal.segments()]
        cube = acquisition.build(journal)
    assert "interlock" in reasons[0]
    assert reasons[1:] == ["broken off without notice", "finished"]
    # The stage went out and in again for each reference, and stood where it should.
    assert targets == {0.0}
    assert np.isfinite(cube["in_phase"]).all()
    truth = simulate(survey, rng=1)["truth_slant_range"].values
    target = rejection.open_water(cube)
    image = imaging.range_image(target.sel(polarization=["VH"]))
    good = (image["quality_flag"].values & UNUSABLE) == 0
    assert good.mean() > 0.9
    error = (image["slant_range"].values - truth)[good]
    stated = image["slant_range_uncertainty"].values[good]
    print(
        f"errors {error.mean() * 1e3:+.1f} +- {error.std() * 1e3:.1f} mm, stated "
        f"{stated.mean() * 1e3:.1f} mm, water changed by {changed:.0%}"
    )
    # 95 % of normal errors are within 1.96; of 30 pixels 4 % by chance, two of them,
    # and part of the errors is common to all.
    assert np.mean(np.abs(error) < 2 * stated) > 0.85
    assert np.sqrt(np.mean((error / stated) ** 2)) < 1.4
