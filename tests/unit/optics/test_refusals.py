"""Every public formula: what NaN, infinity, -1 and wrong shapes do, in one wording."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import amulor.optics
from amulor.optics.phase_functions.models import henyey_greenstein_function

# Where a closed form does not hold has tests of its own.
pytestmark = pytest.mark.filterwarnings("ignore::amulor.errors.AmulorWarning")

# One value that is fine for each argument name of optics.
GOOD = {
    "absorption": 0.1,
    "absorption_at_440": 0.01,
    "acceptance_angle": 0.08,
    "amplitude": 1.0,
    "angle": 0.3,
    "asymmetry": 0.9,
    "attenuation": 0.5,
    "axis_error": 0.01,
    "azimuth": 0.1,
    "backscatter_vsf": 1e-3,
    "backscatter_fraction": 0.0183,
    "backward_asymmetry": -0.5,
    "bandwidth": 1e-9,
    "baseline": 0.1,
    "beam_divergence": 0.001,
    "beam_radius": 0.001,
    "cdom_slope": 0.014e9,
    "chlorophyll": 1.0,
    "cosine": 0.9,
    "covariance": 0.0,
    "cross_angle": 0.01,
    "cross_tilt": 0.01,
    "cut_off": 2e7,
    "dark_rate": 1.0,
    "density": 998.0,
    "depolarization": 0.04,
    "depth": 1.5,
    "diattenuation": 0.1,
    "diffuse_attenuation": 0.1,
    "diffuse_scattering": 0.1,
    "direction_frequency": 3.0,
    "distance": 3.0,
    "duration": 0.1,
    "dwell": 0.1,
    "elevation": 0.1,
    "end": 5.0,
    "excess_noise_factor": 1.2,
    "extinction_ratio": 0.01,
    "forward_asymmetry": 0.9,
    "forward_scattering": 0.3,
    "forward_weight": 0.9,
    "group_depth": 1.0,
    "group_index": 1.38,
    "in_phase_variance": 1.0,
    "incidence": 0.5,
    "integration_time": 0.1,
    "m12": 0.0,
    "m22": 0.6,
    "m33": -0.6,
    "m34": 0.0,
    "m44": -0.4,
    "mean_power": 0.02,
    "mean_response": 1.0,
    "medium_index": 1.34,
    "mie_above": 10.0,
    "modulation_depth": 0.5,
    "modulation_frequency": 4e7,
    "offset": 0.01,
    "optical_path": 6.0,
    "parallel": 1.0,
    "perpendicular": 0.5j,
    "phase": 1.0,
    "phase_floor": 1e-3,
    "phase_uncertainty": 0.01,
    "photoelectron_rate": 1e6,
    "photoelectrons": 1e6,
    "plate_error": 0.01,
    "power": 1e-6,
    "quadrature_variance": 1.0,
    "quantum_efficiency": 0.2,
    "radiance": 1e7,
    "radius": 1e-6,
    "rayleigh_below": 0.1,
    "receiver_area": 1e-3,
    "receiver_radius": 0.02,
    "reduced_attenuation": 0.5,
    "reflectance": 0.3,
    "reflection": 0.4,
    "refractive_index": 1.34,
    "refractive_index_behind": 1.5,
    "relative_index": 1.1,
    "residual": 0.1,
    "response": 0.5,
    "retardance": 1.0,
    "retardance_error": 0.01,
    "rms_slope": 0.1,
    "roughness": 0.3,
    "salinity": 35.0,
    "scattering": 0.3,
    "second_moment": 0.05,
    "settling": 5.0,
    "signal": 1.0,
    "size_parameter": 1.0,
    "slant_range": 2.0,
    "slope": 3.6,
    "solid_angle": 0.02,
    "spatial_frequency": 10.0,
    "speckle_cells": 100.0,
    "split_angle": 1.5,
    "standoff": 0.1,
    "target_amplitude": 1.0,
    "target_phase": 0.5,
    "target_signal": 1.0,
    "temperature": 20.0,
    "tilt": 0.01,
    "time": 1e-8,
    "time_constant": 0.1,
    "transmission": 0.8,
    "volt_per_photoelectron_rate": 1e-9,
    "volume_fraction": 1e-4,
    "water_amplitude": 0.5,
    "water_phase": 0.1,
    "water_signal": 0.2,
    "wavelength": 450e-9,
}
# What is no number, or no single one, but needed.
OTHERS = {
    "fat": 0.015,
    "kind": "skim",
    "pair": "VH",
    "state": "H",
    "mueller": np.diag([1.0, 0.6, -0.6, -0.4]),
    "stokes": np.array([1.0, 0.2, 0.1, 0.3]),
    "phase_function": henyey_greenstein_function(asymmetry=0.9),
    "vsf": lambda angle: 1e-3 + 0 * angle,
    "source": "solonenko-mobley-2015",
    "station": "AUTEC 7",
    "name": "AUTEC 7",
    "water_type": "III",
}
# Values of functions that call these names differently.
OWN = {
    "state": {"name": "H"},
    "scattering_regime": {"size_parameter": 1.0},
    "rayleigh_phase": {"depolarization": 0.1},
    "backscatter_direction": {"depth": 1.5},
}
# Samples, which may be missing: NaN goes in and NaN comes out.
MEASURED = {
    "amplitude", "covariance", "distance", "dark_rate", "in_phase_variance",
    "parallel", "perpendicular", "phase", "phase_uncertainty", "photoelectron_rate",
    "photoelectrons", "power", "quadrature_variance", "residual", "signal",
    "slant_range", "target_amplitude", "target_phase", "target_signal",
    "water_amplitude", "water_phase", "water_signal",
}  # fmt: skip
# Functions of a whole sweep, which have tests of their own.
SWEEPS = {
    "cut_off", "cut_off_of_sweep", "fit", "fit_if_shown", "fit_of_power", "find",
    "group_depth",
    "ripple", "tabulated", "from_cumulative", "size_distribution", "amplitudes",
    "sphere", "gauss_legendre", "forward_split", "optical_path", "enter_water",
    "return_distance", "return_length", "slant_range_of_path", "path_limits",
    "maximum_distance",
    "weights_and_uncertainty", "response", "fewest",
    "range_profile", "resolution", "surfaces", "unambiguous_span",
    "matched_filter", "photon_arrivals", "side_lobe", "time_bound",
    "mixture",
}  # fmt: skip
WORDING = re.compile(
    r"^[^\n]+ must be [^\n]+?( \[[^\]]+\])?"
    r", got \S+( at index \([\d, ]+\))?(; [^\n]+)?$"
)


def _functions():
    """Return the public functions of numbers by name, from every public file."""
    found = {}
    for file in pkgutil.walk_packages(amulor.optics.__path__, "amulor.optics."):
        if any(part.startswith("_") for part in file.name.split(".")):
            continue
        module = importlib.import_module(file.name)
        for name, value in vars(module).items():
            own = getattr(value, "__module__", "") == file.name
            if not (inspect.isfunction(value) and own) or name.startswith("_"):
                continue
            if name not in SWEEPS:
                found[f"{file.name.removeprefix('amulor.optics.')}.{name}"] = value
    return found


FUNCTIONS = _functions()


def _call(function, **changes):
    """Call a function with good values, but for the changes."""
    names = inspect.signature(function).parameters
    good = GOOD | OTHERS | OWN.get(function.__name__, {})
    given = {
        name: good[name]
        for name, parameter in names.items()
        if name in good or parameter.default is inspect.Parameter.empty
    }
    given |= changes
    first = [
        given.pop(name)
        for name, parameter in names.items()
        if parameter.kind is not inspect.Parameter.KEYWORD_ONLY
    ]
    return function(*first, **given)


def _numbers(function):
    """Return the names of the arguments that are numbers."""
    return [name for name in inspect.signature(function).parameters if name in GOOD]


def _arrays(function):
    """Return those that may be arrays."""
    parameters = inspect.signature(function).parameters
    return [
        name
        for name in _numbers(function)
        if "ArrayLike" in parameters[name].annotation
    ]


CASES = [(name, argument) for name, f in FUNCTIONS.items() for argument in _numbers(f)]


def test_good_values_are_good_and_most_functions_are_looked_at():
    assert len(FUNCTIONS) > 60
    assert len(CASES) > 250
    for function in FUNCTIONS.values():
        _call(function)


def test_each_name_is_an_argument_of_some_function():
    used = {argument for _, argument in CASES}
    assert used == set(GOOD)
    assert used > MEASURED


@pytest.mark.parametrize(("name", "argument"), CASES)
def test_what_is_no_number_is_refused_unless_it_is_a_missing_sample(name, argument):
    function = FUNCTIONS[name]
    if argument in MEASURED:
        result = _call(function, **{argument: np.nan})
        parts = result if isinstance(result, tuple) else (result,)
        assert any(np.isnan(part).any() for part in parts)
        return
    with pytest.raises(ValueError, match=rf"\b{argument} must be .*, got nan") as error:
        _call(function, **{argument: np.nan})
    assert WORDING.match(str(error.value)), error.value


@pytest.mark.parametrize("value", [np.inf, -np.inf, -1.0])
@pytest.mark.parametrize(("name", "argument"), CASES)
def test_what_is_out_of_range_is_refused_in_one_wording(name, argument, value):
    refusal, result = _outcome(FUNCTIONS[name], {argument: value})
    if refusal is None:
        infinite = argument == "end" or argument in MEASURED
        assert infinite or np.isfinite(value)
        assert result is not None
        return
    assert argument in refusal
    assert WORDING.match(refusal), refusal


def _outcome(function, changes):
    """Return why a call was refused, or None and what came of it."""
    try:
        with np.errstate(all="ignore"):
            return None, _call(function, **changes)
    except ValueError as error:
        return str(error), None


@cache
def _ranges():
    """Return the ranges of arguments, by argument, or by function and argument."""
    file = Path(__file__).parents[2] / "reference" / "argument_ranges.txt"
    lines = file.read_text("utf-8").splitlines()
    return dict(line.split(": ", 1) for line in lines if not line.startswith("#"))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_refusals_state_the_range_and_unit_of_their_argument(name):
    for argument in set(_numbers(FUNCTIONS[name])) - MEASURED - {"end", "response"}:
        rule = _ranges().get(f"{name} {argument}", _ranges().get(argument))
        refusal, _ = _outcome(FUNCTIONS[name], {argument: np.inf})
        assert refusal is not None
        assert refusal.partition(", got inf")[0] == f"{argument} must be {rule}"


def test_each_stated_range_is_that_of_an_argument():
    known = {f"{name} {argument}" for name, argument in CASES}
    assert set(_ranges()) <= known | {argument for _, argument in CASES}


@pytest.mark.parametrize(
    "name", [name for name, f in FUNCTIONS.items() if len(_arrays(f)) > 1]
)
def test_shapes_that_do_not_broadcast_are_refused_by_name(name):
    function = FUNCTIONS[name]
    names = _arrays(function)
    for one, other in pairwise(names):
        good = GOOD | OWN.get(function.__name__, {})
        changes = {one: np.full(2, good[one]), other: np.full(3, good[other])}
        with pytest.raises(ValueError, match=r"must have shapes that broadcast, got"):
            _call(function, **changes)


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, f in FUNCTIONS.items()
        if {"mueller", "stokes"} & set(inspect.signature(f).parameters)
    ],
)
def test_matrices_and_vectors_of_another_length_are_refused(name):
    function = FUNCTIONS[name]
    for argument in {"mueller", "stokes"} & set(inspect.signature(function).parameters):
        text = rf"^{argument} must have last axes \(4,"
        for wrong in (np.ones((4, 3)), np.ones(3), 1.0):
            with pytest.raises(ValueError, match=text):
                _call(function, **{argument: wrong})
