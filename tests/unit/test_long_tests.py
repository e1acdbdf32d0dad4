"""The listing of long tests comes from pytest's report, and exists in the tests."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOL = runpy.run_path(str(ROOT / "tools" / "long_tests.py"))

REPORT = """
============ slowest durations ============
3.00s call     tests/a.py::test_long
0.40s setup    tests/a.py::test_with_fixture[1 m-x y]
0.20s call     tests/a.py::test_with_fixture[1 m-x y]
0.10s call     tests/a.py::test_short
9.00s call     tests/b.py::test_alone
8.00s call     tests/c.py::test_shorter
9.00s teardown tests/c.py::test_longer
1 passed in 30.00s
"""


def test_each_file_keeps_its_shortest_test() -> None:
    assert TOOL["long_tests"](REPORT, 0.5) == [
        "tests/a.py::test_long",
        "tests/a.py::test_with_fixture[1 m-x y]",
        "tests/c.py::test_longer",
    ]


@pytest.mark.parametrize("listing", ["long_tests.txt", "longest_tests.txt"])
def test_the_listings_name_files_that_exist(listing: str) -> None:
    names = (ROOT / "tests" / "reference" / listing).read_text().splitlines()
    assert names
    gone = {n for n in names if not (ROOT / n.partition("::")[0]).is_file()}
    assert not gone, "run: python tools/long_tests.py"
