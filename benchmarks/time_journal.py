"""Part of the time of a scan that integrates, on the wall and on a real disk.

Paired: each commit waited for, and written while the next dwell is taken. Devices are
the embedded simulated ones in real time, so that what is left is waiting for them, this
computer, and its disk.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from amulor import Survey, acquisition
from amulor.acquisition import run as keeper
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.simulation import scene_light

EXAMPLE = Path(__file__).parents[1] / "src/amulor/survey/examples/ladder_clear.toml"


def measured(survey: Survey, place: Path, *, slow: float) -> float:
    """Return the time of one sample on the wall [s]."""
    settings = Settings.model_validate(
        {
            "procedure": {"output_filter": "known", "dark_readings": 1},
            "simulation": {"speed": 1.0},
        }
    )
    before, keeper.SLOW = keeper.SLOW, slow
    told: list[float] = []
    try:
        with tempfile.TemporaryDirectory(dir=place) as folder:
            acquisition.acquire(
                survey,
                Path(folder),
                settings=settings,
                scene=scene_light,
                acknowledged=lambda key: (
                    told.append(time.perf_counter()) if key.kind == SCAN else None
                ),
            )
    finally:
        keeper.SLOW = before
    return (told[-2] - told[5]) / (len(told) - 7)


def main() -> None:
    """Print both ways beside each other, and add the figures to the history."""
    import history

    place = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.gettempdir())
    base = Survey.from_toml(EXAMPLE)
    print(f"journal in {place}\ndwell    waited for        beside the next dwell")
    figures: dict[str, float] = {}
    for dwell, constant in (("10 ms", "2 ms"), ("100 ms", "20 ms")):
        survey = base.with_(
            {
                "scan.columns": 40,
                "scan.rows": 4,
                "scan.azimuth_span": "1.52 deg",
                "scan.elevation_span": "0.11 deg",
                "scan.order": "serpentine",
                "scan.dwell": dwell,
                "scan.open_water.repeats": 1,
                "instrument.lock_in.time_constant": constant,
                "instrument.polarizations": ["none"],
                "instrument.modulation_frequencies": ["39 MHz"],
            }
        )
        walls = [measured(survey, place, slow=slow) for slow in (1e9, keeper.SLOW)]
        parts = [survey.scan.dwell / wall for wall in walls]
        shown = [
            f"{part:5.1%} ({1e3 * wall:.1f} ms)"
            for part, wall in zip(parts, walls, strict=True)
        ]
        figures[f"waited for, dwell {dwell}"] = parts[0]
        figures[f"beside the next dwell, dwell {dwell}"] = parts[1]
        print(f"{dwell:<9}{shown[0]:<18}{shown[1]}")
    history.append("time_journal", figures)


if __name__ == "__main__":
    main()
