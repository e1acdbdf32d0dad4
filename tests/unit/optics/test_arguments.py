"""Arguments of the small-angle models: order is free, none takes another's place."""

from __future__ import annotations

import dataclasses
import itertools
from functools import partial

import numpy as np
import pytest
import sharp_receiver_2d
import water_response_2d
import water_response_mpmath
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics import (
    small_angle,
    small_angle_closure,
    small_angle_diffusion,
    target_echo,
)
from amulor.optics._water_column import Receiver
from amulor.optics.phase_functions import henyey_greenstein
from amulor.optics.small_angle import _columns, sharp_receiver
from amulor.optics.small_angle import _kernels as gaussian_kernels
from amulor.optics.small_angle import _sharp_kernels as sharp_kernels
from amulor.optics.small_angle._columns import LOOK, Arguments
from amulor.optics.small_angle._columns import Column as SmallAngleColumn
from amulor.optics.small_angle_diffusion import _kernels as diffusion_kernels
from amulor.optics.small_angle_diffusion import impulse_response
from amulor.optics.small_angle_diffusion.response import _Column as DiffusionColumn

# No two values are alike, so that each exchange of two shows.
RECEIVER = {
    "baseline": 0.11,
    "receiver_radius": 0.023,
    "acceptance_angle": 0.081,
    "tilt": 0.031,
    "cross_tilt": 0.017,
    "standoff": 0.29,
}
DIFFUSION = {
    "absorption": 0.13,
    "forward_scattering": 0.37,
    "diffuse_scattering": 0.07,
    "second_moment": 0.053,
}
LIGHT = {"backscatter_vsf": 1.3e-3, "group_index": 1.36}
SCATTERER = {
    "phase_function": partial(henyey_greenstein, asymmetry=0.95),
    "split_angle": 1.3,
}
WATER = {"absorption": 0.13, "scattering": 0.41}
BEAM = {"beam_radius": 0.004, "beam_divergence": 0.0021}
TARGET = {"depth": 2.3, "optical_path": 7.1, "reflectance": 0.4, "cosine": 0.9}

_SMALL = WATER | RECEIVER | BEAM | SCATTERER
FUNCTIONS = {
    "diffusion response": (
        small_angle_diffusion.water_response,
        2e7,
        DIFFUSION | RECEIVER | LIGHT | {"end": 4.7},
    ),
    "diffusion tail": (
        small_angle_diffusion.water_tail,
        2e7,
        DIFFUSION | RECEIVER | LIGHT | {"end": 4.7},
    ),
    "diffusion overlap": (small_angle_diffusion.overlap, 2.3, DIFFUSION | RECEIVER),
    "narrow receiver": (
        small_angle_diffusion.narrow_receiver_response,
        2e7,
        LIGHT
        | {"absorption": 0.13, "diffuse_scattering": 0.07, "acceptance_angle": 0.01},
    ),
    "impulse response": (
        impulse_response.impulse_response,
        2e-8,
        DIFFUSION | RECEIVER | LIGHT,
    ),
    "Gaussian response": (small_angle.water_response, 2e7, _SMALL | LIGHT),
    "Gaussian overlap": (small_angle.overlap, 2.3, _SMALL),
    "closure response": (small_angle_closure.water_response, 2e7, _SMALL | LIGHT),
    "closure overlap": (small_angle_closure.overlap, 2.3, _SMALL),
    "sharp response": (sharp_receiver.water_response, 2e7, _SMALL | LIGHT),
    "sharp overlap": (sharp_receiver.overlap, 2.3, _SMALL),
    "diffusion echo": (
        target_echo.target_response,
        2e7,
        DIFFUSION | RECEIVER | TARGET,
    ),
    "Gaussian echo": (target_echo.small_angle_target_response, 2e7, _SMALL | TARGET),
    "closure echo": (target_echo.closure_target_response, 2e7, _SMALL | TARGET),
    "sharp echo": (target_echo.sharp_receiver_target_response, 2e7, _SMALL | TARGET),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@settings(deadline=None, max_examples=5)
@given(data=st.data())
def test_the_order_of_keywords_does_not_matter(name, data):
    function, first, keywords = FUNCTIONS[name]
    order = data.draw(st.permutations(list(keywords)))
    expected = function(first, **keywords)
    assert_array_equal(
        function(first, **{key: keywords[key] for key in order}), expected
    )


@pytest.mark.parametrize("kind", [Receiver, DiffusionColumn, Arguments])
@settings(deadline=None)
@given(data=st.data())
def test_a_class_of_arguments_keeps_each_under_its_name(kind, data):
    values = DIFFUSION | WATER | RECEIVER | BEAM | {"end": 4.7}
    names = [field.name for field in dataclasses.fields(kind)]
    order = data.draw(st.permutations(names))
    column = kind(**{name: values[name] for name in order})
    assert column.named() == {name: values[name] for name in names}
    with pytest.raises(TypeError, match="positional"):
        kind(*(values[name] for name in names))
    with pytest.raises(dataclasses.FrozenInstanceError):
        column.baseline = 1.0


# ------------------------------------------- an exchange anywhere would not go unseen


def _exchanged(original, one, other):
    """Return what makes a bundle in which two fields have each other's value."""

    def make(**fields):
        fields[one], fields[other] = fields[other], fields[one]
        return original(**fields)

    return make


def _pairs(bundle, without=()):
    fields = [name for name in bundle._fields if name not in without]
    return list(itertools.combinations(fields, 2))


FREQUENCIES = [3e7]
COLUMN = DIFFUSION | RECEIVER
OVERLAP_DEPTH = 2.3


@pytest.fixture(scope="module")
def diffusion_oracle():
    """Return a response in 30 digits by the oracle, whose arguments go by name."""
    column = water_response_mpmath.Column(
        **COLUMN, group_index=LIGHT["group_index"], end=4.7
    )
    return complex(water_response_mpmath.integrals(column, FREQUENCIES)[1])


def _diffusion():
    found = small_angle_diffusion.water_response(
        FREQUENCIES, **COLUMN, **LIGHT, end=4.7
    )
    return found[0] / LIGHT["backscatter_vsf"]


def test_the_diffusion_form_is_that_of_the_oracle(diffusion_oracle):
    assert_allclose(_diffusion(), diffusion_oracle, rtol=1e-12)


@pytest.mark.parametrize(("one", "other"), _pairs(diffusion_kernels.Geometry))
def test_two_exchanged_arguments_of_the_diffusion_form_show(
    one, other, diffusion_oracle, monkeypatch
):
    make = _exchanged(diffusion_kernels.Geometry, one, other)
    monkeypatch.setattr(diffusion_kernels, "Geometry", make)
    assert abs(_diffusion() / diffusion_oracle - 1) > 1e-4


def _gaussian():
    return small_angle.overlap(OVERLAP_DEPTH, **_SMALL)


@pytest.fixture(scope="module")
def gaussian_oracle():
    """Return F(z) of the Gaussian receiver by plain quadrature."""
    fraction, integrated = water_response_2d.integrated_transform(
        SCATTERER["phase_function"], SCATTERER["split_angle"], 900.0
    )
    column = WATER | RECEIVER | BEAM
    value = water_response_2d.overlap(
        np.array([OVERLAP_DEPTH]), integrated, fraction=fraction, **column
    )
    own = RECEIVER["receiver_radius"] * RECEIVER["acceptance_angle"]
    return float(np.pi * own**2 * value[0])


@pytest.mark.slow
def test_the_small_angle_form_is_that_of_the_oracle(gaussian_oracle):
    assert_allclose(_gaussian(), gaussian_oracle, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), _pairs(gaussian_kernels.Water, LOOK))
def test_two_exchanged_arguments_of_the_small_angle_form_show(
    one, other, gaussian_oracle, monkeypatch
):
    make = _exchanged(gaussian_kernels.Water, one, other)
    monkeypatch.setattr(gaussian_kernels, "Water", make)
    assert abs(_gaussian() / gaussian_oracle - 1) > 1e-4


@pytest.mark.parametrize(("one", "other"), list(itertools.combinations(LOOK, 2)))
def test_two_exchanged_columns_of_how_depths_are_looked_at_show(
    one, other, gaussian_oracle, sharp_oracle, monkeypatch
):
    names = {one: other, other: one}
    monkeypatch.setattr(_columns, "LOOK", [names.get(n, n) for n in LOOK])
    assert abs(_gaussian() / gaussian_oracle - 1) > 1e-4
    assert abs(_sharp() / sharp_oracle - 1) > 1e-6


def _sharp():
    return sharp_receiver.overlap(OVERLAP_DEPTH, **_SMALL)


@pytest.fixture(scope="module")
def sharp_oracle():
    """Return F(z) of the receiver with sharp edges by plain quadrature."""
    fraction, mean = sharp_receiver_2d.mean_transform(
        SCATTERER["phase_function"], SCATTERER["split_angle"]
    )
    column = WATER | RECEIVER | BEAM
    return float(
        sharp_receiver_2d.collected(
            OVERLAP_DEPTH, column, fraction, mean, SCATTERER["split_angle"]
        )
    )


def test_the_form_with_sharp_edges_is_that_of_the_oracle(sharp_oracle):
    assert_allclose(_sharp(), sharp_oracle, rtol=1e-6)


@pytest.mark.parametrize(("one", "other"), _pairs(sharp_kernels.Water))
def test_two_exchanged_arguments_of_the_form_with_sharp_edges_show(
    one, other, sharp_oracle, monkeypatch
):
    make = _exchanged(sharp_kernels.Water, one, other)
    monkeypatch.setattr(sharp_kernels, "Water", make)
    assert abs(_sharp() / sharp_oracle - 1) > 1e-6


@pytest.mark.parametrize(
    "form", [small_angle, small_angle_closure, sharp_receiver], ids=lambda f: f.__name__
)
def test_depths_that_are_looked_at_each_in_its_own_way_are_what_they_are_alone(form):
    # Twelve pixels of two waters, one of them at the very start of the water.
    rng = np.random.default_rng(3)
    depth = np.append(0.0, rng.uniform(0.2, 3.0, 11)).reshape(3, 4)
    view = {
        name: _SMALL[name] * rng.uniform(0.5, 1.5, depth.shape)
        for name in ("baseline", "tilt", "cross_tilt", "standoff")
    }
    absorption = np.where(np.arange(4) % 2, 0.1, 0.3)
    together = form.overlap(depth, **_SMALL | view | {"absorption": absorption})
    for index in np.ndindex(depth.shape):
        alone = {name: value[index] for name, value in view.items()}
        alone["absorption"] = absorption[index[1]]
        assert together[index] == form.overlap(depth[index], **_SMALL | alone)


def test_a_column_of_the_small_angle_form_is_made_by_name():
    names = {field.name for field in dataclasses.fields(Arguments)}
    assert names == set(SmallAngleColumn._fields)
