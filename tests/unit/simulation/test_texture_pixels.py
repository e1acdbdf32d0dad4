"""Pixels of textured targets: which are worked on, in parts, and by what wave."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.simulation import texture_blur
from amulor.simulation.geometry import Setup, trace
from amulor.survey import Survey


class Recorded:
    """Pixels that keep their numbers, and change the texture by them."""

    calls: list[Any]

    def __init__(self, part: Any, *_: Any) -> None:
        self.part = part

    def change(self, scene: Any, arguments: Any, wavenumber: Any) -> Any:
        self.calls.append((self.part.tolist(), wavenumber))
        return np.outer(np.arange(1, len(wavenumber) + 1), self.part + 1j)


def test_pixels_of_textured_targets_are_changed_in_parts(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    survey = plate.with_(
        {"instrument.modulation_frequencies": [20e6, 60e6], "scan.columns": 2,
         "scan.rows": 1}
    )  # fmt: skip
    setup = Setup(survey)
    view = trace(setup).view
    monkeypatch.setattr(Recorded, "calls", [], raising=False)
    monkeypatch.setattr(texture_blur, "_Pixels", Recorded)
    monkeypatch.setattr(texture_blur, "_AT_ONCE", 2)
    nothing: Any = None

    def change(target: list[int], textured: list[bool]) -> Any:
        monkeypatch.setattr(texture_blur, "has_texture", lambda _: np.array(textured))
        hits: Any = SimpleNamespace(target=np.array(target))
        return texture_blur.texture_change(
            survey, setup.water, nothing, hits, nothing, beam=nothing, sight=nothing,
            view=view, place=nothing,
        )  # fmt: skip

    found = change([1, 0, -1, 1, 1], [False, True])
    assert [part for part, _ in Recorded.calls] == [[0, 3], [4]]
    wave = Recorded.calls[0][1]
    assert_allclose(wave, 2 * np.pi * np.array([0, 20e6, 60e6]) * 1.38 / speed_of_light)
    expected = np.outer([1, 2, 3], [0 + 1j, 0, 0, 3 + 1j, 4 + 1j])
    assert_allclose(found, expected)
    assert change([0, -1], [False, True]) is None
    assert change([-1, -1], [True, True]) is None


def test_targets_without_a_texture_have_none(plate: Survey) -> None:
    assert texture_blur.has_texture(plate).tolist() == [False]
    bare = plate.with_({"targets": []})
    assert texture_blur.has_texture(bare).tolist() == []
    assert texture_blur.has_texture(bare).dtype == bool
