"""Frame times of the browser page at 1 million pixels, by the performance API.

Run ``python benchmarks/time_page_frames.py``. It needs Chromium, which draws in
software, so that computers without a GPU are comparable. The processor time of Chromium
hardly depends on other programs; the time until a frame is there does. ``--json FILE``
keeps the times, ``--before FILE`` compares with kept ones, and ``--docs`` writes the
table to docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from time_view_page import image_file

DOCS = Path(__file__).parents[1] / "docs" / "benchmarks.md"
#: Since Chromium 138 a page without a GPU draws only with the first two.
FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
FRAMES = 40
#: A frame begins with its first callback and ends when both canvases can be read.
MEASURE = """async ([kind, frames]) => {
  Element.prototype.setPointerCapture = () => {};
  const canvas = document.getElementById(kind === "hover" ? "map" : "cloud");
  const box = canvas.getBoundingClientRect();
  const others = ["map", "cloud"].map((id) => document.getElementById(id));
  const read = () => {
    for (const one of others) one.getContext("2d").getImageData(0, 0, 1, 1);
  };
  const send = (type, share) => canvas.dispatchEvent(new PointerEvent(type, {
    pointerId: 1, pointerType: "mouse", bubbles: true, isPrimary: true,
    buttons: kind === "hover" ? 0 : 1,
    clientX: box.left + (0.3 + 0.4 * share) * box.width,
    clientY: box.top + (0.4 + 0.2 * share) * box.height,
  }));
  const frame = () => new Promise((done) => requestAnimationFrame(() => done(performance.now())));
  if (kind === "turn") send("pointerdown", 0);
  const times = [];
  for (let k = 0; k < frames; k += 1) {
    await frame();
    read();
    const before = performance.now();
    send("pointermove", k / frames);
    const handled = performance.now() - before;
    let begun = 0;
    // The page asked for its frame before; both callbacks are of one frame.
    const end = await new Promise((done) => {
      requestAnimationFrame(() => { read(); done(performance.now()); });
      begun = performance.now();
    });
    const start = document.timeline.currentTime;
    performance.measure(kind, { start: Math.max(start, begun), end });
    times.push(handled + end - Math.max(start, begun));
  }
  if (kind === "turn") send("pointerup", 1);
  return times;
}"""  # noqa: E501


def processor_time() -> float:
    """Processor time that the processes of Chromium have used [ms]."""
    parents: dict[int, int] = {}
    used: dict[int, float] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name, fields = (folder / "stat").read_text().rsplit(")", 1)
        except OSError:  # the process has ended since
            continue
        number, numbers = int(folder.name), fields.split()
        parents[number] = int(numbers[1])
        if "chrom" in name:
            used[number] = float(numbers[11]) + float(numbers[12])

    def inside(number: int) -> bool:
        while number > 1 and number != os.getpid():
            number = parents.get(number, 0)
        return number == os.getpid()

    ticks = sum(time for number, time in used.items() if inside(number))
    return 1e3 * ticks / os.sysconf("SC_CLK_TCK")


def measured(side: int) -> dict[str, list[float]]:
    """Serve an image of side x side pixels; return frame times by action [ms].

    The processor time of a frame is under the action's name with "processor".
    """
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("Chromium is missing; install it to measure frames")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        path = Path(place) / "image.nc"
        image_file(path, side)
        server = subprocess.Popen(
            [sys.executable, "-m", "amulor", "view", str(path)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert server.stdout is not None
        browser = driver.chromium.launch(executable_path=chromium, args=[*FLAGS])
        try:
            address = server.stdout.readline().split()[-1]
            tab = browser.new_page(viewport={"width": 1280, "height": 900})
            tab.set_default_timeout(300_000)
            tab.goto(address)
            tab.wait_for_selector("html[data-complete=yes]")
            tab.wait_for_timeout(3000)
            found = {}
            for kind in ("hover", "turn"):
                tab.evaluate(MEASURE, [kind, FRAMES // 4])
                before = processor_time()
                found[kind] = tab.evaluate(MEASURE, [kind, FRAMES])
                used = processor_time() - before
                found[f"{kind} processor"] = [used / FRAMES]
                # The frame at rest, in full, is none of the next action.
                tab.wait_for_timeout(3000)
            return found
        finally:
            browser.close()
            server.terminate()
            server.wait(10)


def table(found: dict[str, list[float]], before: dict[str, list[float]] | None) -> str:
    """Return the table of medians and slow frames in Markdown."""
    names = {
        "hover": "pointer moves over the map",
        "hover processor": "processor time of it",
        "turn": "3-D view turns",
        "turn processor": "processor time of it",
    }

    def cells(times: list[float]) -> str:
        if len(times) == 1:
            return f"{times[0]:.0f} ms"
        slow = sorted(times)[int(0.95 * (len(times) - 1))]
        return f"{statistics.median(times):.0f} ms ({slow:.0f} ms)"

    head = ["frame", *(["before"] if before else []), "now"]
    rows: list[list[Any]] = [head, ["---"] * len(head)]
    for kind, name in names.items():
        earlier = [cells(before[kind])] if before else []
        rows.append([name, *earlier, cells(found[kind])])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    """Measure, print the table, and add the medians to the history."""
    import history

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--docs", action="store_true")
    options = parser.parse_args()
    found = measured(options.side)
    medians = {
        f"{kind.replace(' ', '_')}_ms": statistics.median(found[kind]) for kind in found
    }
    history.append("time_page_frames", medians)
    if options.json:
        options.json.write_text(json.dumps(found))
    before = json.loads(options.before.read_text()) if options.before else None
    text = table(found, before)
    print(text, end="")
    if options.docs:
        page = DOCS.read_text(encoding="utf-8")
        marks = r"(<!-- frame times -->\n).*?(<!-- end of frame times -->\n)"
        DOCS.write_text(
            re.sub(marks, lambda mark: mark[1] + text + mark[2], page, flags=re.DOTALL),
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
