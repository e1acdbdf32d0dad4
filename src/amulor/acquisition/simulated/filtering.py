"""What a one-pole filter puts out at many moments, worked out at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from amulor.acquisition.settings import SimulationSettings
from amulor.acquisition.simulated.places import Tone


def in_steps(
    tones: Sequence[Tone],
    *,
    start: float,
    interval: float,
    count: int,
    time_constant: float,
    spread: float,
    settings: SimulationSettings,
    rng: np.random.Generator,
) -> list[list[complex]]:
    """Let the filters of tones run on over evenly spaced moments.

    Parameters
    ----------
    tones : sequence of Tone
        What enters them, and what they hold; changed.
    start : float
        When they hold it [s].
    interval : float
        From there to the first moment, and between moments [s].
    count : int
        How many moments, at least 1 [1].
    time_constant : float
        Of all filters [s].
    spread : float
        Standard deviation of the noise behind them [V].
    settings : SimulationSettings
        Drift of the phase, and pickup.
    rng : numpy.random.Generator
        Where noise comes from.

    Returns
    -------
    list of list of complex
        A row for each moment, with the output of each tone [V].
    """
    from scipy.signal import lfilter

    keep = math.exp(-interval / time_constant)
    fresh = math.sqrt(max(1 - keep**2, 0.0)) * spread
    moments = start + interval * np.arange(1, count + 1)
    turn = np.exp(1j * settings.phase_drift * moments)
    columns = []
    for tone in tones:
        aim = tone.input * turn + settings.pickup
        drawn = rng.standard_normal((2, count))
        for name, enters in (
            ("level", (1 - keep) * aim),
            ("noise", fresh * (drawn[0] + 1j * drawn[1])),
        ):
            held = [keep * getattr(tone, name)]
            left, _ = lfilter([1.0], [1.0, -keep], enters, zi=held)
            setattr(tone, name, complex(left[-1]))
            columns.append(left)
    shown = np.stack(columns[::2], axis=1) + np.stack(columns[1::2], axis=1)
    rows: list[list[complex]] = shown.tolist()
    return rows
