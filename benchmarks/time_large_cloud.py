"""Time and memory of the browser page for large LAZ clouds.

Run ``python benchmarks/time_large_cloud.py``. Memory must not grow with the number of
points beyond the 4 million that the page draws: the last line states the ratio.
``--docs`` writes the table to docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from time_page_frames import DOCS, FLAGS

COUNTS = (4_000_000, 20_000_000)
PART = 1_000_000
TURN = """async () => {
  Element.prototype.setPointerCapture = () => {};
  const canvas = document.getElementById("space");
  const box = canvas.getBoundingClientRect();
  const send = (type, share) => canvas.dispatchEvent(new PointerEvent(type, {
    pointerId: 1, pointerType: "mouse", bubbles: true, isPrimary: true, buttons: 1,
    clientX: box.left + (0.3 + 0.4 * share) * box.width, clientY: box.top + 200,
  }));
  const frame = () => new Promise(requestAnimationFrame);
  send("pointerdown", 0);
  const times = [];
  for (let k = 0; k < 20; k += 1) {
    await frame();
    const before = performance.now();
    send("pointermove", k / 20);
    await frame();
    canvas.getContext("2d").getImageData(0, 0, 1, 1);
    times.push(performance.now() - before);
  }
  send("pointerup", 1);
  return times;
}"""


def write(path: Path, count: int) -> None:
    """Write a LAZ file of a wavy surface of 100 m x 100 m, in parts."""
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.zeros(3), np.full(3, 1e-4)
    header.add_extra_dim(laspy.ExtraBytesParams(name="uncertainty", type=np.float32))
    rng = np.random.default_rng(1)
    with laspy.open(path, "w", header=header) as file:
        for _ in range(0, count, PART):
            points = laspy.ScaleAwarePointRecord.zeros(PART, header=header)
            x, y = rng.uniform(0, 100, (2, PART))
            points.x, points.y = x, y
            points.z = 2 * np.sin(x / 5) * np.cos(y / 7) + rng.normal(0, 1e-3, PART)
            points["uncertainty"] = np.full(PART, 1e-3, dtype=np.float32)
            points.intensity = rng.integers(0, 9999, PART)
            file.write_points(points)


def memory(number: int, name: str) -> float:
    """Memory of a process by its number and a name of its status [byte]."""
    status = Path(f"/proc/{number}/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith(name))
    return 1024.0 * int(line.split()[1])


def browser_memory() -> float:
    """Memory of the renderers and the GPU processes of Chromium [byte]."""
    total = 0.0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_text()
            if "--type=renderer" in command or "--type=gpu-process" in command:
                total += memory(int(folder.name), "VmRSS")
        except (OSError, StopIteration):  # the process has ended since
            continue
    return total


def measured(count: int) -> dict[str, float]:
    """Times and memory of server and browser for a cloud."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("Chromium is missing; install it to measure the page")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        path = Path(place) / "cloud.laz"
        subprocess.run(
            [sys.executable, __file__, "--write", str(path), str(count)], check=True
        )
        begun = time.perf_counter()
        server = subprocess.Popen(
            [sys.executable, "-m", "amulor", "view", str(path)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        found = {"file": float(path.stat().st_size), "server_s": 0.0}
        found["server_s"] = time.perf_counter() - begun
        others = browser_memory()
        browser = driver.chromium.launch(executable_path=chromium, args=[*FLAGS])
        try:
            tab = browser.new_page(viewport={"width": 1280, "height": 900})
            tab.set_default_timeout(300_000)
            begun = time.perf_counter()
            tab.goto(address)
            tab.wait_for_selector("html[data-complete=yes]")
            found["page_s"] = time.perf_counter() - begun
            tab.wait_for_timeout(3000)
            found["browser"] = browser_memory() - others
            found["server"] = memory(server.pid, "VmHWM")
            found["turn_ms"] = statistics.median(tab.evaluate(TURN)[5:])
            found["drawn"] = tab.evaluate("amulor.scene.points")
        finally:
            browser.close()
            server.terminate()
            server.wait(120)
    return found


def table(results: dict[int, dict[str, float]]) -> str:
    """Return the table in Markdown."""
    rows = {
        "points in the file": lambda n, _: f"{n / 1e6:.0f} million",
        "points drawn": lambda _, one: f"{one['drawn'] / 1e6:.0f} million",
        "size of the file": lambda _, one: f"{one['file'] / 1e6:.0f} MB",
        "time until the server answers": lambda _, one: f"{one['server_s']:.0f} s",
        "time until the page is complete": lambda _, one: f"{one['page_s']:.0f} s",
        "memory of the server at most": lambda _, one: f"{one['server'] / 1e6:.0f} MB",
        "memory of the browser": lambda _, one: f"{one['browser'] / 1e6:.0f} MB",
        "frame while the view turns": lambda _, one: f"{one['turn_ms']:.0f} ms",
    }
    lines = [
        [name, *(text(count, one) for count, one in results.items())]
        for name, text in rows.items()
    ]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> None:
    """Measure, print the table, and add the figures to the history."""
    import history

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", action="store_true")
    parser.add_argument("--write", nargs=2, metavar=("FILE", "POINTS"))
    options = parser.parse_args()
    if options.write:
        write(Path(options.write[0]), int(options.write[1]))
        return
    results = {count: measured(count) for count in COUNTS}
    text = table(results)
    print(text, end="")
    few, many = (results[count] for count in COUNTS)
    for name in ("server", "browser"):
        print(f"memory of the {name}, 20 over 4 million points: "
              f"{many[name] / few[name]:.2f}")  # fmt: skip
    figures = {
        f"{count / 1e6:.0f} million, {name}": value
        for count, one in results.items()
        for name, value in one.items()
    }
    history.append("time_large_cloud", figures)
    if options.docs:
        page = DOCS.read_text(encoding="utf-8")
        marks = r"(<!-- large clouds -->\n).*?(<!-- end of large clouds -->\n)"
        page = re.sub(marks, lambda mark: mark[1] + text + mark[2], page, flags=re.S)
        DOCS.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
