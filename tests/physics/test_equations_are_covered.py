"""Each equation of Ricci et al. 2010 has a public function that says so.

The index is made from the docstrings of the public functions, classes and methods of
`amulor.optics`: "eq. (46)", "eqs. (54) and (58)", "eqs. (55)-(57)", where the docstring
or that of its module names the paper.
"""

import importlib
import inspect
import pkgutil
import re

import pytest

import amulor.optics

LAST = 72
WATER_SIGNAL = "small_angle.gaussian_receiver.water_response"
DIFFUSION_OVERLAP = "small_angle_diffusion.response.overlap"

# Steps of the derivation that compute nothing by themselves: what each is, and the
# function that computes what it leads to.
STEPS = {
    6: ("transport equation in time", "modulated_light.complex_attenuation"),
    11: (
        "radiance in two parts, forward and diffuse",
        WATER_SIGNAL,
    ),
    12: ("one diffuse scattering only", WATER_SIGNAL),
    13: (
        "both parts by Green's function",
        WATER_SIGNAL,
    ),
    14: (
        "reciprocity of Green's function",
        WATER_SIGNAL,
    ),
    15: (
        "received power by reciprocity",
        WATER_SIGNAL,
    ),
    16: (
        "small angles in place of directions",
        "small_angle.transforms.layer_transfer",
    ),
    30: ("eq. (26) once more", WATER_SIGNAL),
    41: ("S(z), in eq. (43)", DIFFUSION_OVERLAP),
    42: (
        "eq. (40) integrated, before the areas",
        DIFFUSION_OVERLAP,
    ),
}

CITATION = re.compile(r"\b[Ee]qs?\. ((?:\(\d+\)(?:-|, and |, | and | to )?)+)")


def cited(text):
    """Return the equation numbers that a text cites."""
    found = set()
    for group in CITATION.findall(" ".join(text.split())):
        previous = None
        for number, dash in re.findall(r"\((\d+)\)(-| to )?", group):
            first = int(number) if previous is None else previous
            found.update(range(first, int(number) + 1))
            previous = int(number) if dash else None
    return found


def docstrings():
    """Return name and docstring, and that of the module, of all that is public."""
    for info in pkgutil.walk_packages(amulor.optics.__path__, "amulor.optics."):
        short = info.name.removeprefix("amulor.optics.")
        if "._" in info.name:
            continue
        module = importlib.import_module(info.name)
        for name, thing in vars(module).items():
            own = getattr(thing, "__module__", None) == module.__name__
            if name.startswith("_") or not own or not callable(thing):
                continue
            yield f"{short}.{name}", inspect.getdoc(thing) or "", module.__doc__
            if inspect.isclass(thing):
                for method, function in vars(thing).items():
                    if not method.startswith("_") and inspect.isfunction(function):
                        text = inspect.getdoc(function) or ""
                        yield f"{short}.{name}.{method}", text, module.__doc__


@pytest.fixture(scope="module")
def citations():
    """Return the public functions that cite each equation number."""
    numbers = {}
    for name, text, module in docstrings():
        if "Ricci" in text or "Ricci" in (module or ""):
            for number in cited(text):
                numbers.setdefault(number, []).append(name)
    return numbers


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Eq. (46) of Ricci et al.", {46}),
        ("eqs. (54) and (58)", {54, 58}),
        ("Eqs. (55)-(57), eq. (2)", {2, 55, 56, 57}),
        ("eqs.\n    (47) and (48); its mean is eq. (44)", {44, 47, 48}),
        ("eqs. (35)-(36) and (40)", {35, 36, 40}),
        ("Bohren and Huffman, eq. (4.77), chapter (4)", set()),
    ],
)
def test_citations_are_read_as_they_are_written(text, expected):
    assert cited(text) == expected


@pytest.mark.parametrize("number", range(1, LAST + 1))
def test_each_equation_has_a_public_function(number, citations):
    assert number in citations or number in STEPS, (
        f"eq. ({number}) is cited by no public function of amulor.optics"
    )


def test_no_equation_beyond_the_last_one_is_cited(citations):
    assert max(citations) <= LAST


def test_steps_of_the_derivation_lead_to_public_functions_with_equations():
    texts = {name: text for name, text, _ in docstrings()}
    for number, (_, name) in STEPS.items():
        assert cited(texts[name]), f"eq. ({number}) leads to {name}, which cites none"


def test_what_counts_as_a_step_is_cited_by_no_function(citations):
    # One that is computed after all belongs into the docstring alone.
    assert set(STEPS).isdisjoint(citations)
