"""Cubes made by hand: phasors of known target and water, with open-water shots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.constants import speed_of_light

from amulor import cube as cubes

GROUP_INDEX = 1.38


def make(
    rng: np.random.Generator,
    *,
    frequency: list[float],
    channels: dict[str, tuple[float, float]],
    target: float = 1.0,
    water: float = 0.2,
    cut_off: float = 30e6,
    distance: float = 1.5,
    shape: tuple[int, int] = (6, 8),
    noise: float = 2e-3,
    shots: int = 60,
    reference_water: float | None = None,
    drift: float = 0.0,
) -> xr.Dataset:
    """Return samples whose channels hold known shares of target and water.

    Channels map to (share of the target, share of the water). The water signal is a
    first-order low-pass of its own, and the reference may be of another strength.
    """
    f = np.asarray(frequency)[:, None, None, None]
    phase = 4 * np.pi * f * GROUP_INDEX * distance / speed_of_light
    shares = np.array(list(channels.values())).T[:, None, :, None, None]
    own = water / (1 - 1j * f / cut_off)
    clean = target * np.exp(1j * phase) * shares[0] + own * shares[1]
    clean = clean * np.ones((len(frequency), len(channels), *shape))
    strength = water if reference_water is None else reference_water
    order = np.linspace(-0.5, 0.5, shots)
    reference = strength / (1 - 1j * f[..., 0] / cut_off) * shares[1][..., 0]
    reference = reference * (1 + drift * order)

    def noisy(values: np.ndarray) -> dict[str, np.ndarray]:
        error = rng.standard_normal(values.shape) + 1j * rng.standard_normal(
            values.shape
        )
        measured = values + noise * error
        stated = np.full(values.shape, noise)
        return {
            "in_phase": measured.real,
            "quadrature": measured.imag,
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
        }

    azimuth, elevation = np.meshgrid(
        np.linspace(-0.02, 0.02, shape[1]), np.linspace(0.01, -0.01, shape[0])
    )
    cube = cubes.build(
        "samples",
        {**noisy(clean), "saturated": np.zeros(clean.shape, np.int8)},
        {
            "modulation_frequency": np.asarray(frequency),
            "polarization": list(channels),
            "azimuth": azimuth,
            "elevation": elevation,
        },
        geometry={
            "group_index": GROUP_INDEX,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )
    if shots:
        # The four corners in turn, so that first and last shots can be compared.
        corner = np.arange(shots) % 4
        places = {
            "azimuth": np.where(corner % 2, 0.02, -0.02),
            "elevation": np.where(corner // 2, 0.01, -0.01),
        }
        cube = cubes.attach(
            cube, cubes.open_water(noisy(reference) | places), "open_water"
        )
    return cube


@pytest.fixture(scope="session")
def by_hand() -> Callable[..., xr.Dataset]:
    """Return the function that makes a cube by hand."""

    def build(seed: int = 1, **arguments: Any) -> xr.Dataset:
        return make(np.random.default_rng(seed), **arguments)

    return build
