"""Conversation with an SR865A and stages: by questions, from its buffer, without stops.

Paired: all ways take the same survey with the same simulated instruments over links
whose questions take a stated time. All times are those of the instruments' clock, so
that what other programs do on this computer does not count.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from amulor import Survey, acquisition
from amulor.acquisition import run as keeper
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import LockInGate, simulated_bench
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.pi_gcs import PiController, PiScanner, PiTargetStage
from amulor.acquisition.drivers.stanford_sr865a import Sr865a
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.uncertainty import input_variance_ratio
from amulor.simulation import scene_light

# By the clock of the devices a commit takes no time; none is put off.
keeper.SLOW = float("inf")
EXAMPLE = Path(__file__).parents[1] / "src/amulor/survey/examples/ladder_clear.toml"


class Wire:
    """A link whose packets take a time each way [s], and that counts its questions."""

    address = "a wire"

    def __init__(
        self, answer: Callable[[str], list[str]], clock: VirtualClock, late: float
    ) -> None:
        self._answer, self._clock, self._late = answer, clock, late
        self.questions = 0

    def send(self, line: str) -> None:
        """Send one line that has no answer."""
        self._clock.sleep(self._late)
        self._answer(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        """Send lines and return their answers."""
        self.questions += 1
        self._clock.sleep(self._late)
        found = [text for one in line.split("\n") for text in self._answer(one)]
        self._clock.sleep(self._late)
        return found

    def reopen(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def measured(
    survey: Survey, late: float, readings: str | None, mode: str | None = None
) -> tuple[float, float, float, float]:
    """Return questions a sample, conversation a sample [s], readings, efficiency."""
    settings = Settings.model_validate(
        {
            "procedure": {
                "output_filter": "known",
                "dark_readings": 1,
                "readings": readings,
                "mode": mode,
            }
        }
    )
    clock = VirtualClock()
    bench = simulated_bench(survey, settings, scene=scene_light, clock=clock)
    wires = [
        Wire(SimulatedSr865a(bench).answer, clock, late),
        Wire(SimulatedPiController(bench, settings).answer, clock, late),
    ]
    lock_in = Sr865a(
        wires[0], mean_output_input=1, modulation_amplitude=0.5, clock=clock
    )
    stages = PiController(wires[1], clock=clock)
    devices = Devices(
        laser=LockInGate(lock_in, settings.laser),
        lock_in=lock_in,
        scanner=PiScanner(stages, settings.scanner),
        launch=None,
        analyser=None,
        target=PiTargetStage(stages, settings.target),
        clock=clock,
    )
    told: list[tuple[float, int]] = []
    with tempfile.TemporaryDirectory() as folder:
        acquisition.acquire(
            survey,
            Path(folder),
            settings=settings,
            devices=devices,
            acknowledged=lambda key: (
                told.append((clock.now(), sum(wire.questions for wire in wires)))
                if key.kind == SCAN
                else None
            ),
        )
        with Journal.read(Path(folder)) as journal:
            record = [record for _, record in journal.samples(SCAN)][-1]
    # From the end of the first row, since one without stops is told at once.
    count = len(told) - survey.scan.columns
    (start, before), (end, after) = told[survey.scan.columns - 1], told[-1]
    wall = (end - start) / count
    constant = survey.instrument.lock_in.time_constant
    interval = record.interval or survey.scan.dwell / record.readings
    ratio = float(input_variance_ratio(record.readings, spacing=interval / constant))
    return (
        (after - before) / count,
        wall - record.readings * interval,
        record.readings,
        2 * constant / ratio / wall,
    )


def main() -> None:
    """Print the two ways beside each other, and add the figures to the history."""
    import history

    base = Survey.from_toml(EXAMPLE)
    print(
        "dwell   constant wire     questions     conversation         readings/s  part"
    )
    figures: dict[str, float] = {}
    for dwell, constant in ((10, 1), (100, 10)):
        survey = base.with_(
            {
                "scan.columns": 20,
                "scan.rows": 5,
                "scan.azimuth_span": "0.2 deg",
                "scan.elevation_span": "0.05 deg",
                "scan.order": "serpentine",
                "scan.dwell": f"{dwell} ms",
                "scan.open_water.repeats": 1,
                "instrument.polarizations": ["none"],
                "instrument.modulation_frequencies": ["3.9 MHz"],
                "instrument.lock_in.time_constant": f"{constant} ms",
            }
        )
        for late in (1e-4, 1e-3):
            old, new = (measured(survey, late, way) for way in (None, "buffer"))
            swept = measured(survey, late, "buffer", "continuous")
            rates = [way[2] / way[1] for way in (old, new)]
            name = (
                f"dwell {dwell} ms, constant {constant} ms, {late * 1e3:g} ms each way"
            )
            figures[f"samples of the conversation, times, {name}"] = old[1] / new[1]
            figures[f"readings of the conversation, times, {name}"] = (
                rates[1] / rates[0]
            )
            figures[f"integration over time, {name}"] = new[3]
            figures[f"integration over time without stops, {name}"] = swept[3]
            times = f"{old[1] * 1e3:5.2f} -> {new[1] * 1e3:4.2f} ms"
            print(
                f"{dwell:>3} ms  {constant:>3} ms   {late * 1e3:.1f} ms   "
                f"{old[0]:4.1f} -> {new[0]:3.1f}   "
                f"{times} ({old[1] / new[1]:.1f} x)   {rates[1] / rates[0]:.1f} x"
                f"   {old[3]:.1%} -> {new[3]:.1%} -> {swept[3]:.1%}"
            )
    history.append("time_conversation", figures)


if __name__ == "__main__":
    main()
