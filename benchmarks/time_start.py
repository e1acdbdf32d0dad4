"""Times of commands, cold and warm, and the steps that they wait for.

CPU seconds, which other work on the machine disturbs less than the clock. Cold: no
compiled loop is on disk. Warm: all are. Bytecode of Python, which pip writes when it
installs, is there both times: a run before is not counted. A warm run waits for
imports, of which the packages are named that take the most, and for its work. A command
that fails ends the benchmark.
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
    "image target.nc --polarization VH -o image.nc --overwrite",
    "export image.nc -o cloud.ply --overwrite",
    "report image.nc -o report.html --overwrite",
    "survey check ladder.toml",
    "backscatter ladder.toml",
    "reject cube.nc --method open-water -o target.nc --overwrite",
    "reject tones.nc --method joint -o joint.nc --overwrite",
    "simulate small.toml -o small.nc --overwrite",
    "backscatter ladder.toml --model photons --error 20%",
)
#: Exit codes other than 0: the file is not there.
_CODES = {"image missing.nc -o none.nc": 1}
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
    survey = Survey.from_text(small)
    tones = survey.with_(
        {"instrument.modulation_frequencies": ["20 MHz", "40 MHz", "60 MHz"]}
    )
    cube = simulation.simulate(survey, rng=1)
    target = rejection.open_water(cube)
    io.write_cube(cube, folder / "cube.nc")
    io.write_cube(simulation.simulate(tones, rng=1), folder / "tones.nc")
    io.write_cube(target, folder / "target.nc")
    io.write_cube(range_image(target, polarization="VH"), folder / "image.nc")


def run(words: str, folder: Path, cache: Path) -> tuple[float, float, str]:
    """Return CPU time [s], share of imports in it, and those that take the most."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "amulor", *words.split()],
        cwd=folder,
        env={
            **os.environ,
            "NUMBA_CACHE_DIR": str(cache),
            "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
            "PYTHONDONTWRITEBYTECODE": "",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != _CODES.get(words, 0):
        last = done.stderr.splitlines()[-1]
        raise SystemExit(f"amulor {words}: exit code {done.returncode}: {last}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    share: collections.Counter[str] = collections.Counter()
    for own, name in _LINE.findall(done.stderr):
        share[name.partition(".")[0]] += int(own)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    total = sum(share.values()) * 1e-6
    most = [f"{name} {took * 1e-6:.2f}" for name, took in share.most_common(3)]
    return used, min(total / used, 1.0), ", ".join(most)


def main() -> None:
    """Print the table, as it stands in the documentation."""
    import history

    figures: dict[str, float] = {}
    print(
        "| command | cold | warm | loops compiled | imports, at most "
        "| longest imports [s] |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for number, words in enumerate(COMMANDS):
            cache, empty = folder / f"cache{number}", folder / f"empty{number}"
            run(words, folder, cache)
            warm, imports, most = run(words, folder, cache)
            cold, *_ = run(words, folder, empty)
            loops = len(list(cache.rglob("*.nbc")))
            shown = words.replace(" --overwrite", "")
            print(
                f"| `{shown}` | {cold:.2f} s | {warm:.2f} s | {loops} "
                f"| {imports:.0%} | {most} |",
                flush=True,
            )
            figures |= {f"{shown}: cold [s]": cold, f"{shown}: warm [s]": warm}
    history.append("time_start", figures)


if __name__ == "__main__":
    main()
