"""Open-water references: noise, drift, and interpolation to the pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.cube.tiles import Span, span_of
from amulor.errors import CubeError
from amulor.rejection.covariance import (
    Covariance,
    isotropic,
    stacked,
    times,
)
from amulor.rejection.observation import Observation
from amulor.rejection.reference.model import ModelBehindShots, Shape, model_behind_shots
from amulor.rejection.reference.surface import (
    FEWEST_SHOTS,
    Places,
    Surface,
    design_of,
    disagreement,
    fluctuation,
    noise_of,
    places_of,
    surface_of,
)
from amulor.rejection.resolution import Resolution, resolution_of, with_resolution

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Drift:
    """Relative change of the water signal from the first reference to the last."""

    change: complex
    """Relative change of the water signal, radial + 1j * tangential [1]."""
    uncertainty: complex
    """Standard uncertainty of the radial and tangential change [1]."""
    chance: float
    """Probability of so large a change in steady water [1]."""


#: Drift of shots that cannot be compared with each other.
NO_DRIFT = Drift(0j, complex(np.inf, np.inf), 1.0)


def drift_of(shots: Complex, level: Complex, where: Floats) -> Drift:
    """Estimate the drift from references repeated in the same directions.

    The fit is a straight line over the order of the shots, with a free mean for each
    direction. Errors of the polynomial over the directions are therefore no drift.
    Repeats at the start and at the end of the scan determine the drift well. Repeats in
    a row determine it badly, and single shots do not determine it.
    """
    from scipy.special import stdtr

    _, group, size = np.unique(
        np.round(where, 9), axis=0, return_inverse=True, return_counts=True
    )
    group = group.ravel()

    def centered(values: Floats) -> Floats:
        mean: Floats = np.bincount(group, values) / size
        return values - mean[group]

    freedom = len(shots) - len(size) - 1
    order = centered(np.linspace(-0.5, 0.5, len(shots)))
    square = float(order @ order)
    if freedom < 1 or np.abs(level).min() == 0 or square < 1e-9 * len(shots):
        return NO_DRIFT
    relative = (shots - level) / level
    parts, errors, chances = [], [], []
    for values in (relative.real, relative.imag):
        slope = float(order @ values) / square
        rest = centered(values) - slope * order
        error = float(np.sqrt(rest @ rest / freedom / square))
        parts.append(slope)
        errors.append(error)
        steady = 1.0 if slope == 0 else 0.0
        chances.append(
            2 * float(stdtr(freedom, -abs(slope) / error)) if error > 0 else steady
        )
    # The smaller p-value of two parts, with the Bonferroni correction.
    chance = min(1.0, 2 * min(chances))
    return Drift(complex(*parts), complex(*errors), chance)


#: Pixels at which the polynomial is evaluated at once; this bounds the memory.
_AT_ONCE = 16_384


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Interpolated water signal at each pixel, with its errors."""

    signal: Complex
    """Expected water signal [V]."""
    common: Covariance
    """Water-signal covariance from the fit, common to all pixels [V^2]."""
    relative: NDArray[np.float64]
    """Covariance of the relative fluctuation (radial, tangential) [1]."""
    degree: int
    """Degree of the polynomial over the scan directions."""
    drift: Drift
    """Drift from the first shot to the last."""
    surface: Surface
    """Polynomial fit of the shots."""
    modelled: bool = False
    """Whether the polynomial fits the ratio to a water model."""


def fit_channel(
    shots: Complex,
    instrument: Covariance,
    shot_direction: Floats,
    pixel_direction: Floats,
    *,
    shape: Shape | None = None,
    surface: Surface | None = None,
) -> Reference:
    """Fit the open-water shots of one channel and evaluate the fit at the pixels.

    The fit is a least-squares polynomial. An F test compares its misfit with the
    scatter of repeated shots. The degree is one above the lowest degree that passes:
    an undetected misfit may be as large as the error, and the next degree removes most
    of it. Scatter beyond the stated errors is a fluctuation of the water, proportional
    to the water signal. A second polynomial fits the logarithms of the shots. The
    difference of the two polynomials is a standard error, see `disagreement`.

    With a `shape`, the polynomial fits the ratio of the water signal to that model,
    which varies less. If no degree passes the test, the excess deviation of the
    direction means is an error of the reference in every direction (Birge ratio).
    """
    if len(shots) < FEWEST_SHOTS:
        raise ValueError(f"a reference needs {FEWEST_SHOTS} shots, got {len(shots)}")
    places = places_of(shot_direction)
    fitted = surface
    if fitted is None:
        fitted = surface_of(
            shots,
            instrument,
            places,
            noise=noise_of(shots, instrument, places),
            model=None if shape is None else shape.at_shots,
        )
    # One product of real matrices for all: coefficients, logarithms, covariances.
    second = fitted.logarithm
    along = np.zeros(len(fitted.powers), dtype=complex) if second is None else second[0]
    table = np.hstack(
        [
            fitted.coefficients.real[:, None],
            fitted.coefficients.imag[:, None],
            along.real[:, None],
            along.imag[:, None],
            *fitted.spreads,
        ]
    )
    signal = np.empty(len(pixel_direction), dtype=complex)
    common = [np.empty(len(pixel_direction)) for _ in fitted.spreads]
    for first in range(0, len(pixel_direction), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        design = design_of(places.scaled(pixel_direction[part]), fitted.powers)
        product = times(design, table)
        signal[part] = product[:, 0] + 1j * product[:, 1]
        sides = product[:, 4:].reshape(len(design), len(fitted.spreads), -1)
        for k, values in enumerate(common):
            values[part] = np.einsum("ij,ij->i", sides[:, k], design)
        if second is not None:
            off = disagreement(
                signal[part], product[:, 2] + 1j * product[:, 3], second[1]
            )
            common[0][part] += off.real**2
            common[1][part] += off.imag**2
            common[2][part] += off.real * off.imag
    errors = Covariance(*common)
    if shape is not None:
        signal, errors = signal * shape.at_pixels, errors.turned(shape.at_pixels)
    if fitted.excess > 0:
        # Deviation of each direction beyond chance.
        excess = isotropic(np.full(signal.shape, _typical(instrument)))
        excess = excess + fluctuation(fitted.relative, signal)
        errors = errors + excess.scaled(fitted.excess * len(places.size) / len(shots))
    return Reference(
        signal=signal,
        common=errors,
        relative=fitted.relative,
        degree=int(fitted.powers.sum(axis=1).max()),
        drift=drift_of(shots, fitted.level, places.where),
        surface=fitted,
        modelled=shape is not None,
    )


def _typical(instrument: Covariance) -> float:
    return float(np.sqrt(np.mean(instrument.in_phase + instrument.quadrature)))


#: P-value below which a drift of the reference is real [1].
_REAL_DRIFT = 1e-3
#: Largest allowed change of the water signal from the first to the last shot [1].
LARGEST_DRIFT = 0.2
#: Least excess over the limit, in standard uncertainties [1].
_SURE = 3.0
_AXES = ("azimuth", "elevation")
#: Allowed extent of the scan beyond the shots: a fraction of their span, and a minimum
#: [rad].
_BEYOND, BEYOND_AT_LEAST = 0.1, 1e-4
#: Directions closer than this are repeats: a fraction of the span of all directions
#: [1], or a number of standard deviations of the positioning error [1].
_NEAR, _MISSES = 1 / 50, 8.0


def shots_of(scan: Observation) -> Observation:
    """Return the open-water shots of a scan; CubeError if missing or too few."""
    shots = scan.shots
    if shots is None:
        raise CubeError(
            "the cube has no open-water shots (group open_water); record them with the "
            "target out of the beam, or use a method that needs none: joint with two "
            "or more frequencies, polarization with both ratios stated, or "
            "cross-polarized"
        )
    count = shots.signal.shape[-1]
    if count < FEWEST_SHOTS:
        raise CubeError(
            f"the cube has {count} open-water shots, needed are at least "
            f"{FEWEST_SHOTS} to judge how much the water signal fluctuates; record more"
        )
    return shots


@dataclass(frozen=True, kw_only=True)
class ShotsFit:
    """Scan-wide fit of the open-water shots."""

    span: Span
    """Directions of the scan."""
    directions: Floats
    """Azimuth and elevation of the shots, identical for repeats [rad]."""
    model: ModelBehindShots | None
    """Water model used to normalize the shots; None without a model."""
    surfaces: tuple[Surface, ...]
    """Polynomials by frequency, then channel."""


def fit_shots(
    scan: Observation,
    *,
    fit: ShotsFit | None = None,
    span: Span | None = None,
) -> tuple[list[Reference], ShotsFit]:
    """Interpolate open-water shots to the pixels of a scan; return also the fit.

    Each modulation frequency and channel has its own fit. CubeError if too few shots of
    a channel are numbers, if the scan extends beyond the shots, or if the water signal
    changed too much from the first to the last shot.
    """
    shots = shots_of(scan)
    pixels = np.stack([scan.azimuth.ravel(), scan.elevation.ravel()], axis=1)
    has_directions = all(angle is not None for angle in shots.directions)
    if fit is None:
        span = span_of(scan.cube) if span is None else span
        places = directions_of(scan, shots)
    else:
        span, places = fit.span, fit.directions
    signal, errors = shots.signal, shots.covariance
    if has_directions:
        _refuse_a_scan_beyond_the_shots(scan, places, span)
    model = None if fit is None else fit.model
    if has_directions and fit is None:
        model = model_behind_shots(scan, shots, places, span=span)
    shapes = None
    if model is not None:
        shapes = model.over(pixels, scan.frequency)
    fits: list[Reference] = []
    for index in np.ndindex(signal.shape[:2]):
        use = shots.usable[index]
        if use.sum() < FEWEST_SHOTS:
            raise CubeError(
                f"only {use.sum()} open-water shots at {_place(scan, index)} are "
                f"numbers, needed are {FEWEST_SHOTS}; record more"
            )
        instrument = errors.part(index).part(use)
        shape = None if shapes is None else shapes[index[0]].part(use)
        reference = fit_channel(
            signal[index][use],
            instrument,
            places[use],
            pixels,
            shape=shape,
            surface=None if fit is None else fit.surfaces[len(fits)],
        )
        if shots.common_covariance is not None:
            shared = shots.common_covariance.part((*index, None))
            reference = replace(reference, common=reference.common + shared)
        # Shots of unknown directions may be pixels: their order is no time.
        fits.append(reference if has_directions else replace(reference, drift=NO_DRIFT))
    _refuse_strong_drift(scan, fits, signal.shape[:2])
    if fit is None:
        fit = ShotsFit(
            span=span,
            directions=places,
            model=model,
            surfaces=tuple(reference.surface for reference in fits),
        )
    return fits, fit


def directions_of(scan: Observation, shots: Observation) -> Floats:
    """Return directions of references, with repeats set to their mean direction.

    Shape (shot, 2), azimuth and elevation [rad], all zero if unknown. The
    positioning error of the stages is estimated from the pixels of the scan.
    """
    azimuth, elevation = shots.directions
    if azimuth is None or elevation is None:
        return np.zeros((shots.signal.shape[-1], 2))
    angles = zip(_AXES, (azimuth, elevation), strict=True)
    return np.stack([_averaged_repeats(scan, shots, *angle) for angle in angles], 1)


def expected_at_pixels(
    fits: list[Reference], shape: tuple[int, ...]
) -> tuple[Complex, Covariance]:
    """Return the open-water signal of every sample, and its covariance.

    The signal includes the water to the end of the column [V]. The covariance is that
    of the errors common to all pixels [V^2].
    """
    signal = np.array([fit.signal for fit in fits]).reshape(shape)
    return signal, stacked([fit.common for fit in fits], shape)


def fluctuation_of(fits: list[Reference], water_signal: Complex) -> Covariance:
    """Return the covariance of the water fluctuation from sample to sample."""
    levels = water_signal.reshape(-1, *water_signal.shape[2:])
    return stacked(
        [
            fluctuation(fit.relative, level.ravel())
            for fit, level in zip(fits, levels, strict=True)
        ],
        water_signal.shape,
    )


def real_drift_of(fits: list[Reference], shape: tuple[int, ...]) -> Complex:
    """Return the drift from the first reference to the last; 0 if not significant.

    Per unit of the water signal, shape (modulation_frequency, polarization, 1, 1) [1].
    """
    changes = [fit.drift.change if _is_real(fit.drift, fits) else 0j for fit in fits]
    return np.array(changes).reshape(*shape[:2], 1, 1)


def _averaged_repeats(
    scan: Observation, shots: Observation, name: str, stands: Floats
) -> Floats:
    """Average an angle of the references over the repeats of each direction.

    Scanners stop slightly beside the commanded angle, with a different error each
    time, so measured angles of repeats differ. The angle is the mean measured one.
    """
    meant = f"user_commanded_{name}"
    if meant in shots.cube:
        group = _groups(np.round(shots.cube[meant].values, 9))
    else:
        group = _clusters(stands, at_least=_MISSES * _jitter(scan, name))
    # Relative to the first repeat, so that equal angles stay equal to the last bit.
    first = stands[np.unique(group, return_index=True)[1]]
    off = np.bincount(group, stands - first[group]) / np.bincount(group)
    return np.asarray(first + off)[group]


def _clusters(angle: Floats, *, at_least: float) -> NDArray[np.intp]:
    """Return the cluster of each angle; without clusters, a cluster per value."""
    order = np.argsort(angle, kind="stable")
    gaps = np.diff(angle[order])
    near = max(_NEAR * float(np.ptp(angle)), at_least)
    group = np.empty(angle.size, dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(gaps > near)])
    widths = [np.ptp(angle[group == number]) for number in range(group.max() + 1)]
    return group if max(widths) <= near else _groups(np.round(angle, 9))


def _groups(values: Floats) -> NDArray[np.intp]:
    return np.unique(values, return_inverse=True)[1].ravel()


def _jitter(scan: Observation, name: str) -> float:
    """Return the standard deviation of measured minus commanded angles [rad]."""
    cube, meant = scan.cube, f"user_commanded_{name}"
    if meant not in cube:
        return 0.0
    off = (cube[name] - cube[meant]).values
    off = np.abs(off - np.nanmedian(off))
    # The median ignores the error of a stage that stuck once.
    return 1.4826 * float(np.nanmedian(off)) if np.isfinite(off).any() else 0.0


def _place(scan: Observation, index: tuple[int, ...]) -> str:
    frequency = scan.frequency[index[0]] / 1e6
    return f"{frequency:g} MHz in channel {scan.polarizations[index[1]]}"


def _is_real(drift: Drift, fits: list[Reference]) -> bool:
    return drift.chance * len(fits) < _REAL_DRIFT


def _refuse_strong_drift(
    scan: Observation, fits: list[Reference], shape: tuple[int, ...]
) -> None:
    sure = [
        abs(fit.drift.change) - _SURE * abs(fit.drift.uncertainty)
        if _is_real(fit.drift, fits)
        else 0.0
        for fit in fits
    ]
    worst = int(np.argmax(sure))
    if sure[worst] > LARGEST_DRIFT:
        drift = fits[worst].drift
        place = _place(scan, tuple(map(int, np.unravel_index(worst, shape))))
        cause = (
            "; so large a change is rather leakage that drifts: block the receiver "
            "with the laser on"
            if sure[worst] > 1
            else ""
        )
        raise CubeError(
            f"the open-water signal at {place} changed by "
            f"{abs(drift.change):.0%} (+- {abs(drift.uncertainty):.0%}) from the first "
            f"shot to the last, at most {LARGEST_DRIFT:.0%} can be bridged; record the "
            "reference again closer to the scan, or split scan and reference into "
            f"shorter parts{cause}"
        )


def _refuse_a_scan_beyond_the_shots(
    scan: Observation, shots: NDArray[np.float64], span: Span
) -> None:
    """Raise an error for a scan that extends beyond its open-water shots."""
    if scan.survey is not None and scan.survey.scan.moves == "both":
        return  # The receiver turns with the beam: the water is the same everywhere.
    low, high = shots.min(axis=0), shots.max(axis=0)
    room = np.maximum(_BEYOND * (high - low), BEYOND_AT_LEAST)
    first, last = np.array([span.azimuth, span.elevation]).T
    outside = np.maximum(low - first, last - high) - room
    if np.any(outside > 0):
        axis = int(np.argmax(outside))
        raise CubeError(
            f"the scan goes {np.degrees(outside[axis] + room[axis]):.2f} degrees "
            f"beyond the open-water shots in {('azimuth', 'elevation')[axis]}, where "
            "the water signal is not known; record shots at the edges of the scan"
        )


#: Attribute with the factor.
NOISE_SCALE = "open_water_noise_scale"
#: Least significance of the excess, in standard errors [1].
_SURE_OF_NOISE = 4.0
#: Scatter of a direction, in standard errors, above which it contains a spike [1].
_SPIKE = 6.0
#: Relative spread of noise below which noise and fluctuation are inseparable [1].
_ALIKE = 1e-6
#: Least square of the factor during the fit: rounded repeats may not scatter [1].
_LEAST_SQUARE = 0.1
#: Steps of the fit, each with the weights from the previous step.
_STEPS = 12


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Corrections of the stated noise, from the data of a scan."""

    scale: float
    """Factor on the stated errors, from the scatter of the open-water shots [1]."""
    resolution: Resolution
    """Steps of the outputs."""


def with_measured_noise(
    scan: Observation, noise: Noise | None = None
) -> tuple[Observation, Noise]:
    """Correct stated errors by rounding and scatter; return also the corrections.

    The rounding error of outputs on a grid is added. The sum is multiplied by
    `noise_scale`, which the attribute `open_water_noise_scale` states. A corrected scan
    is returned unchanged. `noise` replaces the corrections of this scan.
    """
    resolution = resolution_of(scan) if noise is None else noise.resolution
    scan = with_resolution(scan, resolution)
    scale = _scale_of(scan) if noise is None else noise.scale
    noise = Noise(scale=scale, resolution=resolution)
    if scale == 1:
        return scan, noise
    larger = {}
    for name, values in scan.cube.data_vars.items():
        if not str(name).startswith(("truth_", "user_")):
            if str(name).endswith(("in_phase_uncertainty", "quadrature_uncertainty")):
                larger[name] = values.copy(data=scale * values.values)
            elif str(name).endswith("in_phase_quadrature_covariance"):
                larger[name] = values.copy(data=scale**2 * values.values)
    cube = scan.cube.assign(larger).assign_attrs({NOISE_SCALE: scale})
    return Observation(cube=cube), noise


def _scale_of(scan: Observation) -> float:
    """Return the factor for a scan's stated errors, 1 if they are scaled already."""
    shots = scan.shots
    if (
        shots is None
        or shots.signal.shape[-1] < FEWEST_SHOTS
        or NOISE_SCALE in scan.cube.attrs
    ):
        return 1.0
    signal, errors = shots.signal, shots.covariance
    directions = directions_of(scan, shots)
    parts = [
        scatter_of(signal[index][use], errors.part(index).part(use), places)
        for index in np.ndindex(signal.shape[:2])
        if (use := shots.usable[index]).any() and (places := places_of(directions[use]))
    ]
    return noise_scale([scatter for part in parts for scatter in part])


#: Of the directions of one channel: scatter and what is stated [V^2], squared signal
#: [V^2], degrees of freedom.
Scatter = tuple[Floats, Floats, Floats, Floats]


def scatter_of(
    shots: Complex, instrument: Covariance, places: Places
) -> tuple[Scatter, Scatter]:
    """Return the scatter of repeated references, radial and tangential to the mean."""
    mean = places.mean_of(shots)
    size = np.abs(mean)
    turn = np.exp(1j * np.angle(mean))
    turned = instrument.turned(np.conj(turn)[places.group])
    rest = (shots - mean[places.group]) / turn[places.group]
    often = places.size > 1
    freedom = np.asarray(places.size[often] - 1, dtype=float)
    parts = []
    for values, nominal in (
        (rest.real, turned.in_phase),
        (rest.imag, turned.quadrature),
    ):
        variance = places.sum_of(values**2)[often] / freedom
        expected = places.sum_of(nominal)[often] / places.size[often]
        parts.append((variance, expected, size[often] ** 2, freedom))
    return parts[0], parts[1]


def noise_scale(scatters: list[Scatter]) -> float:
    r"""Return the ratio of scatter to stated errors; 1 if not significantly above.

    Shots of a direction scatter by :math:`s^2 u^2 + r\,|W|^2`: noise, which is stated
    as u, and a fluctuation of the water in proportion to its signal W, one r for each
    channel along W and across it. Where directions or channels differ in |W|, the two
    can be told apart; s is one number for the cube. Maximum likelihood of the sample
    variances by weighted least squares with weights of the step before; directions
    that scatter far more than the rest are left out.
    """
    valid = [
        scatter for scatter in scatters if scatter[0].size and scatter[1].min() > 0
    ]
    if not valid:
        return 1.0
    # From above, so that noisy directions are not mistaken for spikes.
    ratios = np.concatenate([scatter[0] / scatter[1] for scatter in valid])
    square = max(float(np.median(ratios)), _LEAST_SQUARE)
    estimate, information = 0.0, 0.0
    ratio = [0.0] * len(valid)
    for _ in range(_STEPS):
        score = information = 0.0
        for k, (variance, nominal, power, freedom) in enumerate(valid):
            expected = square * nominal + ratio[k] * power
            unsure = expected * np.sqrt(2 / freedom)
            weight = np.where(variance - expected < _SPIKE * unsure, unsure**-2, 0.0)
            norm = float(np.sum(weight * power**2))
            # At a fixed s the fluctuation follows; it is not below zero.
            excess = float(np.sum(weight * power * (variance - square * nominal)))
            ratio[k] = max(excess / norm, 0.0) if norm > 0 else 0.0
            # What of the noise no fluctuation could be, of either sign.
            shared = float(np.sum(weight * nominal * power)) / norm if norm > 0 else 0.0
            across = nominal - shared * power
            if np.abs(across).max() < _ALIKE * nominal.max():
                continue
            information += float(np.sum(weight * across * nominal))
            score += float(np.sum(weight * across * variance))
        if not information > 0:
            return 1.0
        estimate = score / information
        square = max(estimate, _LEAST_SQUARE)
    error = information**-0.5
    return float(np.sqrt(estimate)) if estimate > 1 + _SURE_OF_NOISE * error else 1.0
