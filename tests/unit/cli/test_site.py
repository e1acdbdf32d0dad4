"""Scans that no other data check are left out of a site, and said so."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from amulor.cli import site as commands
from amulor.errors import CubeError
from amulor.site.registration import result


class Scans:
    """A site of so many scans, as far as the function looks at it."""

    def __init__(self, *names: str, trusted: str = "") -> None:
        self.scan = tuple(
            SimpleNamespace(name=name, trusted=name == trusted) for name in names
        )

    def model_copy(self, update: dict[str, tuple[SimpleNamespace, ...]]) -> list[str]:
        return [scan.name for scan in update["scan"]]


def registered(*names: str) -> SimpleNamespace:
    items = [result.Unchecked(scan=name, reason="nothing checks it") for name in names]
    return SimpleNamespace(unchecked=tuple(items))


def test_two_scans_that_check_each_other_are_enough(capsys) -> None:
    site = Scans("a", "b", "c")
    assert commands._without_unchecked(site, registered("b")) == ["a", "c"]
    assert capsys.readouterr().err.startswith("warning: b: nothing checks it; ")


def test_one_scan_alone_is_refused() -> None:
    with pytest.raises(CubeError, match=r"checked by each other\nb: nothing checks it"):
        commands._without_unchecked(Scans("a", "b"), registered("b"))


def test_a_trusted_scan_needs_no_check(capsys) -> None:
    site = Scans("a", "b", trusted="b")
    assert commands._without_unchecked(site, registered("b")) == ["a", "b"]
    assert capsys.readouterr().err == ""
