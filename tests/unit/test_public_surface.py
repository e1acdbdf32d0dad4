"""What `import amulor` offers: nothing goes, and nothing comes, without being seen."""

import ast
import importlib
import re
import runpy
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import amulor

ROOT = Path(__file__).parents[2]
TOOL = runpy.run_path(str(ROOT / "tools" / "public_surface.py"))

#: What programs outside this repository call; changing one breaks them.
PINNED = [
    "amulor.Survey.from_toml",
    "amulor.acquisition.acquire",
    "amulor.errors.AmulorError",
    "amulor.imaging.point_cloud",
    "amulor.imaging.range_image",
    "amulor.io.read_transients",
    "amulor.optics.interference.target_signal",
    "amulor.optics.low_pass.cut_off",
    "amulor.optics.low_pass.fit",
    "amulor.optics.ranging.slant_range",
    "amulor.optics.small_angle.water_response",
    "amulor.optics.small_angle_diffusion.water_response",
    "amulor.read_cube",
    "amulor.rejection.joint",
    "amulor.rejection.open_water",
    "amulor.rejection.water_fit",
    "amulor.simulate",
    "amulor.simulation.simulate",
    "amulor.survey.Survey",
    "amulor.transport.simulate",
    "amulor.units.parse",
    "amulor.view.write_report",
    "amulor.write_cube",
]


def test_the_public_names_are_those_of_the_listing() -> None:
    listed = set(TOOL["LISTING"].read_text().splitlines())
    there = set(TOOL["surface"]())
    gone, new = sorted(listed - there), sorted(there - listed)
    assert not gone, f"public names are gone or of another kind: {gone}"
    assert not new, f"names not in the listing, write it anew by `make surface`: {new}"


def test_defaults_are_those_of_the_listing() -> None:
    # Whoever leaves an argument or a key out gets another result with another default.
    listed = set(TOOL["DEFAULTS"].read_text().splitlines())
    there = set(TOOL["defaults"]())
    assert sorted(listed - there) == [], "defaults are gone or of another value"
    assert sorted(there - listed) == [], "write the listing anew by `make surface`"


def test_constants_are_those_of_the_listing() -> None:
    # A threshold that moves is a decision: it stands in the listing, too.
    listed = set(TOOL["CONSTANTS"].read_text("utf-8").splitlines())
    there = set(TOOL["constants"]())
    assert sorted(listed - there) == [], "constants are gone or of another value"
    assert sorted(there - listed) == [], "write the listing anew by `make surface`"


#: Each name from the first import on, so that none is there by another's doing.
FRESH = """
import sys, warnings
warnings.simplefilter("ignore")  # the accessor of xarray is registered again
for name in sys.argv[1:]:
    for module in [one for one in sys.modules if one.split(".")[0] == "amulor"]:
        del sys.modules[module]
    import amulor
    try:
        assert callable(eval(name)), "no function"
    except (AttributeError, AssertionError) as error:
        print(f"{name}: {error}")
"""


@pytest.mark.slow
@pytest.mark.study
def test_attribute_access_alone_reaches_what_others_call() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FRESH, *PINNED],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == ""


def _reached() -> Iterator[tuple[Any, list[str]]]:
    """Yield what examples of the guides import of amulor, and what they read of it."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs/how-to").glob("*.md"))]:
        for code in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.S):
            known: dict[str, Any] = {}
            for node in ast.parse(code).body:
                words = ast.unparse(node)
                if re.match(r"(import|from) amulor\b", words):
                    exec(words, known)
            for each in ast.walk(ast.parse(code)):
                first, *names = ast.unparse(each).split(".")
                if isinstance(each, ast.Attribute) and isinstance(
                    known.get(first), types.ModuleType
                ):
                    yield known[first], names


def test_examples_of_the_guides_reach_what_is_public() -> None:
    found = list(_reached())
    assert any(names == ["measure", "height"] for _, names in found)
    for module, names in found:
        within: Any = module
        for name in names:
            # Another import may have put it there: only what is listed always is.
            assert name in getattr(within, "__all__", dir(within)), (module, names)
            within = getattr(within, name)


def test_tab_completion_shows_what_is_public_and_only_that() -> None:
    code = "import amulor; print([n for n in dir(amulor) if n[:2] != '__'])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(sorted(amulor.__all__))


@pytest.mark.parametrize("package", ["amulor", "amulor.optics", "amulor.rejection"])
def test_tab_completion_of_a_package_hides_internal_modules(package: str) -> None:
    module = importlib.import_module(package)
    shown = [name for name in dir(module) if not name.startswith("__")]
    assert shown == sorted(module.__all__)


@pytest.mark.parametrize(
    "name",
    [
        "acquisition.settings", "cube", "handover", "handover.archive", "imaging",
        "imaging.measure", "imaging.products", "io", "platform", "rejection", "site",
    ],
)  # fmt: skip
def test_a_package_shows_its_public_names_alone(name: str) -> None:
    package = importlib.import_module(f"amulor.{name}")
    assert dir(package) == sorted(package.__all__)
    assert len(package.__all__) > 0
