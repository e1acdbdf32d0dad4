"""Effective integration over the time of a scan, by the clock of simulated devices."""

from __future__ import annotations

import tempfile
from pathlib import Path

from amulor import Survey, acquisition
from amulor.acquisition import run as keeper
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.acquisition.uncertainty import input_variance_ratio, variance_ratio
from amulor.simulation import scene_light

# By the clock of the devices a commit takes no time; none is put off.
keeper.SLOW = float("inf")
EXAMPLE = Path(__file__).parents[1] / "src/amulor/survey/examples/ladder_clear.toml"


def measured(survey: Survey, output_filter: str | None) -> tuple[float, float]:
    """Return effective integration over time [1], and the time of one sample [s]."""
    settings = Settings.model_validate({"procedure": {"output_filter": output_filter}})
    devices = connect(survey, settings, scene=scene_light)
    told: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        acquisition.acquire(
            survey,
            Path(folder),
            settings=settings,
            devices=devices,
            acknowledged=lambda key: (
                told.append(devices.clock.now()) if key.kind == SCAN else None
            ),
        )
        with Journal.read(Path(folder)) as journal:
            _, record = next(iter(journal.samples(SCAN)))
    constant = survey.instrument.lock_in.time_constant
    half = len(told) // 2
    wall = (told[half - 1] - told[0]) / (half - 1)
    length = survey.scan.dwell / record.readings / constant
    ratio = (
        input_variance_ratio(record.readings, spacing=length)
        if output_filter
        else variance_ratio(record.readings, spacing=1.0)
    )
    return 2 * constant / float(ratio) / wall, wall


def main() -> None:
    """Print the two ways beside each other, and add the figures to the history."""
    import history

    base = Survey.from_toml(EXAMPLE)
    print("dwell    constant  settled          known filter")
    figures: dict[str, float] = {}
    for dwell, constant in (
        ("10 ms", "2 ms"),
        ("100 ms", "20 ms"),
        ("100 ms", "10 ms"),
    ):
        survey = base.with_(
            {
                "scan.columns": 40,
                "scan.rows": 10,
                "scan.azimuth_span": "1.52 deg",
                "scan.elevation_span": "0.34 deg",
                "scan.order": "serpentine",
                "scan.dwell": dwell,
                "instrument.lock_in.time_constant": constant,
                "scan.open_water.repeats": 2,
            }
        )
        both = (measured(survey, None), measured(survey, "known"))
        shown = [f"{part:5.1%} ({1e3 * wall:.1f} ms)" for part, wall in both]
        for name, (part, _) in zip(("settled", "known filter"), both, strict=True):
            figures[f"{name}, dwell {dwell}, constant {constant}"] = part
        print(f"{dwell:<9}{constant:<10}{shown[0]:<17}{shown[1]}")
    history.append("time_acquisition", figures)


if __name__ == "__main__":
    main()
