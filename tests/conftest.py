"""What all tests share: how they are run, and small surveys with known answers."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

# Before numpy and numba are loaded. The solves are small, and threads would only wait
# and spin; of several test processes, each has one core to itself.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.update(
    {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    if "PYTEST_XDIST_WORKER" in os.environ
    else {}
)

import compile_cache
import pytest
import skips
from hypothesis import settings

from amulor import _progress
from amulor.survey import Survey

# Modules and tests stay, so looking through them for garbage takes a fifth of the time
# of collection and finds none.
gc.disable()

# Compiled code is slow once; a deadline would blame the first drawn input for it.
settings.register_profile("quick", deadline=None, print_blob=True, max_examples=12)
settings.register_profile("thorough", deadline=None, print_blob=True, max_examples=40)
settings.load_profile("quick")


def pytest_configure(config: pytest.Config) -> None:
    """Let tests hear signals, watch skips, and compile each function once."""
    # A shell that starts a program in the background has it ignore some signals, and so
    # do the programs that it starts in turn; tests that send them would wait for ever.
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            heard = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
            signal.signal(number, heard)
    if "PYTEST_XDIST_WORKER" not in os.environ:
        config.pluginmanager.register(Skips(), "skips")
    else:
        compile_cache.compile_one_at_a_time()


def pytest_collection_finish() -> None:
    """Look for garbage from now on, and not among modules and tests."""
    gc.freeze()
    gc.enable()


class Skips:
    """Fails a run in which a test was skipped without a reason that is listed."""

    def __init__(self) -> None:
        self._reports: list[pytest.TestReport | pytest.CollectReport] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep what was skipped in any process."""
        if report.skipped:
            self._reports.append(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Keep the files that were skipped as a whole."""
        if report.skipped:
            self._reports.append(report)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run that would have passed."""
        if skips.unlisted(self._reports) and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter
    ) -> None:
        """Name the tests that should not have been skipped."""
        found = skips.unlisted(self._reports)
        if found:
            terminalreporter.section("skips that tests/support/skips.py does not list")
            for test, reason in found.items():
                terminalreporter.line(f"{test}: {reason}")


REFERENCE = Path(__file__).parent / "reference"
#: Tests that took longer than others when `tools/long_tests.py` measured them.
LONG = frozenset((REFERENCE / "long_tests.txt").read_text().splitlines())
#: Tests, and files whose shared fixture alone, took more than 5 s of processor time.
LONGEST = frozenset((REFERENCE / "longest_tests.txt").read_text().splitlines())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave long tests to `make check`, the longest to `make study`, order the rest.

    Tests of the whole program run first, then files with long tests. Files of short
    tests fill the end of a run.
    """
    for item in items:
        if item.nodeid in LONG:
            item.add_marker(pytest.mark.slow)
        if LONGEST & {item.nodeid, item.nodeid.partition("::")[0]}:
            item.add_marker(pytest.mark.study)
    folders = ("tests/system/", "tests/physics/")
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(
        key=lambda item: (not item.nodeid.startswith(folders), item.path not in long)
    )


@pytest.fixture(autouse=True)
def _progress_from_0_to_1() -> Iterator[None]:
    """Check each report of progress that no listener of a test receives."""
    before = _progress._ear.set(_progress._Ear(_within))
    yield
    _progress._ear.reset(before)


def _within(step: str, share: float) -> None:
    # A delay before the first step has no words.
    assert step or share == 0, "a report of progress without words"
    assert -1e-9 <= share <= 1 + 1e-9, f"{step}: {share} of the work"


PLATE = """
name = "Plate in a small tank"
[water]
absorption = "0.255 1/m"
scattering = "0.595 1/m"
forward_fraction = 1.0
second_moment = "0.06 rad^2"
phase_function_at_180 = "0.001 1/sr"
refractive_index = 1.34
group_index = 1.38
backscatter_mueller = [0.81, -0.81, -0.62]
signal_fluctuation = "5 %"
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "1.5 m"]
width = "30 cm"
height = "30 cm"
reflectance = 0.1
[instrument]
phase_uncertainty = "0 deg"
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["39 MHz"]
polarizations = ["VV", "VH"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2.672 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.06 deg"
[scan]
columns = 12
rows = 6
azimuth_span = "3.81 deg"
elevation_span = "1.53 deg"
dwell = "125 ms"
[scan.open_water]
columns = 5
rows = 3
repeats = 8
"""


@pytest.fixture(scope="session")
def plate_text() -> str:
    """Return a survey file with a flat plate 1.5 m away in milky water."""
    return PLATE


@pytest.fixture(scope="session")
def plate(plate_text: str) -> Survey:
    """Return that survey."""
    return Survey.from_text(plate_text)
