"""Figures of a confirmation: limits on both sides, ratios by matrices, statistics."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.design import confirm as module
from amulor.design.confirm import Confirmation, Photons, Scans
from amulor.errors import SurveyError
from amulor.survey import Survey

HELD = Scans(
    distance=1.5, predicted=1e-3, achieved=1e-3, ratio=1.0, ratio_error=0.0,
    offset=0.0, offset_error=1e-5, residual_bias=0.0, ranges=1000,
)  # fmt: skip


@pytest.mark.parametrize(
    ("ratio", "error", "holds"),
    [
        (0.901, 0.0, True), (0.899, 0.0, False), (1.099, 0.0, True),
        (1.101, 0.0, False), (0.861, 0.02, True), (0.859, 0.02, False),
        (1.139, 0.02, True), (1.141, 0.02, False),
    ],
)  # fmt: skip
def test_a_prediction_holds_within_a_tenth_and_two_errors(
    ratio: float, error: float, holds: bool
) -> None:
    assert replace(HELD, ratio=ratio, ratio_error=error).holds == holds


def photons(**changed: Any) -> Photons:
    values: dict[str, Any] = {
        "histories": 1000, "frequency": np.array([20e6, 60e6]),
        "echo": np.ones(2), "echo_error": np.zeros(2), "shift": np.zeros(2),
        "shift_error": np.zeros(2), "water": np.ones(2), "water_error": np.zeros(2),
    }  # fmt: skip
    return Photons(**values | changed)


def said(late: float = 0.0, accuracy: float = 1e-3, **changed: Any) -> list[str]:
    return module._differences("best", HELD, photons(**changed), late, accuracy)


@pytest.mark.parametrize("name", ["echo", "water"])
def test_light_differs_beyond_a_tenth_and_two_errors(name: str) -> None:
    error: dict[str, Any] = {f"{name}_error": np.array([0.0, 0.03])}
    for off, differs in ((0.159, False), (0.161, True), (-0.161, True)):
        lines = said(**error | {name: np.array([1.05, 1 + off])})
        assert len(lines) == differs
        if differs:
            light = "echo" if name == "echo" else "water before the target"
            assert lines[0] == (
                f"best: by photons the {light} is {1 + off:.2f} ± 0.03 times that of "
                "the model at 60 MHz, which is to be within 10%"
            )


def test_late_light_differs_beyond_twice_its_error_or_a_quarter_of_the_accuracy() -> (
    None
):
    taken = 0.75 / np.hypot(0.0375, 0.5 / np.sqrt(12))
    error = np.array([0.0, 1e-5])
    for limit, late, accuracy in ((2e-4, 1e-4, 1e-4), (2.5e-4, 1e-5, 1e-3)):
        for factor, differs in ((0.999, False), (1.001, True)):
            shift = taken * late + np.array([0.0, factor * limit + 2e-5])
            lines = said(late, accuracy, shift=shift, shift_error=error)
            assert len(lines) == differs
    assert lines[0] == (
        "best: by photons 0.27 ± 0.01 mm of late light is left in ranges at 60 MHz, "
        "with 0.01 mm stated as its uncertainty"
    )


def test_scans_that_scatter_more_are_named_with_their_numbers() -> None:
    wide = replace(HELD, ratio=1.2, ratio_error=0.03, ranges=864)
    assert module._differences("best", wide, None, 0.0, 1e-3) == [
        "best: 864 simulated ranges scatter by 1.20 ± 0.03 of what is predicted, "
        "which is to be 0.9 to 1.1"
    ]


def test_ratios_have_errors_along_and_across_the_light() -> None:
    rng = np.random.default_rng(1)
    parts = rng.standard_normal((4, 5))
    light, expected = parts[0] + 1j * parts[1], parts[2] + 1j * parts[3]
    light[3], expected[4] = 0.0, 0.0
    root = 0.1 * rng.standard_normal((5, 2, 2))
    covariance = root @ root.swapaxes(1, 2)
    ratio, amplitude, turn = module._ratio(light, covariance, expected)
    for k in range(3):
        assert ratio[k] == pytest.approx(light[k] / expected[k])
        direction = np.array([light[k].real, light[k].imag]) / abs(light[k])
        aside = np.array([-direction[1], direction[0]])
        along = np.sqrt(direction @ covariance[k] @ direction)
        across = np.sqrt(aside @ covariance[k] @ aside)
        assert amplitude[k] == pytest.approx(along / abs(expected[k]))
        assert turn[k] == pytest.approx(across / abs(light[k]))
    # Without light nothing is compared.
    assert ratio[3:].tolist() == [1, 1]
    assert amplitude[3:].tolist() == [0, 0]
    assert turn[3:].tolist() == [0, 0]


def test_photons_are_compared_above_frequency_zero() -> None:
    covariance = np.diag([1e-4, 4e-4]) * np.array([9.0, 1.0, 4.0])[:, None, None]
    tally: Any = SimpleNamespace(
        modulation_frequency=np.array([0.0, 20e6, 60e6]),
        target_signal=np.array([5.0, 1.0, 2.0]) + 0j,
        target_covariance=covariance,
        water_signal=np.array([5.0, 3.0, 4.0]) + 0j,
        water_covariance=4 * covariance,
        histories=77,
    )
    turned = np.exp(-0.1j)
    model = np.array([0.5, 2.0]) * turned, np.array([3.0, 2.0]) + 0j
    found = module._compared(tally, model, group_index=1.4)
    assert found.histories == 77
    assert_allclose(found.frequency, [20e6, 60e6])
    assert_allclose(found.echo, [2.0, 1.0])
    assert_allclose(found.echo_error, [0.02, 0.01])
    assert_allclose(found.water, [1.0, 2.0])
    assert_allclose(found.water_error, [0.02 / 3, 0.02])
    # A phase of 0.1 rad, in range at the speed of light in water.
    per_phase = 299792458.0 / (4 * np.pi * 1.4 * found.frequency)
    assert_allclose(found.shift, 0.1 * per_phase)
    assert_allclose(found.shift_error, [0.02, 0.02] * per_phase)


def test_a_bound_without_information_is_infinite() -> None:
    seen: list[np.ndarray] = []

    def bounds(noise: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, ...]:
        seen.append(noise)
        if "absorption" in names:
            raise ValueError("not determined")
        return np.array([2e-3, 1.0]), np.array([1e-4, 1.0])

    tally: Any = SimpleNamespace(bounds=bounds)
    noise = np.tile(np.eye(2), (3, 1, 1))
    assert module._bound(tally, noise, ("range",)) == (2e-3, 1e-4)
    bound, error = module._bound(tally, noise, ("range", "absorption"))
    assert bound == math.inf
    assert math.isnan(error)
    # Frequency zero, which no sample has, comes first.
    assert seen[0].shape == (4, 2, 2)
    assert_allclose(seen[0][0], 1e30 * np.eye(2))
    assert_allclose(seen[0][1:], noise)


def test_progress_follows_the_square_of_the_error() -> None:
    told: list[tuple[str, float]] = []
    report = module._reported(lambda *words: told.append(words), 0.01)
    assert report is not None
    for error in (0.02, 0.01, 0.005):
        state: Any = SimpleNamespace(histories=12000, relative_error=error)
        report(state)
    assert told == [("photons, 12,000", 0.25)] + [("photons, 12,000", 1.0)] * 2
    assert module._reported(None, 0.01) is None


def test_a_confirmation_is_written_in_plain_numbers() -> None:
    found = Confirmation(
        name="best",
        scans=HELD,
        photons=photons(range_bound=1e-3, free_range_bound=math.inf),
        late=2e-4,
        said=("one",),
    ).to_dict()
    assert found["photons"]["range_bound"] == 1e-3
    assert found["photons"]["free_range_bound"] is None
    assert found["photons"]["range_bound_error"] is None
    assert found["photons"]["echo"] == [1.0, 1.0]
    assert found["scans"]["holds"] is True
    assert found["late_light_uncertainty"] == 2e-4
    assert found["differs"] == ["one"]
    none = Confirmation(name="best", scans=HELD, photons=None, late=0.0, said=())
    assert none.to_dict()["photons"] is None


def _scanned(
    monkeypatch: pytest.MonkeyPatch, errors: list[np.ndarray], survey: Survey
) -> Scans:
    """Return the statistics of scans whose errors are given."""
    waiting = iter(errors)
    monkeypatch.setattr(module, "simulate", lambda survey, rng: None)
    monkeypatch.setattr(rejection, "reject", lambda *_, **__: None)
    monkeypatch.setattr(module, "_truth", lambda survey, image: 2.0)
    monkeypatch.setattr(
        module, "_image",
        lambda *_: {"slant_range": SimpleNamespace(values=2.0 + next(waiting))},
    )  # fmt: skip
    words = {"standard_uncertainty": 2e-3, "residual_bias": 3e-4}
    monkeypatch.setattr(module, "evaluate", lambda *_, **__: words)
    return module.scans(survey, "open-water", repeats=len(errors))


def test_scans_have_the_statistics_of_their_errors(
    monkeypatch: pytest.MonkeyPatch, tank: Survey
) -> None:
    rng = np.random.default_rng(2)
    errors = [1e-3 + 2.2e-3 * rng.standard_normal((6, 8)) for _ in range(5)]
    errors[1][0, 0] = np.nan
    found = _scanned(monkeypatch, errors, tank)
    every = np.stack(errors)
    mean = np.nanmean(every)
    squares = [np.nanmean((one - mean) ** 2) for one in errors]
    achieved = np.sqrt(np.mean(squares))
    assert found.offset == pytest.approx(mean)
    assert found.achieved == pytest.approx(achieved)
    assert found.ratio == pytest.approx(achieved / 2e-3)
    # Half of the relative error of the variance, from the scatter between scans.
    relative = np.std(squares, ddof=1) / np.sqrt(5) / achieved**2
    assert found.ratio_error == pytest.approx(found.ratio * relative / 2)
    means = [np.nanmean(one) for one in errors]
    assert found.offset_error == pytest.approx(np.std(means, ddof=1) / np.sqrt(5))
    assert found.ranges == 239
    assert found.residual_bias == 3e-4
    assert found.distance == 2.0


@pytest.mark.parametrize(("seen", "enough"), [(23, False), (24, True)])
def test_half_of_the_pixels_of_each_scan_have_a_range(
    monkeypatch: pytest.MonkeyPatch, tank: Survey, seen: int, enough: bool
) -> None:
    errors = [np.random.default_rng(k).standard_normal((6, 8)) for k in range(3)]
    errors[2].ravel()[seen:] = np.nan
    if enough:
        assert _scanned(monkeypatch, errors, tank).ranges == 96 + seen
        return
    with pytest.raises(SurveyError, match="fewer than half of the simulated pixels"):
        _scanned(monkeypatch, errors, tank)


def test_the_truth_is_that_of_a_plate_across_the_axis(tank: Survey) -> None:
    azimuth, elevation = np.array([[0.0, 0.1]]), np.array([[0.0, -0.2]])
    image = xr.Dataset({"azimuth": (("r", "c"), azimuth),
                        "elevation": (("r", "c"), elevation)})  # fmt: skip
    assert_allclose(module._truth(tank, image), [[2.0, 2 / np.cos(0.1) / np.cos(0.2)]])
    moved = tank.with_({"instrument.emitter.position": ["0 m", "0 m", "0.5 m"]})
    assert module._truth(moved, image)[0, 0] == pytest.approx(1.5)


def test_the_channel_of_least_uncertainty_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sigma = {"VV": [2.0, 3.0, np.nan], "VH": [1.0, 1.5, 9.0], "HH": [np.nan] * 3}
    asked = []

    def range_image(target: Any, *, polarization: str, interval: Any) -> xr.Dataset:
        asked.append(polarization)
        return xr.Dataset(
            {"slant_range_uncertainty": ("pixel", sigma[polarization])},
            attrs={"channel": polarization},
        )

    monkeypatch.setattr(imaging, "range_image", range_image)
    monkeypatch.setattr(module, "own_variance", lambda image: np.full(3, np.nan))
    target = xr.Dataset(coords={"polarization": ["VV", "VH", "HH"]})
    assert module._image(target, None).attrs["channel"] == "VH"
    assert asked == ["VV", "VH", "HH"]
    # Ranges of which only the noise is known are compared by it.
    monkeypatch.setattr(module, "own_variance", lambda image: np.full(3, 0.25))
    assert module._image(target, None).attrs["channel"] == "HH"
    joint = target.assign(joint_slant_range=0.0)
    assert module._image(joint, None).attrs["channel"] == "VV"


def test_noise_is_that_of_the_channel_of_least_phase_error(
    monkeypatch: pytest.MonkeyPatch, tank: Survey
) -> None:
    rng = np.random.default_rng(5)
    shape = 2, 2, 1, 1
    parts = rng.standard_normal((2, *shape))
    volt = 1 + 0.1 * (parts[0] + 1j * parts[1])
    # The second channel has a fifth of the noise.
    size = rng.uniform(0.01, 0.02, (2, *shape)) * np.array([1.0, 0.2])[:, None, None]
    both = 0.4 * size.prod(axis=0)
    truth = {
        "target_in_phase": _values(volt.real),
        "target_quadrature": _values(volt.imag),
    }
    names = ("in_phase_uncertainty", "quadrature_uncertainty")
    samples = dict(zip(names, map(_values, size), strict=True))

    class Samples(dict[str, Any]):
        amulor = SimpleNamespace(truth=truth, covariance=SimpleNamespace(values=both))

    given = Samples(samples)
    monkeypatch.setattr(module, "simulate", lambda survey, rng: given)
    echo = np.array([0.5 * np.exp(0.3j), 0.2 * np.exp(-1.0j)])
    found = module._noise(tank, echo)
    for f in range(2):
        index = f, 1, 0, 0
        square = np.array([[size[0][index] ** 2, both[index]],
                           [both[index], size[1][index] ** 2]])  # fmt: skip
        factor = echo[f] / volt[index]
        turn = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
        assert_allclose(found[f], turn @ square @ turn.T, rtol=1e-9)


def _values(values: np.ndarray) -> xr.DataArray:
    return xr.DataArray(values, dims=tuple("fpij"))
