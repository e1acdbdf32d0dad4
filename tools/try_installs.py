"""Install the wheel in fresh environments, run the main commands, print one table.

Run with ``make installs``; `uv` must be on the path of the environment. A Python that
cannot be found is left out and named. Its wheels are then resolved, as those of other
systems are: every dependency must have one.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
SYSTEMS = {
    "Linux x86-64": "x86_64-unknown-linux-gnu",
    "Linux arm64": "aarch64-unknown-linux-gnu",
    "macOS arm64": "aarch64-apple-darwin",
    "Windows x86-64": "x86_64-pc-windows-msvc",
}
GOAL = ROOT / "examples" / "goals" / "harbour_wall.toml"
#: Each main command, in the order in which one reads what another has written.
COMMANDS = {
    "demo": "demo --output demo",
    "simulate": "simulate demo/ladder_milk.toml --output samples.nc",
    "reject": "reject samples.nc --method polarization --output target.nc",
    "image": "image target.nc --output range.nc",
    "export": "export range.nc --output cloud.ply",
    "view": "view range.nc --save page.html",
    "report": "report range.nc --output report.html",
    "backscatter": "backscatter demo/ladder_milk.toml",
    "design": f"design {GOAL.name} --output wall.toml",
}
#: Root may write anywhere: it hands the commands to a user without rights.
NOBODY = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]


def uv(*words: object) -> subprocess.CompletedProcess[str]:
    """Run uv without the virtual environment of this process."""
    kept = {key: value for key, value in os.environ.items() if key != "VIRTUAL_ENV"}
    program = shutil.which("uv", path=f"{Path(sys.executable).parent}:{kept['PATH']}")
    if program is None:
        raise SystemExit("there is no uv; install it: make installs does")
    return subprocess.run(
        [program, *map(str, words)],
        env=kept | {"MACOSX_DEPLOYMENT_TARGET": "14.0"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def needed(done: subprocess.CompletedProcess[str]) -> str:
    """Return the output of a command that must work."""
    if done.returncode:
        raise SystemExit(f"{done.args}\n{done.stdout}{done.stderr}")
    return done.stdout.strip()


def megabytes(folder: Path) -> float:
    """Return the size of all files of an environment [MB]."""
    files = (file for file in folder.rglob("*") if not file.is_symlink())
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def install(folder: Path, python: str, what: str, *, lowest: bool) -> float:
    """Make an environment with the wheel in it; return its size [MB]."""
    needed(uv("venv", "--quiet", "--python", python, folder))
    there = ("--python", folder, "--link-mode", "copy", "--quiet")
    if lowest:  # of the project's own dependencies: those of a wheel are not direct
        extras = ("--extra", "all") if "[all]" in what else ()
        project = ("--resolution", "lowest-direct", "--requirement", "pyproject.toml")
        needed(uv("pip", "install", *there, *project, *extras))
        there = (*there, "--no-deps")
    needed(uv("pip", "install", *there, what))
    return megabytes(folder)


def run(environment: Path, work: Path, *, closed: bool = False) -> dict[str, str]:
    """Run the main commands; return the outcome of each in a word or two."""
    work.mkdir()
    shutil.copy(GOAL, work)
    own = {"PATH": os.environ["PATH"], "HOME": str(work), "LANG": "C.UTF-8"}
    first: list[str] = []
    if closed:
        own["HOME"] = "/nonexistent"
        subprocess.run(["chmod", "-R", "a+rX,a-w", environment], check=True)
        if os.getuid() == 0:
            first = NOBODY
            shutil.chown(work, 65534, 65534)
    outcomes = {}
    for name, words in COMMANDS.items():
        began = time.perf_counter()
        done = subprocess.run(
            [*first, environment / "bin" / "amulor", *words.split()],
            cwd=work,
            env=own,
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - began
        extra = re.search(r"amulor\[(\w+)\]", done.stderr)
        if done.returncode == 0:
            outcomes[name] = "yes"
        elif extra and done.returncode in (1, 2) and done.stderr.count("\n") <= 3:
            outcomes[name] = f"needs `{extra[1]}`"
        else:
            outcomes[name] = "**no**"
            print(done.stdout[-2000:], done.stderr[-3000:], sep="\n", file=sys.stderr)
        print(f"  {name}: {outcomes[name]}, {seconds:.1f} s", file=sys.stderr)
    return outcomes


def version_of(environment: Path, name: str) -> str:
    """Return the installed version of a package."""
    code = f"from importlib.metadata import version; print(version({name!r}))"
    return subprocess.check_output(
        [environment / "bin" / "python", "-c", code], text=True
    ).strip()


def interpreters() -> dict[str, str]:
    """Return the path of each Python that can be found or installed."""
    places = {}
    for version in PYTHONS:
        done = uv("python", "find", "--system", version)
        if done.returncode:
            uv("python", "install", version)
            done = uv("python", "find", "--managed-python", version)
        if done.returncode == 0:
            places[version] = done.stdout.strip()
        else:
            print(f"there is no Python {version} here", file=sys.stderr)
    return places


def tried(wheel: Path, folder: Path) -> list[list[str]]:
    """Return one row for each environment in which the commands were run."""
    oldest = PYTHONS[0]
    found = interpreters()
    every = f"amulor[all] @ {wheel.as_uri()}"
    core = f"amulor @ {wheel.as_uri()}"
    # A user without rights reaches the system's Python, not one in a home.
    systems = shutil.which("python3", path="/usr/bin:/usr/local/bin") or ""
    cases = [
        ("core", found.get(oldest), core, False, False),
        ("core, lowest versions", found.get(oldest), core, True, False),
        ("all, lowest versions", found.get(oldest), every, True, False),
        ("all, read-only, no home", systems, every, False, True),
        *(("all", found.get(version), every, False, False) for version in PYTHONS),
    ]
    rows = []
    for number, (name, python, what, lowest, closed) in enumerate(cases):
        if not python:
            continue
        environment = folder / f"environment-{number}"
        print(f"{name}, {python}", file=sys.stderr)
        size = install(environment, python, what, lowest=lowest)
        outcomes = run(environment, folder / f"work-{number}", closed=closed)
        code = "import platform; print(platform.python_version())"
        python = environment / "bin" / "python"
        version = subprocess.check_output([python, "-c", code], text=True).strip()
        numbers = [version, version_of(environment, "numpy"), f"{size:.0f}"]
        rows.append([name, *numbers, *outcomes.values()])
        if not closed:
            shutil.rmtree(environment)
    return rows


def resolved() -> list[list[str]]:
    """Return for each Python whether all dependencies have wheels on each system."""
    rows = []
    for version in PYTHONS:
        row = [version]
        for platform in SYSTEMS.values():
            where = ("--python-version", version, "--python-platform", platform)
            done = uv(
                *("pip", "compile", "--quiet", "--only-binary", ":all:", *where),
                *("--extra", "all", "pyproject.toml"),
            )
            row.append("**no**" if done.returncode else "yes")
            if done.returncode:
                print(done.stderr, file=sys.stderr)
        rows.append(row)
    return rows


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Build the wheel, try the environments, print the tables."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        folder.chmod(0o755)
        needed(uv("build", "--quiet", "--wheel", "--out-dir", folder, ROOT))
        (wheel,) = folder.glob("*.whl")
        rows = tried(wheel, folder)
        wheels = resolved()
    print(table(["installed", "Python", "numpy", "MB", *COMMANDS], rows))
    print()
    print(table(["Python", *SYSTEMS], wheels))
    if any("**no**" in row for row in [*rows, *wheels]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
