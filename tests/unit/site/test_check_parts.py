"""Findings of the check of a site: scans, targets, and what ties them."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.site.check import check
from amulor.site.description import ScaleBar

module = sys.modules["amulor.site.check"]


def _scan(name: str, **changes: Any) -> Any:
    fields = {"name": name, "epoch": "one", "start": None, "trajectory": None,
              "processing": None, "water": None, "simulated_from": None}  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def _target(name: str, *places: tuple[str, int, int] | str, moved: bool = False) -> Any:
    made = [(place, 1, 1) if isinstance(place, str) else place for place in places]
    return SimpleNamespace(
        name=name, moved=moved,
        places=[SimpleNamespace(scan=scan, row=row, column=column)
                for scan, row, column in made],
    )  # fmt: skip


def _bar(*ends: str) -> ScaleBar:
    return ScaleBar.model_validate(
        {"kind": "scale-bar", "name": "bar", "ends": ends, "length": "1 m",
         "length_uncertainty": "1 mm"}
    )  # fmt: skip


def _site(scans: list[Any], targets: list[Any], **changes: Any) -> Any:
    fields: dict[str, Any] = {
        "scan": scans, "target": targets, "control": [],
        "epoch": [SimpleNamespace(name="one")],
        "scans_of": lambda epoch: [scan for scan in scans if scan.epoch == epoch],
    }  # fmt: skip
    return SimpleNamespace(**{**fields, **changes})


def _image(**attributes: Any) -> Any:
    image = scenes.plane((0, 0, 1), 1.5, rows=12, columns=15)
    return image.assign_attrs(uncertainty_unknown="", **attributes)


def test_places_of_targets_are_pixels_with_a_range() -> None:
    image = _image()
    image["slant_range"].values[:6, :8] = np.nan
    target = _target("S", ("a", 3, 5), ("a", 12, 0), ("a", 0, 15), ("b", 99, 99))
    good = _target("T", ("a", 11, 14), ("a", 7, 3))
    site = _site([_scan("a")], [target, _bar("S", "T"), good])
    found = list(module._places_without_range(site, site.scan[0], image))
    near = int(module._NEAR)
    assert near == 2
    where = "target 'S' in scan 'a': "
    assert found == [
        where + "no pixel near (3, 5) has a range; pick one on the target, for example "
        "with amulor view",
        where
        + "pixel (12, 0) is outside of its 12 rows and 15 columns, counted from 0",
        where
        + "pixel (0, 15) is outside of its 12 rows and 15 columns, counted from 0",
    ]
    # A pixel two rows or columns away is near enough.
    for row, column in ((4, 4), (3, 6)):
        site.target = [_target("S", ("a", row, column))]
        assert list(module._places_without_range(site, site.scan[0], image)) == []
    target_signal = image.drop_vars("slant_range")
    site.target = [_target("S", ("a", 3, 5))]
    assert list(module._places_without_range(site, site.scan[0], target_signal)) == []
    empty = target_signal.drop_dims(["row", "column"])
    (words,) = module._places_without_range(site, site.scan[0], empty)
    assert words.endswith("outside of its 0 rows and 0 columns, counted from 0")


def _names(lines: Any) -> list[str]:
    return [line.split("'")[1] for line in lines]


def test_scans_without_a_start_are_placed_by_three_targets_in_turn() -> None:
    first = _scan("a", start=object())
    scans = [first, _scan("b"), _scan("c"), _scan("d")]
    targets = [
        _target("P", "a", "b"), _target("Q", "a", "b"), _target("R", "a", "b", "c"),
        _target("S", "b", "c"), _target("T", "b", "c"), _target("U", "c", "d"),
        _target("V", "a", "d"),
    ]  # fmt: skip
    site = _site(scans, targets)
    (line,) = module._untied_scans(site)
    assert line == (
        "scan 'd': its start pose is unknown, and it shares 2 targets with scans whose "
        "pose is known (U, V); state [scan.start] with uncertainties, or the places of "
        "3 targets that are not on a line"
    )
    site.target = targets[1:]
    lines = list(module._untied_scans(site))
    assert _names(lines) == ["b", "c", "d"]
    assert "shares 1 targets" in lines[1]
    moving = [_scan("a", trajectory=object()), _scan("b")]
    assert _names(module._untied_scans(_site(moving, []))) == ["b"]
    (alone,) = module._untied_scans(_site(moving, []))
    assert "shares 0 targets with scans whose pose is known (none)" in alone


def test_the_first_scan_or_three_control_points_define_the_frame() -> None:
    scans = [_scan("a"), _scan("b")]
    targets = [_target(name, "b") for name in "PQR"]
    assert _names(module._untied_scans(_site(scans, targets))) == ["b"]
    control = [SimpleNamespace(target=name) for name in "PQR"]
    controlled = _site(scans, targets, control=control)
    assert _names(module._untied_scans(controlled)) == ["a"]
    two = _site(scans, targets, control=control[:2])
    assert _names(module._untied_scans(two)) == ["b"]


def test_moved_targets_count_within_their_visit() -> None:
    scans = [_scan("a"), _scan("b", epoch="two")]
    targets = [_target("P", "a", "b", moved=True), _target("Q", "b"), _bar("P", "Q")]
    site = _site(scans, targets)
    assert module._targets_in(site, scans[0]) == {"P in one"}
    assert module._targets_in(site, scans[1]) == {"P in two", "Q"}


def test_targets_and_visits_without_use_are_named() -> None:
    targets = [
        _target("P", "a"), _target("Q", "a"), _target("R", "a"), _target("S", "a", "b"),
        _bar("Q", "S"), _target("T"),
    ]  # fmt: skip
    site = _site(
        [_scan("a"), _scan("b")], targets, control=[SimpleNamespace(target="R")],
        epoch=[SimpleNamespace(name="one"), SimpleNamespace(name="two")],
    )  # fmt: skip
    assert list(module._without_use(site)) == [
        "target 'P': one scan sees it, and it is no control point and no end of a "
        "scale bar, so it tells nothing",
        "epoch 'two': no scan belongs to it",
    ]


def test_points_are_those_of_usable_pixels() -> None:
    image = _image()
    image["quality_flag"].values[0, 0] = QualityFlag.NO_TARGET
    image["quality_flag"].values[0, 1] = QualityFlag.NO_OPEN_WATER
    image["slant_range"].values[0, 2] = -1.0
    found = module._points(image)
    assert found.shape == (12 * 15 - 2, 3)
    assert_allclose(found[:, 2], 1.5)


@pytest.mark.parametrize(("usable", "enough"), [(99, False), (100, True)])
def test_a_scan_needs_a_hundred_pixels(usable: int, enough: bool) -> None:
    image = _image()
    image["quality_flag"].values.ravel()[usable:] = QualityFlag.NO_TARGET
    site = _site([_scan("a")], [])
    errors, notes = module._scan_findings(site, site.scan[0], image)
    assert notes == []
    assert errors == (
        []
        if enough
        else [
            "scan 'a': 99 of 180 pixels have a range, too few to be placed; look at "
            "its quality flags with amulor info"
        ]
    )


def test_unknown_errors_of_a_scan_are_remarks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    site = _site([_scan("a")], [])
    image = _image().assign_attrs(uncertainty_unknown="delay geometry")
    errors, notes = module._scan_findings(site, site.scan[0], image)
    assert errors == []
    assert notes == [
        "scan 'a': nobody states the error by delay, geometry; stated covariances do "
        "not hold it (section [calibration] of its survey)"
    ]
    monkeypatch.setattr(module, "error_unknown", lambda _: "water not removed")
    errors, _ = module._scan_findings(site, site.scan[0], image)
    assert errors == [f"scan 'a': water not removed; {module.WHAT_TO_DO}"]


def test_a_check_puts_all_findings_together(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.nc").write_text("")
    scans = [
        _scan("a", file=tmp_path / "a.nc", start=object()),
        _scan("b", file=tmp_path / "b.nc"),
        _scan("c", file=tmp_path / "c.nc", trajectory=object(), start=object()),
        _scan("d", file=tmp_path / "d.nc", simulated_from="d.toml"),
    ]
    site = _site(scans, [_target("P", "a")])

    def read(path: Any) -> Any:
        if path.name == "b.nc":
            raise CubeError("b.nc is damaged")
        return _image()

    monkeypatch.setattr(module.io, "read_cube", read)
    monkeypatch.setattr(module, "motion_of", lambda *_: None)
    starts: list[Any] = []

    def start_findings(site: Any, clouds: Any) -> Any:
        starts.append(clouds)
        return SimpleNamespace(mistakes=["wrong start"], remarks=["note on starts"])

    monkeypatch.setattr(module, "start_findings", start_findings)
    found = check(site)
    assert found.mistakes[:2] == ("scan 'b': b.nc is damaged", "wrong start")
    assert _names(found.mistakes[2:]) == ["b", "d"]
    assert found.remarks == (
        "scan 'd': d.nc is not there yet; amulor run simulates it",
        "note on starts",
        "target 'P': one scan sees it, and it is no control point and no end of a "
        "scale bar, so it tells nothing",
    )
    assert found.shapes == {"a": (12, 15), "c": (12, 15)}
    assert found.levels == {"a": "range_image", "c": "range_image"}
    # Points of lines depend on their trajectories.
    assert list(starts[0]) == ["a"]
    assert_array_equal(starts[0]["a"].shape, (180, 3))
