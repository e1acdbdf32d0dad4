"""Ranges of light that photon transport sent hold against the surface itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from amulor.studies.trust.methods import outcome
from amulor.studies.trust.scenes.photons import photon_water
from amulor.studies.trust.table import score


@pytest.mark.study
@pytest.mark.parametrize("function", ["petzold", "fournier-forand", "two-term"])
def test_intervals_hold_the_surface_and_not_only_the_late_echo(function: str) -> None:
    # The survey knows a and b and the moments of another phase function.
    case = photon_water(4, 7, function=function, histories=120_000)
    found = score(case, outcome("polarization", case))
    assert found.trusted > 0.4
    assert found.inside_95 > 0.85
    # Errors are common to the pixels of a distance; none is far out.
    assert found.worst < 4
    silent = replace(case, samples=case.samples.assign_attrs(late_echo="absent"))
    before = score(silent, outcome("polarization", silent))
    assert before.inside_95 < 0.5
    assert before.worst > 5
