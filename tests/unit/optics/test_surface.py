"""What `amulor.optics` shows of itself: rooms by attribute, nothing imported early."""

from __future__ import annotations

import importlib
import subprocess
import sys
import types

import pytest

import amulor

ROOMS = ["phase_functions", "polarization", "small_angle", "small_angle_diffusion"]
ROOMS = ["", *ROOMS, "water"]


def _room(name: str) -> types.ModuleType:
    return importlib.import_module(".".join(filter(None, ["amulor.optics", name])))


@pytest.mark.parametrize("name", ROOMS)
def test_the_list_of_a_room_is_what_can_be_reached(name):
    room = _room(name)
    listed = [public for public in dir(room) if not public.startswith("__")]
    assert listed == sorted(room.__all__)
    for public in listed:
        assert getattr(room, public) is not None
    with pytest.raises(AttributeError, match=r"no attribute 'no_such_name'"):
        _ = room.no_such_name


@pytest.mark.parametrize("name", ROOMS)
def test_every_public_file_of_a_room_is_on_its_list(name):
    room = _room(name)
    (folder,) = room.__path__
    import pkgutil

    files = {file.name for file in pkgutil.iter_modules([folder])}
    public = {file for file in files if not file.startswith("_")}
    assert public <= set(room.__all__)


def _fresh(code: str) -> str:
    """Return what a new interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_formulas_are_reached_by_attribute():
    code = (
        "import amulor; o = amulor.optics;"
        "print(o.ranging.slant_range.__name__, o.water.seawater.__name__,"
        "o.phase_functions.mie.__name__, o.small_angle.water_response.__module__)"
    )
    assert _fresh(code) == (
        "slant_range amulor.optics.water.seawater "
        "amulor.optics.phase_functions.mie amulor.optics.small_angle.gaussian_receiver"
    )


def test_the_room_itself_imports_nothing_heavy():
    code = (
        "import sys, amulor.optics;"
        "print([m for m in ('numpy', 'scipy', 'numba') if m in sys.modules])"
    )
    assert _fresh(code) == "[]"


@pytest.mark.slow
@pytest.mark.parametrize(
    "first",
    [
        "import amulor.optics.phase_functions.henyey_greenstein",
        "import amulor.optics.phase_functions.models",
        "from amulor.optics.phase_functions import henyey_greenstein",
        "from amulor.optics.phase_functions.henyey_greenstein import forward_split",
        "import amulor.optics.small_angle.gaussian_receiver",
        "import amulor; amulor.optics.phase_functions.mie",
    ],
)
def test_henyey_greenstein_is_the_function_whatever_is_imported_first(first):
    code = (
        f"{first}\nimport amulor.optics.phase_functions.henyey_greenstein\n"
        "from amulor.optics import phase_functions as p\n"
        "print(type(p.henyey_greenstein).__name__)"
    )
    assert _fresh(code) == "function"


def test_water_response_is_pinned():
    for module in (
        amulor.optics.small_angle,
        amulor.optics.small_angle_closure,
        amulor.optics.small_angle_diffusion,
    ):
        assert callable(module.water_response)
        assert callable(module.overlap)
