"""How long commands take, cold and warm, and what they wait for.

CPU seconds, which other work on the machine disturbs less than the clock. Cold: nothing
compiled is on disk. Warm: the second run. What a warm run waits for are the packages
whose import takes the most, and its work.
"""

from __future__ import annotations

import collections
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

COMMANDS = (
    "--help",
    "image missing.nc -o none.nc",
    "info target.nc",
    "image target.nc -o image.nc --overwrite",
    "export image.nc -o cloud.ply --overwrite",
    "report image.nc -o report.html --overwrite",
    "survey check ladder.toml",
    "backscatter ladder.toml",
    "reject cube.nc --method open-water -o target.nc --overwrite",
    "reject cube.nc --method joint -o joint.nc --overwrite",
    "simulate small.toml -o small.nc --overwrite",
    "backscatter ladder.toml --model photons --error 20%",
)
_LINE = re.compile(r"import time:\s+(\d+) \|\s+\d+ \|\s+([\w.]+)")


def prepare(folder: Path) -> None:
    """Write the files that the commands take."""
    from amulor import Survey, io, rejection, simulation
    from amulor.imaging import range_image
    from amulor.studies import ladder

    text = ladder.survey_text("milk")
    small = re.sub(r"(?m)^(columns|rows) = \d+", r"\1 = 16", text)
    (folder / "ladder.toml").write_text(text, "utf-8")
    (folder / "small.toml").write_text(small, "utf-8")
    cube = simulation.simulate(Survey.from_text(small), rng=1)
    target = rejection.open_water(cube)
    io.write_cube(cube, folder / "cube.nc")
    io.write_cube(target, folder / "target.nc")
    io.write_cube(range_image(target, polarization="VH"), folder / "image.nc")


def run(words: str, folder: Path, cache: Path) -> tuple[float, float, str]:
    """Return CPU time, that of imports [s], and which imports take the most."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "amulor", *words.split()],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    share: collections.Counter[str] = collections.Counter()
    for own, name in _LINE.findall(done.stderr):
        share[name.partition(".")[0]] += int(own)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    total = max(sum(share.values()), 1)
    most = [f"{name} {took / total:.0%}" for name, took in share.most_common(4)]
    return used, total * 1e-6, ", ".join(most)


def main() -> None:
    """Print the table, as it stands in the documentation."""
    import history

    figures = {}
    print("| command | cold | warm | loops compiled | imports wait for |")
    print("| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for number, words in enumerate(COMMANDS):
            cache = folder / f"cache{number}"
            cold, *_ = run(words, folder, cache)
            warm, _, most = run(words, folder, cache)
            loops = len(list(cache.rglob("*.nbc")))
            shown = words.replace(" --overwrite", "")
            print(
                f"| `{shown}` | {cold:.2f} s | {warm:.2f} s | {loops} | {most} |",
                flush=True,
            )
            figures |= {f"{shown}: cold [s]": cold, f"{shown}: warm [s]": warm}
    history.append("time_start", figures)


if __name__ == "__main__":
    main()
