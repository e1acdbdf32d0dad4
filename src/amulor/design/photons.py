"""What photons say of a design: echo, water before it, and the range they shift."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.optics import ranging
from amulor.simulation import SmallAngleModel, geometry
from amulor.simulation.geometry import Geometry
from amulor.simulation.photons import Place, Setting, run, way
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import beam_arguments, has_sharp_receiver, refuse_layers
from amulor.survey.waters.whole_function import whole_phase_function
from amulor.transport import Progress, Tally

__all__ = ["Photons", "follow_photons"]

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Photons:
    """Light of the middle beam by photon transport over that of the model."""

    histories: int
    """Photons that were followed [1]."""
    frequency: Floats
    """Modulation frequencies, shape (frequency,) [Hz]."""
    echo: Floats
    """Amplitude of the echo over that of the model, of the same shape [1]."""
    echo_error: Floats
    """Its standard error [1]."""
    shift: Floats
    """How much farther the echo seems to be than by the model [m]."""
    shift_error: Floats
    """Its standard error [m]."""
    water: Floats
    """Amplitude of the water before the target over that of the model [1]."""
    water_error: Floats
    """Its standard error [1]."""


def follow_photons(
    survey: Survey,
    *,
    relative_error: float = 0.01,
    histories: int = 1_000_000,
    seed: int = 1,
    progress: Callable[[str, float], None] | None = None,
) -> Photons:
    r"""Follow photons along the middle beam of a survey to its target and back.

    A phase :math:`\Delta\varphi` more than that of the model shifts a range by
    :math:`v \Delta\varphi / 4 \pi f`: light that was scattered on its way is late.
    """
    middle = survey.with_(
        {
            "scan.columns": 1,
            "scan.rows": 1,
            "scan.azimuth_span": 0.0,
            "scan.elevation_span": 0.0,
        }
    )
    water = water_properties(middle)
    refuse_layers(water, model="the photon model")
    if has_sharp_receiver(survey):
        raise SurveyError(
            "photons of a design know Gaussian receivers only, found "
            'instrument.receiver.edge = "sharp"; leave it out'
        )
    traced = geometry.trace(middle)
    if not bool((traced.target >= 0).all()):
        raise SurveyError(
            f"the middle beam of {survey.name!r} meets no target, so that no photon "
            "comes back; put a target in front of it"
        )
    view = traced.view
    place = Place(
        baseline=view.baseline.item(),
        tilt=view.tilt.item(),
        cross_tilt=view.cross_tilt.item(),
        standoff=view.standoff.item(),
        depth=traced.depth.item(),
        reflectance=float(survey.targets[traced.target.item()].reflectance),
    )
    tally = run(
        Setting(
            absorption=water.absorption,
            scattering=water.forward_scattering + water.diffuse_scattering,
            phase_function=whole_phase_function(water),
            group_index=water.group_index,
            receiver_radius=survey.instrument.receiver.radius,
            acceptance_angle=view.acceptance,
            **beam_arguments(middle, water),
        ),
        place,
        np.array([0.0, *middle.instrument.modulation_frequencies]),
        relative_error=relative_error,
        histories=histories,
        seed=seed,
        progress=_reported(progress, relative_error),
    )
    return _compared(
        tally, _model(middle, water, traced, place), group_index=water.group_index
    )


def _reported(
    progress: Callable[[str, float], None] | None, relative_error: float
) -> Callable[[Progress], None] | None:
    if progress is None:
        return None

    def report(state: Progress) -> None:
        share = min(1.0, (relative_error / state.relative_error) ** 2)
        progress(f"photons, {state.histories:,}", share)

    return report


def _model(
    survey: Survey, water: WaterProperties, traced: Geometry, place: Place
) -> tuple[Complex, Complex]:
    """Return echo and water before it by the small-angle model, over frequencies."""
    frequency = np.array(survey.instrument.modulation_frequencies)[:, None, None]
    common: dict[str, Any] = {"survey": survey, "water": water, "view": traced.view}
    surface = {
        "depth": traced.depth,
        # Photons are counted from where the water begins.
        "optical_path": np.full_like(traced.depth, water.group_index * way(place)),
        "return_path": np.full_like(traced.depth, way(place) - place.depth),
        "reflectance": np.full_like(traced.depth, place.reflectance),
        "cosine": traced.cosine,
    }
    model = SmallAngleModel()
    return (
        model.echo(frequency, surface=surface, **common)[:, 0, 0],
        model.column(frequency, end=traced.depth, **common)[:, 0, 0],
    )


def _compared(
    tally: Tally, expected: tuple[Complex, Complex], *, group_index: float
) -> Photons:
    frequency = tally.modulation_frequency[1:]
    echo, echo_error, turn_error = _ratio(
        tally.target_signal[1:], tally.target_covariance[1:], expected[0]
    )
    water, water_error, _ = _ratio(
        tally.water_signal[1:], tally.water_covariance[1:], expected[1]
    )
    per_phase = ranging.range_per_phase(frequency, group_index=group_index)
    return Photons(
        frequency=frequency,
        histories=tally.histories,
        echo=np.abs(echo),
        echo_error=echo_error,
        shift=per_phase * np.angle(echo),
        shift_error=per_phase * turn_error,
        water=np.abs(water),
        water_error=water_error,
    )


def _ratio(
    seen: Complex, covariance: Floats, expected: Complex
) -> tuple[Complex, Floats, Floats]:
    """Return light over what the model says, errors of its amplitude and its phase."""
    lit = (np.abs(expected) > 0) & (np.abs(seen) > 0)
    along = np.where(lit, seen, 1.0) / np.where(lit, np.abs(seen), 1.0)
    ahead = np.stack([along.real, along.imag], axis=-1)
    across = np.stack([-along.imag, along.real], axis=-1)
    amplitude, turn = (
        np.sqrt(np.einsum("fi,fij,fj->f", way_of, covariance, way_of))
        for way_of in (ahead, across)
    )
    ratio = np.where(lit, seen / np.where(lit, expected, 1.0), 1.0)
    size = np.where(lit, np.abs(expected), np.inf)
    return ratio, amplitude / size, turn / np.where(lit, np.abs(seen), np.inf)
