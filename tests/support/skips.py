"""Skips that are right, with the reason; any other one fails the run.

A test that skips for want of a package or a program is a test that nobody misses until
what it guards is broken.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
from pathlib import Path

import pytest

#: Names under which systems have a browser that the tests drive.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
#: Checks of accessibility in a page, one of the packages that npm installs.
_AXE = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"
#: Parts of the tests that a run leaves out on purpose: `AMULOR_WITHOUT=browser,npm`.
WITHOUT = os.environ.get("AMULOR_WITHOUT", "").split(",")
#: Words in the reason of a skip, and whether it is right on this computer.
ALLOWED = {
    "there is no browser": "browser" in WITHOUT,
    "there is no axe-core": "npm" in WITHOUT,
    # All examples of the docstring take minutes or need an instrument.
    "all tests skipped by +SKIP option": True,
    # The right is that of root, and a container may lack it even so.
    "a file system of its own needs the right to mount one": True,
    # A Python with SQLite inside it leaves nothing to put a layer below.
    "Python has SQLite built in here": True,
    # Wheels of numba for some systems have one layer of threads or two.
    "this numba has no layer": True,
    # Windows has other signals, terminals, processes and permissions.
    "there is no such signal here": os.name == "nt",
    "this system has no SIGHUP": os.name == "nt",
    "SIGKILL and fork are needed": os.name == "nt",
    "there are no such terminals here": os.name == "nt",
    "terminals are of another kind here": os.name == "nt",
    "permissions of another kind": os.name == "nt",
    "could not import 'resource'": os.name == "nt",
    "no sha256sum": sys.platform != "linux",
    # Linux shows what a process has open; others do not.
    "reads /proc": not Path("/proc/self/stat").exists(),
    "this system does not list open files": not Path("/proc/self/fd").exists(),
    "what a file handle stands for": not Path("/proc/self/fd").exists(),
    # A fuzzer that no package of the project needs: pip install atheris.
    "could not import 'atheris'": True,
    # No wheel of it for Linux on ARM.
    "could not import 'pye57'": platform.machine() == "aarch64",
}


def browser() -> str | None:
    """Return the path of the browser, or nothing where there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def need_browser() -> str:
    """Return the path of the browser; without one the test is skipped."""
    return browser() or pytest.skip(
        f"there is no browser: none of {', '.join(BROWSERS)}; install one, or leave "
        "its tests out with AMULOR_WITHOUT=browser"
    )


def need_axe() -> Path:
    """Return the file of axe-core; without it the test is skipped."""
    if not _AXE.is_file():
        pytest.skip(
            "there is no axe-core: `make javascript` installs it by npm; or leave its "
            "tests out with AMULOR_WITHOUT=npm"
        )
    return _AXE


def unlisted(reports: list[pytest.TestReport | pytest.CollectReport]) -> dict[str, str]:
    """Return tests that were skipped for a reason that is not right here, with it."""
    reasons = {
        report.nodeid: str(report.longrepr[2])
        for report in reports
        if report.skipped and isinstance(report.longrepr, tuple)
    }
    right = [words for words, here in ALLOWED.items() if here]
    return {
        test: reason.removeprefix("Skipped: ")
        for test, reason in reasons.items()
        if not any(words in reason for words in right)
    }
