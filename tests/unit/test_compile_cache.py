"""Compiled code of other sources is not run: what is stored is thrown away in time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import compile_cache
import pytest

KERNELS = {
    "__init__": "",
    "inner": "import numba\n\n\n@numba.njit(cache=True)\ndef inner(x):\n"
    "    return x + 1.0\n",
    "outer": "import numba\n\nfrom kernels.inner import inner\n\n\n"
    "@numba.njit(cache=True)\ndef outer(x):\n    return 2.0 * inner(x)\n",
    "alone": "import numba\n\n\n@numba.njit(cache=True)\ndef alone(x):\n"
    "    return x - 1.0\n",
}
CALL = (
    "from kernels.outer import outer; from kernels.alone import alone;"
    "print(outer(3.0), alone(3.0), *outer.stats.cache_hits.values())"
)


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of compiled functions, one of which calls one of another file."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    for name, text in KERNELS.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.setattr(compile_cache, "SOURCES", tmp_path)
    monkeypatch.setattr(compile_cache, "_imported", compile_cache._imported.__wrapped__)
    return folder


def called(folder: Path) -> list[float]:
    """Return what a new process gets of the functions, and whether one was stored."""
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=folder.parent,
        env={**os.environ, "NUMBA_CACHE_DIR": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(number) for number in done.stdout.split()]


def test_a_function_is_compiled_anew_when_one_that_it_calls_has_changed(
    kernels: Path,
) -> None:
    assert called(kernels) == [8.0, 2.0]
    assert compile_cache.discard_stale() == []
    inner = kernels / "inner.py"
    inner.write_text(KERNELS["inner"].replace("1.0", "2.0"))
    later = max(p.stat().st_mtime for p in kernels.glob("**/*.nb*")) + 1
    os.utime(inner, (later, later))
    # What numba alone makes of it, and why these files are looked at.
    assert called(kernels) == [8.0, 2.0, 1.0]
    removed = {path.name.partition(".")[0] for path in compile_cache.discard_stale()}
    assert removed == {"inner", "outer"}
    assert called(kernels) == [10.0, 2.0]


def test_what_is_stored_of_a_file_that_is_gone_goes(kernels: Path) -> None:
    stored = kernels / "__pycache__"
    stored.mkdir()
    for module in ("alone", "gone"):
        for suffix in ("nbi", "1.nbc"):
            (stored / f"{module}.function-4.py311.{suffix}").touch()
    assert compile_cache.discard_stale() == [stored / "gone.function-4.py311.nbi"]
    assert {path.name.partition(".")[0] for path in stored.iterdir()} == {"alone"}
