"""What `amulor.rejection.<TAB>` shows: methods and their results, no modules."""

from __future__ import annotations

import inspect
import types

import pytest

import amulor.cube
import amulor.imaging
import amulor.io
from amulor import rejection

ROOMS = (amulor.cube, amulor.imaging, amulor.io, rejection)


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.__name__)
def test_completion_shows_the_public_names_only(room: types.ModuleType) -> None:
    assert dir(room) == sorted(room.__all__)
    for name in room.__all__:
        assert getattr(room, name) is not None, name


def test_every_public_name_of_rejection_is_a_function_or_a_class() -> None:
    for name in dir(rejection):
        thing = getattr(rejection, name)
        assert inspect.isfunction(thing) or inspect.isclass(thing), name
        assert thing.__name__ == name
        assert inspect.getdoc(thing), name


def test_functions_of_rejection_and_imaging_take_one_cube_by_position() -> None:
    for room in (rejection, amulor.imaging):
        for name in dir(room):
            thing = getattr(room, name)
            # Two cubes, told apart by what they are, stand side by side.
            # The register takes names of methods.
            if name in ("with_open_water", "load", "method", "names"):
                continue
            if not inspect.isfunction(thing):
                continue
            first, *rest = inspect.signature(thing).parameters.values()
            assert first.kind is first.POSITIONAL_OR_KEYWORD
            assert all(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in rest), name


def test_the_fit_of_the_water_and_the_import_of_histograms_are_reached() -> None:
    assert rejection.water_fit.__module__.startswith("amulor.rejection")
    assert amulor.io.read_transients.__module__ == "amulor.io.transients"
