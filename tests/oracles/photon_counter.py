"""Photon counter with a dead time, photon by photon along one axis of time.

This is another algorithm than the correction in `amulor.io.dead_time`, which works on
histograms: photons of all pulses are drawn, sorted in time, and accepted one by one.
"""

from __future__ import annotations

import numpy as np


def histogram(
    rng: np.random.Generator,
    *,
    pulses: int,
    period: float,
    bin_width: float,
    bins: int,
    echoes: list[tuple[float, float, float]],
    ambient: float,
    dead_time: float,
) -> np.ndarray:
    """Return the counts of one pixel.

    `echoes` are (photons per pulse, arrival after the pulse [s], width [s]), `ambient`
    photons per second. An infinite dead time ends at the next pulse.
    """
    times = [rng.uniform(0, pulses * period, rng.poisson(ambient * pulses * period))]
    for number, arrival, width in echoes:
        count = rng.poisson(number * pulses)
        pulse = rng.integers(0, pulses, count)
        times.append(pulse * period + arrival + width * rng.standard_normal(count))
    all_times = np.sort(np.concatenate(times))
    all_times = all_times[(all_times > 0) & (all_times < pulses * period)]
    accepted = []
    ready = 0.0
    for time in all_times:
        if time >= ready:
            accepted.append(time)
            ready = (
                time + dead_time
                if np.isfinite(dead_time)
                else (time // period + 1) * period
            )
    place = (np.array(accepted) % period) // bin_width
    return np.bincount(place[place < bins].astype(int), minlength=bins)
