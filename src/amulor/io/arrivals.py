"""Range images from the arrival of a known pulse or code in records."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.errors import FormatError
from amulor.io.dead_time import ready_pulses
from amulor.io.histograms import Histograms, read_histograms, within_gate
from amulor.io.transients import (
    at_least_one,
    dead_time_bins,
    pixel_origins,
    scene_number,
    scene_title,
)
from amulor.optics import arrivals as timing

__all__ = ["read_arrivals"]

#: Probability of a significant echo or second echo by noise alone [1].
_CHANCE = 1e-3
#: Largest probability of another place of the echo, ...
_ELSEWHERE = 0.01
#: ... and of the photons of a pixel outside of the window of its neighbors [1].
_OUTSIDE = 0.5


def read_arrivals(
    path: str | os.PathLike[str],
    *,
    scene: int | None = None,
    gate: tuple[float, float] | None = None,
    neighbors: int = 0,
    repetition_frequency: float | None = None,
    scan_side: float | None = None,
    group_index: float = 1.0,
    refractive_index: float = 1.0,
) -> xr.Dataset:
    r"""Read records with a known pulse or code as a range image, by arrival times.

    Parameters
    ----------
    path : path-like
        File of histograms or waveforms, see `amulor.io.histograms.read_histograms`. It
        must have a recorded pulse or a code.
    scene : int, optional
        Index of the scene, from 0; needed if the file has several.
    gate : tuple of float, optional
        First and last time of the light that is used, on the time axis of the record
        [s].
    neighbors : int
        Pixels on each side whose photons select the place of the echo, for histograms
        with few counts.
    repetition_frequency : float, optional
        Repetition frequency of the laser, for a stated dead time [Hz].
    scan_side : float, optional
        Side of the square of beams of a confocal scan [m].
    group_index, refractive_index : float
        Indices of the medium, at least 1; by default air [1].

    Returns
    -------
    xarray.Dataset
        Cube of level `range_image`. Its intensity is the number of photons, or the
        factor of the pulse. The attribute `side_lobe` is the largest side lobe of the
        matched filter [1].

    Raises
    ------
    FormatError
        If the file cannot be read, or has no pulse, scene or light in the gate.
    ValueError
        If a side, index or number of neighbors is out of range.

    Notes
    -----
    Half of the optical path, :math:`c \tau / 2 n_g`, with the delay :math:`\tau` from
    `amulor.optics.arrivals.matched_filter` or `photon_arrivals`. Range zero is the path
    on which the pulse was recorded, or the start of a code. Emitter and receiver are at
    one place. The errors are those of noise alone; an error of time zero moves all
    ranges. Flags: `NO_TARGET` if noise exceeds the echo with a probability above
    0.001, `AMBIGUOUS` if another place has a probability above 1 %, `MIXED` for a
    significant second echo, also of water that is not subtracted, and `OUTLIER` if the
    photons of the pixel are at another place than those of its neighbors.

    Examples
    --------
    A code of 127 chips of 2 ns, and an echo of 30 ns below the noise of a sample:

    >>> import numpy as np
    >>> from scipy.signal import max_len_seq
    >>> from amulor import io
    >>> code = max_len_seq(7)[0]
    >>> sent = np.repeat(code, 4)  # 0.5 ns per sample
    >>> rng = np.random.default_rng(1)
    >>> np.savez(
    ...     "coded.npz",
    ...     waveform=0.9 * np.roll(sent, 60) + rng.standard_normal((1, 1, 508)),
    ...     sample_interval_s=0.5e-9,
    ...     start_s=0.25e-9,  # middle of the first sample
    ...     noise_v=1.0,
    ...     code=code,
    ...     chip_s=2e-9,
    ...     periodic=1,
    ... )
    >>> image = io.read_arrivals("coded.npz", group_index=1.34)
    >>> distance, error = image.slant_range.item(), image.slant_range_uncertainty.item()
    >>> print(f"{distance:.3f} +- {error:.3f} m, side lobe {image.side_lobe:.4f}")
    3.362 +- 0.007 m, side lobe 0.0079
    """
    histograms = read_histograms(path)
    number = scene_number(histograms, scene)
    if histograms.reference is None:
        raise FormatError(
            f"{histograms.path}: arrival times need the pulse; add 'reference_counts' "
            "or 'reference_waveform', or 'code' and 'chip_s'"
        )
    ends = None
    if gate is not None:
        within_gate(histograms, gate)
        # Samples of a waveform are middles of intervals.
        shift = 0.5 * histograms.bin_width
        first = 0.0 if histograms.start is None else histograms.start - shift
        ends = gate[0] - first, gate[1] - first
    try:
        found = _arrivals(histograms, number, ends, neighbors, repetition_frequency)
    except ValueError as error:
        raise FormatError(f"{histograms.path}: {error}") from error
    per_second = speed_of_light / at_least_one(group_index, "group_index") / 2
    flag = _flags(found, neighbors=neighbors)
    usable = (flag & cubes.UNUSABLE) == 0
    image = cubes.build(
        "range_image",
        {
            "slant_range": np.where(usable, found.time * per_second, np.nan),
            "slant_range_uncertainty": np.where(
                usable, found.uncertainty * per_second, np.nan
            ),
            "intensity": found.amplitude,
            "no_target_probability": found.probability,
            "quality_flag": flag,
        },
        {
            "azimuth": np.zeros(flag.shape),
            "elevation": np.zeros(flag.shape),
            **pixel_origins(flag.shape, scan_side, "down"),
        },
        geometry={
            "group_index": float(group_index),
            "refractive_index": at_least_one(refractive_index, "refractive_index"),
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "range_image",
            title=scene_title(histograms, None, number),
            source="arrival times of a known pulse",
            simulated=np.int32(0),
            input_digests=f"{histograms.name} {histograms.digest}",
            polarization="none",
            scene=np.int32(number),
            neighbors=np.int32(neighbors),
            gate=None if gate is None else np.array(gate),
            side_lobe=timing.side_lobe(
                histograms.reference, periodic=histograms.periodic
            ),
        ),
    )
    return cubes.note(image, f"import arrivals {histograms.name} --scene {number}")


def _arrivals(
    histograms: Histograms,
    scene: int,
    gate: tuple[float, float] | None,
    neighbors: int,
    repetition_frequency: float | None,
) -> timing.Arrivals:
    """Return the arrivals of a scene, by the noise of its records."""
    counts, pulse = histograms.counts[scene], histograms.reference
    assert pulse is not None
    if histograms.noise is not None:
        if neighbors:
            raise ValueError("neighbors are for photon histograms, not for waveforms")
        return timing.matched_filter(
            counts,
            pulse=pulse,
            noise=histograms.noise,
            sample_interval=histograms.bin_width,
            gate=gate,
            water=histograms.water,
            periodic=histograms.periodic,
        )
    if histograms.periodic:
        raise ValueError("a periodic code needs waveforms, not photon histograms")
    exposure: NDArray[Any] | None = None
    if histograms.counter is not None:
        cycles = histograms.counter.cycles[scene]
        dead_bins, period = dead_time_bins(histograms, repetition_frequency)
        ready = ready_pulses(
            counts,
            cycles,
            dead_bins=dead_bins,
            period_bins=period,
            path=histograms.path,
        )
        exposure = ready / cycles[..., None]
    return timing.photon_arrivals(
        counts,
        pulse=pulse,
        bin_width=histograms.bin_width,
        gate=gate,
        water=histograms.water,
        exposure=exposure,
        neighbors=neighbors,
    )


def _flags(found: timing.Arrivals, *, neighbors: int) -> NDArray[np.int16]:
    """Return the quality flags of the pixels."""
    flag = np.zeros(found.time.shape, dtype=np.int16)
    empty = ~np.isfinite(found.time)
    flag[empty | (found.probability > _CHANCE)] |= QualityFlag.NO_TARGET
    if neighbors:
        flag[~empty & (found.elsewhere > _OUTSIDE)] |= QualityFlag.OUTLIER
    else:
        flag[~empty & (found.elsewhere > _ELSEWHERE)] |= QualityFlag.AMBIGUOUS
    flag[~empty & (found.second < _CHANCE)] |= QualityFlag.MIXED
    return flag
