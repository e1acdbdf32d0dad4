"""Small cubes of every level, with values that a wrong order or unit would show."""

import contextlib
from collections.abc import Iterable
from types import SimpleNamespace

import numpy as np
import pytest

from amulor import cube as cubes

GEOMETRY = {
    "group_index": 1.3823,
    "refractive_index": 1.3426,
    "emitter_position": np.array([0.0, 0.0, 0.0]),
    "receiver_position": np.array([0.35, 0.0, 0.0]),
}


def numbers(
    rng: np.random.Generator, names: Iterable[str], shape: tuple[int, ...]
) -> dict[str, np.ndarray]:
    """Return drawn signals, and uncertainties above zero."""
    return {
        name: abs(rng.normal(size=shape))
        if name.endswith("_uncertainty")
        else rng.normal(size=shape)
        for name in names
    }


def attributes(level, **others):
    return cubes.attributes(
        level,
        title="plate in turbid water",
        source="drawn numbers",
        history="2026-01-02T03:04:05Z amulor 0.1.0: simulate plate.toml",
        **others,
    )


def pixel_coordinates(rows, columns):
    azimuth, elevation = np.meshgrid(
        np.linspace(-0.1, 0.1, columns), np.linspace(0.05, -0.05, rows)
    )
    return {
        "azimuth": azimuth,
        "elevation": elevation,
        "time": np.arange(rows * columns, dtype=float).reshape(rows, columns),
    }


def make_samples(
    rng, *, frequencies=(30e6, 60e6), polarizations=("VV", "VH"), rows=3, columns=4
):
    shape = (len(frequencies), len(polarizations), rows, columns)
    names = ("in_phase", "quadrature", "in_phase_uncertainty", "quadrature_uncertainty")
    built = cubes.build(
        "samples",
        numbers(rng, names, shape),
        {
            "modulation_frequency": frequencies,
            "polarization": polarizations,
            **pixel_coordinates(rows, columns),
        },
        geometry=GEOMETRY,
        attributes=attributes("samples", simulated=1, seed=7, survey="[water]\na = 1"),
    )
    shots = cubes.open_water(
        {
            **numbers(rng, names, (*shape[:2], 5)),
            "azimuth": np.linspace(-0.1, 0.1, 5),
        }
    )
    truth = cubes.group(
        built.assign(
            truth_slant_range=(
                ("row", "column"),
                rng.uniform(1, 3, shape[2:]),
                {"units": "m", "long_name": "distance put in"},
            )
        ),
        "truth",
    )
    return cubes.attach(cubes.attach(built, shots, "open_water"), truth, "truth")


def make_target_signal(rng, *, rows=3, columns=4):
    shape = (1, 1, rows, columns)
    names = (
        "in_phase",
        "quadrature",
        "in_phase_uncertainty",
        "quadrature_uncertainty",
        "water_in_phase",
        "water_quadrature",
    )
    return cubes.build(
        "target_signal",
        {
            **numbers(rng, names, shape),
            "quality_flag": rng.integers(0, 64, shape).astype(np.int16),
        },
        {
            "modulation_frequency": [60e6],
            "polarization": ["none"],
            **pixel_coordinates(rows, columns),
        },
        geometry=GEOMETRY,
        attributes=attributes("target_signal"),
    )


def make_range_image(rng, *, rows=3, columns=4):
    shape = (rows, columns)
    slant_range = rng.uniform(1, 3, shape)
    slant_range[0, 0] = np.nan
    return cubes.build(
        "range_image",
        {
            "slant_range": slant_range,
            "slant_range_uncertainty": rng.uniform(1e-4, 1e-3, shape),
            "intensity": rng.uniform(0.1, 1, shape),
            "quality_flag": rng.integers(0, 32, shape).astype(np.int16),
        },
        pixel_coordinates(rows, columns),
        geometry=GEOMETRY,
        attributes=attributes("range_image"),
    )


def make_point_cloud(rng, *, rows=7, columns=9, points=40, quality=True):
    pixels = rng.permutation(rows * columns)[:points]
    variables = {
        "x": rng.uniform(-2, 2, points),
        "y": rng.uniform(-1, 1, points),
        "z": rng.uniform(1, 8, points),
        "intensity": rng.uniform(0.01, 0.7, points),
        "slant_range_uncertainty": rng.uniform(1e-5, 1e-2, points),
        "row": (pixels // columns).astype(np.int32),
        "column": (pixels % columns).astype(np.int32),
    }
    if quality:
        variables["quality_flag"] = rng.integers(0, 32, points).astype(np.int16)
    return cubes.build(
        "point_cloud",
        variables,
        {},
        geometry=GEOMETRY,
        attributes=attributes("point_cloud"),
    )


@pytest.fixture
def rng():
    return np.random.default_rng(20100126)


@pytest.fixture(scope="session")
def make():
    return SimpleNamespace(
        samples=make_samples,
        target_signal=make_target_signal,
        range_image=make_range_image,
        point_cloud=make_point_cloud,
    )


@pytest.fixture
def samples(rng):
    return make_samples(rng)


@pytest.fixture
def point_cloud(rng):
    return make_point_cloud(rng)


@pytest.fixture
def small_disk():
    """Make every write beyond 50 kB of a file fail, as on a full disk."""
    resource = pytest.importorskip("resource")

    @contextlib.contextmanager
    def limited():
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    return limited
