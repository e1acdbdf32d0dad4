"""Times the browser page: first picture, rows, memory, and what a scan notices of it.

Run ``python benchmarks/time_view_page.py``. Ratios are to the limits of the page: below
1 is within. The times of a busy machine are too long; memory is not.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np

#: First picture of 1 million pixels [s], a row [s], memory at 10 million pixels [byte],
#: and how much longer commits may take while a page is open [1].
FIRST_PICTURE, ROW, MEMORY, SLOWER = 2.0, 0.020, 500e6, 1.05


def image_file(path: Path, side: int) -> None:
    """Write a range image of side x side pixels, with relief and noise."""
    from amulor import cube, io

    rng = np.random.default_rng(1)
    angle = np.linspace(-0.2, 0.2, side)
    azimuth, elevation = np.meshgrid(angle, -angle)
    ranges = 2 + 0.05 * np.sin(40 * azimuth) + rng.normal(0, 1e-3, azimuth.shape)
    image = cube.build(
        "range_image",
        {
            "slant_range": ranges,
            "slant_range_uncertainty": np.full(ranges.shape, 1.4e-3),
            "slant_range_common_uncertainty": np.full(ranges.shape, 1e-3),
            "intensity": 0.01 + 0.001 * rng.normal(size=ranges.shape),
            "quality_flag": np.zeros(ranges.shape, dtype=np.int16),
        },
        {"azimuth": azimuth, "elevation": elevation},
        geometry={
            "group_index": 1.36,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.array([0.07, 0.0, 0.0]),
        },
        attributes=cube.attributes(
            "range_image",
            title=f"{side} x {side} pixels",
            source="benchmarks/time_view_page.py",
            polarization="none",
            modulation_frequencies=np.array([80e6]),
        ),
    )
    io.write_cube(image, path)


def served(path: Path) -> dict[str, float]:
    """Serve a file; return times of the first picture and of all maps, and memory."""
    server = subprocess.Popen(
        [sys.executable, "-m", "amulor", "view", str(path)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    address = server.stdout.readline().split()[-1]
    try:
        begun = time.perf_counter()
        scene = json.load(urllib.request.urlopen(f"{address}scene"))
        channel = scene["channel"]

        def layer(name: str) -> int:
            return len(
                urllib.request.urlopen(f"{address}layer/{channel}/{name}").read()
            )

        layer("beams")
        layer("range")
        first = time.perf_counter() - begun
        for one in scene["layers"]:
            layer(one["name"])
        everything = time.perf_counter() - begun
        status = Path(f"/proc/{server.pid}/status").read_text()
        peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return {
            "first_picture_s": first,
            "all_maps_s": everything,
            "memory_bytes": 1024.0 * int(peak.split()[1]),
        }
    finally:
        server.terminate()
        server.wait(10)


SURVEY = """
name = "Plate"
[water]
absorption = "0.25 1/m"
scattering = "0.6 1/m"
forward_fraction = 1.0
second_moment = "0.06 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.38
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "1.5 m"]
width = "50 cm"
height = "50 cm"
reflectance = 0.1
[instrument]
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["39 MHz"]
polarizations = ["none"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2.672 deg"
radius = "2 cm"
acceptance = "0.2 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 ms"
[scan]
columns = 200
rows = 12
azimuth_span = "6 deg"
elevation_span = "1 deg"
dwell = "50 ms"
[scan.open_water]
columns = 3
rows = 2
repeats = 3
"""


def scanned() -> dict[str, float]:
    """Return the time of a row at the server, and of commits with and without it."""
    import threading

    from amulor import acquisition, simulation
    from amulor.acquisition.journal.journal import Journal
    from amulor.acquisition.plan import Key
    from amulor.acquisition.settings import Settings
    from amulor.survey import Survey
    from amulor.view.page.live import Live

    survey = Survey.from_text(SURVEY)
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "scan"
        kept: list[Live] = []
        rows: list[float] = []

        def looked(key: Key) -> None:
            if not kept:
                kept.append(Live(folder))
            if key.kind == "scan" and key.column == 199:
                kept[0].row_time = 0.0
                kept[0].look()
                if kept[0].row_time:
                    rows.append(kept[0].row_time)

        acquisition.acquire(
            survey,
            folder,
            settings=settings,
            scene=simulation.scene_light,
            acknowledged=looked,
        )
        with Journal.read(folder) as journal:
            meta, samples = journal.meta(), journal.newer(0)
        times: dict[bool, list[float]] = {True: [], False: []}
        for turn in range(6):
            watched = turn % 2 == 1
            other = Path(place) / f"commits-{turn}"
            other.mkdir()
            meta.pop("journal_schema", None)
            with Journal.create(other, meta=meta) as journal:
                part = journal.begin_segment()
                journal.commit(*samples[0][1:])
                program = [sys.executable, "-c", FOLLOW, str(other)]
                page = subprocess.Popen(program) if watched else None
                time.sleep(8 if watched else 0)
                for _, key, record in samples[1:]:
                    begun = time.perf_counter()
                    journal.commit(key, record)
                    times[watched].append(time.perf_counter() - begun)
                    time.sleep(0.001)
                journal.end_segment(part, "finished")
                if page is not None:
                    page.terminate()
                    page.wait(10)
        assert threading.active_count() < 4
    medians = {key: statistics.median(values) for key, values in times.items()}
    return {
        "row_s": statistics.median(rows),
        "commit_alone_s": medians[False],
        "commit_watched_s": medians[True],
    }


FOLLOW = """
import sys, time
from pathlib import Path
from amulor.view.page import Live
Live(Path(sys.argv[1])).start()
time.sleep(600)
"""


def main() -> None:
    """Print all figures and their ratio to limits, and add them to the history."""
    import history

    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as place:
        for side, name in ((1000, "1 million"), (3163, "10 million")):
            path = Path(place) / f"{side}.nc"
            program = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})"
            program += "; from pathlib import Path; import time_view_page as t; "
            program += f"t.image_file(Path({str(path)!r}), {side})"
            subprocess.run([sys.executable, "-c", program], check=True)
            found = served(path)
            print(f"{name} pixels, file of {path.stat().st_size / 1e6:.0f} MB")
            first = found["first_picture_s"]
            figures |= {f"{name} pixels, {key}": one for key, one in found.items()}
            print(f"  scene, beams and range  {first:.2f} s", end="")
            print(f"  ratio {first / FIRST_PICTURE:.2f}" if side == 1000 else "")
            print(f"  all maps                {found['all_maps_s']:.2f} s")
            memory = found["memory_bytes"]
            print(f"  memory at most          {memory / 1e6:.0f} MB", end="")
            print(f"  ratio {memory / MEMORY:.2f}" if side == 3163 else "")
            path.unlink()
    scan = scanned()
    print(f"a row of 200 pixels     {scan['row_s'] * 1e3:.1f} ms", end="")
    print(f"  ratio {scan['row_s'] / ROW:.2f}")
    alone, watched = scan["commit_alone_s"], scan["commit_watched_s"]
    print(f"a commit                {alone * 1e3:.3f} ms", end="")
    print(f", with a page {watched * 1e3:.3f} ms", end="")
    print(f"  ratio {watched / alone / SLOWER:.2f}")
    figures |= scan
    figures["commit with a page over alone, 1"] = watched / alone
    history.append("time_view_page", figures)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    print(f"(processor time {usage.ru_utime:.0f} s)")


if __name__ == "__main__":
    main()
