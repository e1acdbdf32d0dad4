"""Water signal of a survey by photon transport: all orders of scattering."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.survey import Survey, WaterProperties, water_properties
from amulor.survey.view import (
    beam_arguments,
    has_sharp_receiver,
    medium_of,
    seen_from_water,
)
from amulor.survey.waters.whole_function import phase_function_of
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    PlaneTarget,
    Progress,
    Source,
    Tally,
    simulate,
)
from amulor.transport.monte_carlo import Spread

#: Most histories of a run that is to reach a relative error.
MOST_HISTORIES = 50_000_000


def monte_carlo_response(
    survey: Survey,
    modulation_frequency: ArrayLike,
    *,
    relative_error: float = 0.01,
    seed: int = 1,
    progress: Callable[[Progress], None] | None = None,
    spread: Spread | None = None,
) -> Tally:
    """Return the open-water signal at the middle of the scan by photon transport.

    `amulor.transport.simulate` with the phase function of
    `amulor.survey.waters.whole_function.phase_function_of`, the Gaussian receiver of
    eq. (38) of Ricci et al. 2010, as rederived, and a thin beam. With a window the
    receiver is moved to its apparent position seen from the water, with a transparent
    gap in front of it.
    """
    water = water_properties(survey)
    layers = _layers(water)
    instrument, scan = survey.instrument, survey.scan
    receiver, window = instrument.receiver, medium_of(survey)
    beam = rays.enter_water(
        instrument.emitter.position,
        rays.direction(scan.azimuth, scan.elevation),
        medium=window,
    )
    axis = rays.direction(receiver.azimuth, receiver.elevation)
    gap, acceptance = seen_from_water(survey, window)
    width = beam_arguments(survey, water)
    frequency = np.asarray(modulation_frequency, dtype=np.float64)
    if abs(axis[2] - 1) > 1e-9 and (len(layers) > 1 or gap):
        through = "layers of water" if len(layers) > 1 else "the window"
        raise SurveyError(
            f"instrument.receiver looks through {through} at an angle; photon "
            "transport needs azimuth and elevation of 0 there: aim the emitter "
            "instead, or use the small-angle model"
        )
    target = None
    if survey.water.column_end is not None:
        # The far end of the water is black.
        end = beam.entry + survey.water.column_end * beam.direction
        target = PlaneTarget(position=end, normal=-beam.direction, reflectance=0.0)
    if window.window_distance is None:
        if len(layers) == 1:
            space = Medium(layers=layers, group_index=water.group_index)
        else:
            # Layers are counted from 0 on, and the first one holds the instrument.
            top = min(float(beam.entry[2]), receiver.position[2], 0.0)
            first = replace(layers[0], thickness=layers[0].thickness - top)
            space = Medium.layered(
                [first, *layers[1:]], group_index=water.group_index, top=top
            )
        place = np.array(receiver.position)
    else:
        begin = float(beam.entry[2])
        passage = Layer(
            absorption=0.0,
            scattering=0.0,
            phase_function=layers[0].phase_function,
            thickness=gap,
        )
        space = Medium.layered(
            [passage, *layers], group_index=water.group_index, top=begin - gap
        )
        place = np.array([*receiver.position[:2], begin - gap])
    tally = simulate(
        space,
        Source(
            position=beam.entry,
            direction=beam.direction,
            radius=width.get("beam_radius", 0.0),
            divergence=width.get("beam_divergence", 0.0),
        ),
        (DiscReceiver if has_sharp_receiver(survey) else GaussianReceiver)(
            position=place,
            direction=axis,
            radius=receiver.radius,
            acceptance_angle=acceptance,
        ),
        frequency,
        histories=MOST_HISTORIES,
        seed=seed,
        target=target,
        relative_error=relative_error,
        progress=progress,
        spread=spread,
    )
    return tally.delayed(-gap, group_index=water.group_index) if gap else tally


def _layers(water: WaterProperties) -> tuple[Layer, ...]:
    """Return the water as layers for photon transport; a single layer if uniform."""
    if not water.layers:
        return (
            Layer(
                absorption=water.absorption,
                scattering=water.scattering,
                phase_function=phase_function_of(water),
            ),
        )
    return tuple(
        Layer(
            absorption=layer.absorption,
            scattering=layer.scattering,
            phase_function=layer.phase_function,
            thickness=layer.thickness,
        )
        for layer in water.layers
    )


def half_power(tally: Tally) -> tuple[float, float]:
    r"""Return half-power frequency and its standard error; NaN if not reached [Hz]."""
    frequency = tally.modulation_frequency
    if frequency[0] != 0 or not np.all(np.diff(frequency) > 0):
        raise ValueError("the frequencies must rise from 0 Hz")
    still = abs(tally.signal[0])
    relative = np.abs(tally.signal) / still
    below = np.flatnonzero(relative < math.sqrt(0.5))
    if below.size == 0:
        return math.nan, math.nan
    k = int(below[0])
    drop = relative[k - 1] - relative[k]
    fraction = (relative[k - 1] - math.sqrt(0.5)) / drop
    step = frequency[k] - frequency[k - 1]
    # Batches of the modulus at the crossing over the light at zero frequency.
    along = _moduli(tally) / still
    at_crossing = (1 - fraction) * along[:, k - 1] + fraction * along[:, k]
    ratio = at_crossing - math.sqrt(0.5) * along[:, 0]
    error = math.sqrt(tally.covariance_of(ratio)[0, 0])
    return frequency[k - 1] + fraction * step, error * step / drop


def relative_amplitude_uncertainty(tally: Tally) -> NDArray[np.float64]:
    """Return standard errors of amplitudes normalized to zero frequency."""
    along, modulus = _moduli(tally), np.abs(tally.signal)
    ratio = (along - along[:, :1] * modulus / modulus[0]) / modulus[0]
    error: NDArray[np.float64] = np.sqrt(tally.covariance_of(ratio)[:, 0, 0])
    return error


def _moduli(tally: Tally) -> NDArray[np.float64]:
    """Project each batch's signal onto the mean signal, (batch, frequency)."""
    values = tally.batches.sum(axis=1)[:, 0]
    along: NDArray[np.float64] = (
        values * np.conj(tally.signal) / np.abs(tally.signal)
    ).real
    return along
