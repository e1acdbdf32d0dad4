"""Conversion of histograms and waveforms to the cube of an AM laser radar."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import cube as cubes
from amulor.errors import FormatError
from amulor.io.dead_time import Light, without_loss
from amulor.io.histograms import (
    Coefficients,
    Histograms,
    checked_frequency,
    read_histograms,
    transform,
    weights,
)

__all__ = ["VOLTS_PER_COUNT", "medium_from_minimum", "read_transients"]

Floats = NDArray[np.float64]

#: An echo is significant above the smallest scene by this many standard errors [1].
_SURE = 5.0
#: Parts of a histogram over which its smallest values are smoothed.
_PARTS = 64


def overlap_of(sums: Floats) -> Floats:
    r"""Estimated echo photons in the bin-wise minimum of all scenes, per time bin.

    Scenes :math:`B + E_1`, :math:`B + E_2` have the minimum
    :math:`B + \min(E_1, E_2)`: where one echo has not ended when the other begins, the
    minimum has a bump. Between two echoes that follow each other, the bump is all that
    lies above the straight line between the lowest points of the two. This assumes that
    the medium itself has no bump there, because the light of a past pulse decays.
    """
    smallest = sums.min(axis=0)
    apart = sums.max(axis=0) - smallest
    significant = np.flatnonzero(apart > _SURE * np.sqrt(sums.sum(axis=0) + 1))
    brightest = sums.argmax(axis=0)[significant]
    # Runs of bins in which the echo of one scene stands out.
    starts = np.flatnonzero(np.diff(brightest, prepend=-1) != 0)
    runs = np.split(significant, starts[1:])
    level = _smoothed(smallest)
    overlap = np.zeros(smallest.size)
    for before, after in pairwise(runs):
        first = before[0] + int(level[before[0] : before[-1] + 1].argmin())
        last = after[0] + int(level[after[0] : after[-1] + 1].argmin())
        place = np.arange(first, last + 1)
        line = np.interp(place, [first, last], [level[first], level[last]])
        overlap[place] = np.maximum(overlap[place], smallest[place] - line)
    return overlap


def _smoothed(values: Floats) -> Floats:
    """Return a moving average over the time bins, with the edge values repeated."""
    half = values.size // _PARTS // 2
    padded = np.pad(values, half, mode="edge")
    width = 2 * half + 1
    return np.asarray(np.convolve(padded, np.full(width, 1 / width), mode="valid"))


#: Nominal: the schema requires volts, which a photon counter does not have. One volt
#: per counted photon changes no phase, range or ratio.
VOLTS_PER_COUNT = 1.0

#: N photons of one phase have the amplitude N and the variance N / 2 in each output.
_PHOTON_NOISE = {"modulation_depth": 1.0, "photon_noise_volt": VOLTS_PER_COUNT / 2}

_FOAM = (
    "D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), "
    "github.com/computational-imaging/confocal-diffuse-tomography"
)
_FOAM_LICENCE = "MIT, (c) 2020 Stanford University"


@dataclass(frozen=True, kw_only=True)
class _Known:
    """Acquisition details of a published data set, which its file lacks."""

    title: str
    scan_side: float | None = None
    first_axis: Literal["down", "right"] = "down"
    repetition_frequency: float | None = None


_KNOWN = {
    "sha256:2ed0d9ae2611db45a58d298f6a83fb71041c1a60fe212eab1c91e7aec1d7096c": _Known(
        title="letter S behind one inch of foam", scan_side=0.60, first_axis="right"
    ),
    "sha256:6f50f9afdc0a7a700c48700f95011eb98c145268ec6a4cb03549e2f167e411bc": _Known(
        title="letter T behind one inch of foam", scan_side=0.70, first_axis="right"
    ),
    "sha256:072a1a94879cdec40d64fa2685d27bf83eade227f93665cf52ada9118d59318e": _Known(
        title="letter U behind one inch of foam", scan_side=0.70, first_axis="right"
    ),
    "sha256:048435797f423e2bd63f04e7dbc7abf8c62dad5b81cbdb9cac81fc5ff59e0b0b": _Known(
        title="light through slabs of foam", repetition_frequency=10e6
    ),
}


def read_transients(
    path: str | os.PathLike[str],
    modulation_frequency: ArrayLike,
    *,
    scene: int | None = None,
    scan_side: float | None = None,
    first_axis: Literal["down", "right"] | None = None,
    time_of_emission: float = 0.0,
    background_bins: tuple[int, int] | None = None,
    repetition_frequency: float | None = None,
    gate: tuple[float, float] | None = None,
    group_index: float = 1.0,
    refractive_index: float = 1.0,
) -> xr.Dataset:
    r"""Read histograms or waveforms of a scene as a cube at modulation frequencies.

    Parameters
    ----------
    path : path-like
        File of histograms or waveforms, see `amulor.io.histograms.read_histograms`.
    modulation_frequency : array_like
        Increasing frequencies, up to half a period per bin [Hz].
    scene : int, optional
        Index of the scene, from 0; needed if the file has several.
    scan_side : float, optional
        Side of the square of beams that a confocal scan covers, from the first to the
        last pixel [m]. Known for the published foam files. Without it the cube has no
        `origin_x` and `origin_y`.
    first_axis : {"down", "right"}, optional
        Direction of the beam along the first axis of a picture in `counts`. Known for
        the published foam files; "down" for other files.
    time_of_emission : float
        Time at which the light was emitted; bin 0 starts at zero [s]. An error moves
        all ranges by the same distance.
    background_bins : tuple of int, optional
        First bin, and the one after the last, with dark counts only. Their mean is
        subtracted from every bin of the pixel.
    repetition_frequency : float, optional
        Repetition frequency of the source, above zero [Hz]. Known for the published
        slab file.
    gate : tuple of float, optional
        First and last time of the light that is used, on the time axis of the record
        [s]. Earlier backscatter is removed, with its noise. Late light of an echo
        after the gate is removed, too, so the gate must end well behind the target.
    group_index, refractive_index : float
        Indices of the medium between instrument and target, at least 1; by default air
        [1].

    Returns
    -------
    xarray.Dataset
        Cube of level `samples` with polarization "none". A pixel without photons is
        NaN. Slabs are the columns of a single row, with their thickness as
        `user_thickness` [m].

    Raises
    ------
    FormatError
        If the file is missing, damaged or foreign, if a field of it cannot be
        used, if it does not have such a scene, frequency or bin, or if no photon was
        counted in the scene.
    ValueError
        If a side, index or repetition frequency is out of range.

    Notes
    -----
    .. math:: S(f) = \sum_k n_k e^{+2 \pi i f t_k}, \quad
       t_k = (k + \tfrac12) w - t_0,

    with counts :math:`n_k`, bin width :math:`w` and emission at :math:`t_0`: a later
    echo has a larger phase. A medium responds linearly, so this is the amplitude and
    phase that an instrument with light modulated at :math:`f` measures. The modulation
    of a short pulse is twice that of a sine of depth 1. Counts are assigned to the
    center of their bin. The bin width reduces the sum by
    :math:`\sin(\pi f w) / \pi f w`, 0.04 % at 1 GHz and 16 ps; like the jitter of
    pulse and detector, this is not corrected. One volt represents one count
    (`VOLTS_PER_COUNT`). The uncertainties are those of photon counting, see
    `amulor.io.histograms.transform`.

    With `cycles` in the file, the counting loss by the dead time is corrected (see
    `amulor.io.dead_time.without_loss`), and the error of the dead time is added. A
    histogram in which a bin has a photon in every pulse is NaN.

    With the recorded pulse s of the instrument in the file, the record r is
    deconvolved: :math:`R S^* / (|S|^2 + \epsilon)`, with Fourier coefficients R and S
    and the noise power :math:`\epsilon` of S. Pulse shape, bin width and time zero of
    the pulse cancel. For a pulse with radio-frequency modulation, the coefficient at
    the modulation frequency is the output of a band-pass (hybrid lidar-radar).

    Errors of dead time and recorded pulse are common to all pixels. They are stated as
    errors of each pixel.

    A histogram that ends before the light has decayed lacks the late light.
    For a pulse train only the harmonics of the repetition frequency are exact. At
    frequencies between them the light must decay before the next pulse. Such
    frequencies are listed in the attribute `frequencies_between_harmonics` [Hz].

    Examples
    --------
    >>> import tempfile
    >>> counts = np.zeros((1, 1, 64), dtype=int)
    >>> counts[0, 0, 24] = 400
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/echo.npz", counts=counts, bin_width_s=1e-10)
    ...     cube = read_transients(f"{folder}/echo.npz", 50e6)
    >>> print(f"{cube.amulor.amplitude.item():.0f} V")
    400 V
    >>> print(f"{cube.amulor.phase.item() / (2 * np.pi * 50e6) * 1e9:.2f} ns")
    2.45 ns
    """
    histograms = read_histograms(path)
    frequency = checked_frequency(histograms, modulation_frequency)
    published = _KNOWN.get(histograms.digest)
    side = (
        scan_side if scan_side is not None or published is None else published.scan_side
    )
    axis = first_axis or (published.first_axis if published else "down")
    if repetition_frequency is None and published:
        repetition_frequency = published.repetition_frequency
    number = scene_number(histograms, scene)
    weight = weights(
        histograms,
        frequency,
        time_of_emission=time_of_emission,
        background_bins=background_bins,
        gate=gate,
    )
    counts = histograms.counts[number]
    dark = np.zeros(counts.shape[:-1], dtype=bool)
    if histograms.noise is None:
        dark = counts.sum(axis=-1) == 0
    if dark.all():
        raise FormatError(
            f"{path}: scene {number} holds no photon in any of its {dark.size} "
            "histograms; take another scene, or look at how the counts were saved"
        )
    coefficients = _coefficients(histograms, number, weight, repetition_frequency)
    if histograms.reference is not None:
        # The pulse was recorded outside of the gate.
        whole = weights(histograms, frequency, time_of_emission=time_of_emission)
        coefficients = _deconvolved(histograms, coefficients, whole)
    cube = cubes.build(
        "samples",
        _outputs(coefficients, missing=dark, axis=1),
        {
            "modulation_frequency": frequency,
            "polarization": ["none"],
            "azimuth": np.zeros(counts.shape[:2]),
            "elevation": np.zeros(counts.shape[:2]),
            **pixel_origins(counts.shape[:2], side, axis),
        },
        geometry={
            "group_index": at_least_one(group_index, "group_index"),
            "refractive_index": at_least_one(refractive_index, "refractive_index"),
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes(
            "samples",
            title=scene_title(histograms, published, number),
            source="measured photon histograms, Fourier coefficients"
            if histograms.noise is None
            else "digitized waveforms, Fourier coefficients",
            references=_FOAM if published else None,
            license=_FOAM_LICENCE if published else None,
            simulated=np.int32(0),
            input_digests=f"{histograms.name} {histograms.digest}",
            **(
                {"volts_per_count": VOLTS_PER_COUNT, **_PHOTON_NOISE}
                if histograms.noise is None
                else {}
            ),
            bin_width=histograms.bin_width,
            time_of_emission=float(time_of_emission),
            scene=np.int32(number),
            scene_label=histograms.labels[number] if histograms.labels else None,
            **_repetition(frequency, repetition_frequency),
            gate=None if gate is None else np.array(gate),
        ),
    )
    if histograms.thickness is not None:
        cube["user_thickness"] = xr.Variable(
            ("column",),
            histograms.thickness,
            {"units": "m", "long_name": "thickness of the slab"},
        )
    return cubes.note(cube, f"import transients {histograms.name} --scene {number}")


def _coefficients(
    histograms: Histograms,
    scene: int,
    weight: NDArray[np.complex128],
    repetition_frequency: float | None,
) -> Coefficients:
    """Return the coefficients of a scene, without counting loss."""
    counts = histograms.counts[scene]
    if histograms.noise is not None:
        found = transform(counts, weight, np.full(counts.shape, histograms.noise**2))
    elif histograms.counter is None:
        found = transform(counts, weight)
    else:
        light = _without_loss(histograms, scene, repetition_frequency)
        found = transform(light.mean, weight, light.variance)
        change = histograms.counter.dead_time_uncertainty
        if change > 0:
            longer = _without_loss(histograms, scene, repetition_frequency, change)
            shift = transform(longer.mean, weight).signal - found.signal
            found = found.with_error(shift)
    return found


def dead_time_bins(
    histograms: Histograms, repetition_frequency: float | None, longer: float = 0.0
) -> tuple[float, float | None]:
    """Return dead time and period in bins; FormatError if the period is needed."""
    counter = histograms.counter
    assert counter is not None
    period = None
    if np.isfinite(counter.dead_time):
        if repetition_frequency is None:
            raise FormatError(
                f"{histograms.path}: a dead time of {counter.dead_time:g} s may last "
                "until the next pulse; state repetition_frequency"
            )
        period = 1 / (repetition_frequency * histograms.bin_width)
    return (counter.dead_time + longer) / histograms.bin_width, period


def _without_loss(
    histograms: Histograms,
    scene: int,
    repetition_frequency: float | None,
    longer: float = 0.0,
) -> Light:
    """Return the light on the counter, for a dead time that is longer by a change."""
    assert histograms.counter is not None
    dead_bins, period = dead_time_bins(histograms, repetition_frequency, longer)
    return without_loss(
        histograms.counts[scene],
        histograms.counter.cycles[scene],
        dead_bins=dead_bins,
        period_bins=period,
        path=histograms.path,
    )


#: Signal of a recorded pulse over its noise, from which it is significant [1].
_SIGNIFICANT = 5.0
#: Part of the light of a code, below which its error is as large as the signal [1].
_LEAST_LIGHT = 1e-3


def _deconvolved(
    histograms: Histograms, found: Coefficients, weight: NDArray[np.complex128]
) -> Coefficients:
    """Return coefficients divided by those of the recorded pulse, times its light."""
    reference = histograms.reference
    assert reference is not None
    noise = histograms.noise
    variance = None if noise is None else np.full((1, reference.size), noise**2)
    if histograms.coded:
        variance = np.zeros((1, reference.size))
    pulse = transform(reference[np.newaxis].astype(float), weight, variance)
    spectrum = pulse.signal[:, 0]
    error = (pulse.variance_in_phase + pulse.variance_quadrature)[:, 0]
    if histograms.coded:
        # A code has no light at some frequencies.
        error = error + (_LEAST_LIGHT * np.abs(reference).sum()) ** 2
    if np.any(np.abs(spectrum) < _SIGNIFICANT * np.sqrt(error)):
        raise FormatError(
            f"{histograms.path}: the recorded pulse is not significant above its noise "
            "at all modulation frequencies; choose lower ones, or record it for longer"
        )
    factor = spectrum.conj() * reference.sum() / (np.abs(spectrum) ** 2 + error)
    divided = found.times(factor)
    shape = (-1, *[1] * (divided.signal.ndim - 1))
    # The error of the pulse has any phase.
    part = np.sqrt(error / 2) / np.abs(spectrum)
    shift = divided.signal * part.reshape(shape)
    return divided.with_error(shift).with_error(1j * shift)


def medium_from_minimum(
    path: str | os.PathLike[str],
    modulation_frequency: ArrayLike,
    *,
    time_of_emission: float = 0.0,
    background_bins: tuple[int, int] | None = None,
) -> xr.Dataset:
    r"""Estimate the water signal as bin-wise minimum of scenes at different distances.

    Parameters
    ----------
    path : path-like
        File in npz format with at least two scenes, recorded behind the same medium
        with the same exposure and the target at different distances.
    modulation_frequency : array_like
        Modulation frequencies of the cube to which the result will be attached [Hz].
    time_of_emission : float
        Time of emission, as for the cube [s].
    background_bins : tuple of int, optional
        Bins with dark counts only, as for the cube.

    Returns
    -------
    xarray.Dataset
        One shot without a target per pixel, for use as open-water shots:
        `amulor.cube.attach(cube, medium, "open_water")`. Its attribute `echo_overlap`
        states, for each frequency, the echo that was mistaken for the medium, over the
        weakest remaining echo, at most 1 [1].

    Raises
    ------
    FormatError
        If the file has only one scene, or cannot be read by `read_transients`.

    Notes
    -----
    The pixels of each scene are summed. For every bin the scene with the smallest sum
    is used in all pixels. The shots then add up to the bin-wise minimum of the summed
    histograms, and no pixel is selected by its own noise. The minimum is the medium if
    in every bin one scene has no echo. It is too large where echoes overlap, by about
    the bump between them (`overlap_of`); the `common_` variables state this as an error
    that all shots share. It is too small by counting noise: the smaller of two equal
    means :math:`\mu` is low by :math:`\sqrt{\mu / \pi}`. All shots state the same
    uncertainty, the average of photon counting, so that all have equal weight. They
    contain counts of the scenes themselves. Subtracted as if independent, they
    overstate the uncertainty of the remaining signal.

    Examples
    --------
    >>> import tempfile
    >>> counts = np.full((2, 1, 1, 64), 5)
    >>> counts[0, 0, 0, 20] = counts[1, 0, 0, 40] = 900
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/moved.npz", counts=counts, bin_width_s=1e-10)
    ...     medium = medium_from_minimum(f"{folder}/moved.npz", 1e3)
    >>> print(f"{medium['in_phase'].item():.1f} V, which is 64 bins with 5 counts")
    320.0 V, which is 64 bins with 5 counts
    """
    histograms = read_histograms(path)
    frequency = checked_frequency(histograms, modulation_frequency)
    scenes = histograms.counts.shape[0]
    if scenes < 2:
        raise FormatError(
            f"{histograms.path}: field 'counts' has {scenes} scene, but the minimum "
            "over scenes needs at least 2, with the target in different places; record "
            "another"
        )
    weight = weights(
        histograms,
        frequency,
        time_of_emission=time_of_emission,
        background_bins=background_bins,
    )
    smallest = histograms.counts.sum(axis=(1, 2)).argmin(axis=0)
    if histograms.counter is not None or histograms.noise is not None:
        raise FormatError(
            f"{histograms.path}: the minimum over scenes needs photon counts without "
            "'cycles'; record the medium alone"
        )
    bins = np.arange(smallest.size)
    medium = np.moveaxis(histograms.counts[smallest, ..., bins], 0, -1)
    shots = transform(medium.reshape(-1, smallest.size), weight)
    outputs = _outputs(_evenly(shots), axis=1)
    sums = histograms.counts.sum(axis=(1, 2)).astype(float)
    # Transforms of fractions of counts, whose noise does not matter here.
    echo = transform(overlap_of(sums)[None], weight).signal[:, 0] * VOLTS_PER_COUNT
    residual = transform(sums - sums.min(axis=0), weight).signal * VOLTS_PER_COUNT
    share = echo / shots.signal.shape[-1]
    outputs["common_in_phase_uncertainty"] = np.abs(share.real)[:, None]
    outputs["common_quadrature_uncertainty"] = np.abs(share.imag)[:, None]
    outputs["common_covariance"] = (share.real * share.imag)[:, None]
    weakest = np.maximum(np.abs(residual).min(axis=-1), np.finfo(float).tiny)
    overlap = np.minimum(np.abs(echo) / weakest, 1.0)
    return cubes.open_water(outputs).assign_attrs(echo_overlap=overlap)


def _evenly(shots: Coefficients) -> Coefficients:
    """Return open-water signals, all with their average covariance."""

    def mean(part: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.broadcast_to(part.mean(axis=-1, keepdims=True), part.shape)

    return Coefficients(
        signal=shots.signal,
        variance_in_phase=mean(shots.variance_in_phase),
        variance_quadrature=mean(shots.variance_quadrature),
        covariance=mean(shots.covariance),
    )


def _outputs(
    coefficients: Coefficients,
    *,
    axis: int,
    missing: NDArray[np.bool_] | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Signals and uncertainties as variables of a cube, with a polarization axis."""
    volt = VOLTS_PER_COUNT
    outputs = {
        "in_phase": volt * coefficients.signal.real,
        "quadrature": volt * coefficients.signal.imag,
        "in_phase_uncertainty": volt * np.sqrt(coefficients.variance_in_phase),
        "quadrature_uncertainty": volt * np.sqrt(coefficients.variance_quadrature),
        "in_phase_quadrature_covariance": volt**2 * coefficients.covariance,
    }
    if missing is not None:
        outputs = {
            key: np.where(missing, np.nan, value) for key, value in outputs.items()
        }
    return {key: np.expand_dims(value, axis) for key, value in outputs.items()}


def scene_number(histograms: Histograms, scene: int | None) -> int:
    scenes = histograms.counts.shape[0]
    names = f" ({', '.join(histograms.labels)})" if histograms.labels else ""
    if scene is None:
        if scenes > 1:
            raise FormatError(
                f"{histograms.path}: field 'counts' has {scenes} scenes{names}; choose "
                f"one with scene, 0 to {scenes - 1}"
            )
        return 0
    if not 0 <= scene < scenes:
        raise FormatError(
            f"{histograms.path}: field 'counts' has {scenes} scenes{names}, but no "
            f"scene {scene}; choose from 0 to {scenes - 1}"
        )
    return int(scene)


def pixel_origins(
    shape: tuple[int, ...], side: float | None, first_axis: str
) -> dict[str, NDArray[np.float64]]:
    if first_axis not in ("down", "right"):
        raise ValueError(f"first_axis must be 'down' or 'right', got {first_axis!r}")
    if side is None:
        return {}
    if not (np.isfinite(side) and side > 0):
        raise ValueError(f"scan_side must be finite and above 0 m, got {side:g} m")
    along_rows, along_columns = np.meshgrid(
        *(_places(number, side) for number in shape), indexing="ij"
    )
    right, down = along_columns, along_rows
    if first_axis == "right":
        right, down = down, right
    return {"origin_x": right, "origin_y": down, "origin_z": np.zeros(shape)}


def _places(number: int, side: float) -> NDArray[np.float64]:
    return np.linspace(-side / 2, side / 2, number) if number > 1 else np.zeros(1)


def at_least_one(index: float, name: str) -> float:
    if not (np.isfinite(index) and index >= 1):
        raise ValueError(f"{name} must be finite and at least 1, got {index:g}")
    return float(index)


def scene_title(histograms: Histograms, published: _Known | None, scene: int) -> str:
    title = published.title if published else histograms.path.stem
    label = f", distance label {histograms.labels[scene]}" if histograms.labels else ""
    return title + label


def _repetition(
    frequency: NDArray[np.float64], repetition_frequency: float | None
) -> dict[str, Any]:
    if repetition_frequency is None:
        return {}
    if not (np.isfinite(repetition_frequency) and repetition_frequency > 0):
        raise ValueError(
            "repetition_frequency must be finite and above 0 Hz, got "
            f"{repetition_frequency:g} Hz"
        )
    order = frequency / repetition_frequency
    between = frequency[np.abs(order - np.round(order)) > 1e-6]
    return {
        "repetition_frequency": float(repetition_frequency),
        "frequencies_between_harmonics": between if between.size else None,
    }
