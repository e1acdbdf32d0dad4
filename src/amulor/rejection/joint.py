"""Estimates target and water together from samples at several frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.optics import rays
from amulor.rejection import joint_pixels, joint_shared
from amulor.rejection.build import covariance_of, target_cube
from amulor.rejection.joint_pixels import Pixels
from amulor.rejection.joint_priors import Shared
from amulor.rejection.joint_solve import Result, solve
from amulor.rejection.joint_water import Frame, frame_of
from amulor.rejection.reference import Covariance

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels that settle what all share, evenly spread over the scan, and shots likewise.
_SHARING = 1024
#: Pixels worked on at once: this bounds the memory beyond the cube itself.
_AT_ONCE = 16_384
#: A path is settled when another interval is less likely than this [1].
_WRONG = 3e-4
#: Samples that disagree by more than this chance say that the model is wrong [1].
_DISAGREEMENT = 1e-4
#: Twice the logarithm of odds beyond which the model's departures are real [1].
_DECISIVE = 10.0
#: Departures matter when they move a path by this much of its uncertainty [1].
_MATTERS = 0.3
#: Step of the optical path for the derivative of the slant range [m].
_DIFFERENCE = 1e-5
_FEWEST_FREQUENCIES = 2


def joint(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    echo_transfer: NDArray[np.complex128] | None = None,
) -> xr.Dataset:
    r"""Estimate target and water signal together, by maximum likelihood.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` with at least two modulation frequencies and the attribute
        `survey`, of which the instrument and the scan are used and the optical
        properties of the water are not. Open-water shots are used if there are any.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m]. From 0 to the
        unambiguous range of the frequencies by default.
    echo_transfer : ndarray of complex, optional
        What the echo of the target has beyond its delay at each frequency, such as
        the spread of its arrival times, if it is known [1]; 1 by default.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`: the samples less the water signal that ends at the
        target. Variables that begin with `user_joint_` hold, over (row, column), the
        `slant_range` [m], its `uncertainty`, the part of it that all pixels share
        (`common_uncertainty`), the Cramer-Rao `bound`, `lower` and `upper` ends of
        the 68 % interval from the profile of the likelihood, the probability
        `wrong_interval` and the `misfit` (chi-square over its degrees of freedom).
        Attributes that begin with `joint_` hold what the pixels share.

    Raises
    ------
    CubeError
        If the cube has a single frequency, no survey, errors that are zero, or a
        receiver that does not see the beam.
    ValueError
        If the interval is empty or holds far too many ambiguity intervals, or the
        transfer is not one number above zero for each frequency.

    Notes
    -----
    In channel c and at frequency f a pixel shows
    :math:`A_c H(f) e^{2 \pi i f p / c_0} + s_c W(f; k', b_f \langle\theta^2\rangle,
    z)`, with the optical path p and the depth z of the target, and W the water signal
    (46) of [1]_, as rebuilt, that ends there. Strengths and shape of W belong to the
    whole scan. A smooth factor on its overlap and departures at each frequency, with
    priors whose widths the data choose, stand for what the model does not know; their
    uncertainty is part of that of the result. A random change of the water signal from
    sample to sample is estimated from the scatter.

    Flags: `NO_TARGET` where open water explains the samples about as well;
    `AMBIGUOUS` where another interval is likelier than 3e-4; `WATER_RESIDUAL` where
    the samples contradict the model (chi-square beyond chance 1e-4) or the departures
    that the scan shows move the path by 0.3 of its uncertainty or more.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cubes.check(cube, "samples")
    frequency = cube["modulation_frequency"].values
    _refuse_what_cannot_be_told_apart(cube)
    transfer = _checked_transfer(echo_transfer, frequency)
    signal, errors, usable = _flat(cube)
    _refuse_errors_of_zero(errors, usable)
    azimuth = cube["azimuth"].values.ravel().astype(float)
    elevation = cube["elevation"].values.ravel().astype(float)
    shots = cube.amulor.open_water
    places = _shot_directions(cube, shots)
    frame = frame_of(
        cube,
        np.concatenate([azimuth, places[0]]),
        np.concatenate([elevation, places[1]]),
    )

    def pixels(which: NDArray[np.intp] | slice) -> Pixels:
        return joint_pixels.pixels_of(
            frame,
            signal[which],
            Covariance(
                errors.in_phase[which], errors.quadrature[which], errors.cross[which]
            ),
            usable[which],
            azimuth[which],
            elevation[which],
            interval=interval,
            modulation_frequency=frequency,
        )

    enough = usable.any(axis=1).sum(axis=1) >= _FEWEST_FREQUENCIES
    if not enough.any():
        raise CubeError(
            "no pixel has usable samples at two frequencies or more; look at the "
            "flags of the samples (missing, saturated) and measure again"
        )
    chosen = np.flatnonzero(enough)
    chosen = chosen[
        np.linspace(0, len(chosen) - 1, min(_SHARING, len(chosen))).astype(int)
    ]
    some = pixels(chosen)
    longest = float(some.depths.max())
    shared = joint_shared.fit(
        frame,
        some,
        _shot_pixels(frame, shots, places, frequency),
        transfer=transfer,
        longest=longest,
    )
    parts = [
        solve(frame, pixels(slice(first, first + _AT_ONCE)), shared, transfer)
        for first in range(0, len(signal), _AT_ONCE)
    ]
    return _cube_of(cube, frame, parts, shared, enough, azimuth, elevation)


def _cube_of(
    cube: xr.Dataset,
    frame: Frame,
    parts: list[Result],
    shared: Shared,
    enough: NDArray[np.bool_],
    azimuth: Floats,
    elevation: Floats,
) -> xr.Dataset:
    """Return the target-signal cube of all results."""
    rows_columns = cube["azimuth"].shape
    shape = cube["in_phase"].shape

    def over_pixels(values: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(values).reshape(rows_columns)

    def over_samples(values: list[NDArray[Any]]) -> NDArray[Any]:
        flat = np.concatenate(values)
        return np.ascontiguousarray(flat.transpose(2, 1, 0)).reshape(shape)

    def covariances(values: list[Covariance]) -> Covariance:
        return Covariance(
            *(
                over_samples([getattr(part, name) for part in values])
                for name in ("in_phase", "quadrature", "cross")
            )
        )

    signal = cube.amulor.signal.values
    water = over_samples([part.water for part in parts])
    common = covariances([part.common for part in parts])
    total = covariance_of(cube) + common
    if shared.fluctuation > 0:
        stray = over_samples([part.stray for part in parts if part.stray is not None])
        total = total + Covariance(
            stray.real**2, stray.imag**2, stray.real * stray.imag
        )
    path = over_pixels([part.estimates.path for part in parts])
    seen = over_pixels([part.seen for part in parts])
    beam = frame.beam(azimuth.reshape(rows_columns), elevation.reshape(rows_columns))

    def to_range(length: Floats) -> Floats:
        return rays.slant_range_of_path(
            length, beam, frame.receiver, medium=frame.medium
        )

    slant_range = np.where(seen, to_range(path), np.nan)
    slope = (to_range(path + _DIFFERENCE) - to_range(path)) / _DIFFERENCE
    shared_variance = over_pixels([part.shared_variance for part in parts])
    information = over_pixels([part.estimates.information for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(1 / information + shared_variance)
        departure = over_pixels([part.departure for part in parts])
        matters = departure > _MATTERS * sigma
    freedom, cost, chance = _misfit(parts, seen, rows_columns)
    flag = np.zeros(rows_columns, dtype=np.int16)
    wrong = over_pixels([part.estimates.wrong for part in parts])
    flag[seen & (wrong > _WRONG)] |= QualityFlag.AMBIGUOUS
    contradicted = chance < _DISAGREEMENT
    flag[contradicted] |= QualityFlag.WATER_RESIDUAL
    if shared.evidence > _DECISIVE:
        flag[seen & matters] |= QualityFlag.WATER_RESIDUAL
    flag[~seen] |= QualityFlag.NO_TARGET
    flag[~enough.reshape(rows_columns)] |= QualityFlag.NO_TARGET
    target = target_cube(
        cube,
        signal - water,
        total,
        water_signal=water,
        common=common,
        step="reject, joint estimation",
        **_attributes(shared, frame),
    )
    missing = ~np.isfinite(signal)
    flags = np.broadcast_to(flag, shape).copy()
    if "saturated" in cube:
        flags[cube["saturated"].values != 0] |= QualityFlag.SATURATED
    flags[missing] = QualityFlag.MISSING
    target["quality_flag"].values[...] = flags
    half = [
        np.hypot(
            over_pixels([getattr(part.estimates, side) for part in parts]),
            np.sqrt(shared_variance),
        )
        * slope
        for side in ("lower", "upper")
    ]
    usable = seen & np.isfinite(slant_range)
    maps = {
        "slant_range": (slant_range, "m", "distance from the emitter along the beam"),
        "uncertainty": (slope * sigma, "m", "standard uncertainty of the slant range"),
        "common_uncertainty": (
            slope * np.sqrt(shared_variance),
            "m",
            "part of the uncertainty that all pixels share",
        ),
        "bound": (
            slope * np.sqrt(over_pixels([part.bound for part in parts])),
            "m",
            "Cramer-Rao bound of the slant range",
        ),
        "lower": (slant_range - half[0], "m", "lower end of the 68 % interval"),
        "upper": (slant_range + half[1], "m", "upper end of the 68 % interval"),
        "wrong_interval": (wrong, "1", "probability of another ambiguity interval"),
    }
    found = {
        f"user_joint_{name}": _map(np.where(usable, values, np.nan), units, long_name)
        for name, (values, units, long_name) in maps.items()
    }
    found["user_joint_misfit"] = _map(
        cost / np.maximum(freedom, 1), "1", "chi-square over its degrees of freedom"
    )
    return target.assign(found)


def _map(values: Floats, units: str, long_name: str) -> xr.Variable:
    return xr.Variable(
        ("row", "column"), values, {"long_name": long_name, "units": units}
    )


def _misfit(
    parts: list[Result], seen: NDArray[np.bool_], shape: tuple[int, ...]
) -> tuple[Floats, Floats, Floats]:
    """Return degrees of freedom, chi-square and its chance, pixel by pixel."""
    from scipy.stats import chi2

    channels = parts[0].estimates.amplitude.shape[1]
    used = np.concatenate([part.estimates.used for part in parts]).reshape(shape)
    own = np.concatenate([part.estimates.cost for part in parts]).reshape(shape)
    empty = np.concatenate([part.estimates.empty_cost for part in parts]).reshape(shape)
    cost = np.where(seen, own, empty)
    freedom = np.where(seen, used - channels - 1, used).astype(float)
    chance = np.ones(shape)
    some = freedom > 0
    chance[some] = chi2.sf(cost[some], freedom[some])
    return freedom, cost, chance


def _attributes(shared: Shared, frame: Frame) -> dict[str, Any]:
    """Return what the pixels share as attributes of a cube."""
    channels = len(shared.strength)
    errors = np.sqrt(np.diag(shared.covariance)[: channels + 3])
    loss, spread = shared.shape.reduced_attenuation, shared.shape.spread
    forward = shared.shape.forward_scattering
    return {
        "joint_water_strength_volt": shared.strength,
        "joint_water_strength_uncertainty_volt": errors[:channels],
        "joint_reduced_attenuation_per_m": loss,
        "joint_reduced_attenuation_uncertainty_per_m": loss * errors[channels],
        "joint_spread_rad2_per_m": spread,
        "joint_spread_uncertainty_rad2_per_m": spread * errors[channels + 1],
        "joint_forward_scattering_per_m": forward,
        "joint_forward_scattering_uncertainty_per_m": forward * errors[channels + 2],
        "joint_fluctuation": shared.fluctuation,
        "joint_departure_widths": np.array(shared.tried),
        "joint_departure_evidence": shared.evidence,
        "joint_misfit": shared.misfit,
    }


def _flat(cube: xr.Dataset) -> tuple[Complex, Covariance, NDArray[np.bool_]]:
    """Return samples over (pixel, channel, frequency), their errors, which count."""

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        wide = values.reshape(*values.shape[:2], -1)
        return np.ascontiguousarray(wide.transpose(2, 1, 0))

    signal = flat(cube.amulor.signal.values)
    stated = covariance_of(cube)
    errors = Covariance(
        flat(stated.in_phase), flat(stated.quadrature), flat(stated.cross)
    )
    usable = np.isfinite(signal) & np.isfinite(
        errors.in_phase + errors.quadrature + errors.cross
    )
    if "saturated" in cube:
        usable &= flat(cube["saturated"].values) == 0
    return signal, errors, usable


def _shot_directions(
    cube: xr.Dataset, shots: xr.Dataset | None
) -> tuple[Floats, Floats]:
    """Return where the open-water shots point; to the middle if that is not known."""
    if shots is None:
        return np.zeros(0), np.zeros(0)
    found = []
    for name in ("azimuth", "elevation"):
        if name in shots:
            found.append(shots[name].values.astype(float))
        else:
            middle = float(cube[name].values.mean())
            found.append(np.full(shots.sizes["shot"], middle))
    return found[0], found[1]


def _shot_pixels(
    frame: Frame,
    shots: xr.Dataset | None,
    places: tuple[Floats, Floats],
    frequency: Floats,
) -> Pixels | None:
    """Return open-water shots as samples of the likelihood."""
    if shots is None:
        return None
    count = shots.sizes["shot"]
    which = np.linspace(0, count - 1, min(_SHARING, count)).astype(int)

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.transpose(2, 1, 0)[which])

    signal = flat(shots["in_phase"].values + 1j * shots["quadrature"].values)
    stated = covariance_of(shots)
    errors = Covariance(
        flat(stated.in_phase), flat(stated.quadrature), flat(stated.cross)
    )
    usable = np.isfinite(signal) & np.isfinite(
        errors.in_phase + errors.quadrature + errors.cross
    )
    _refuse_errors_of_zero(errors, usable)
    return joint_pixels.pixels_of(
        frame,
        signal,
        errors,
        usable,
        places[0][which],
        places[1][which],
        interval=None,
        modulation_frequency=frequency,
    )


def open_water_samples(cube: xr.Dataset, *, no_target: bool) -> tuple[Frame, Pixels]:
    """Return the open water of a cube as samples of the likelihood.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    no_target : bool
        True to take the samples themselves, false to take the open-water shots.

    Returns
    -------
    tuple of Frame and Pixels
        How the receiver looks at them, and the samples.

    Raises
    ------
    CubeError
        If the cube has no survey, or states errors of zero.
    """
    frequency = cube["modulation_frequency"].values
    if not no_target:
        shots = cube.amulor.open_water
        places = _shot_directions(cube, shots)
        frame = frame_of(cube, *places)
        pixels = _shot_pixels(frame, shots, places, frequency)
        assert pixels is not None
        return frame, pixels
    signal, errors, usable = _flat(cube)
    _refuse_errors_of_zero(errors, usable)
    azimuth = cube["azimuth"].values.ravel().astype(float)
    elevation = cube["elevation"].values.ravel().astype(float)
    frame = frame_of(cube, azimuth, elevation)
    some = np.linspace(0, len(signal) - 1, min(_SHARING, len(signal))).astype(int)
    return frame, joint_pixels.pixels_of(
        frame,
        signal[some],
        Covariance(errors.in_phase[some], errors.quadrature[some], errors.cross[some]),
        usable[some],
        azimuth[some],
        elevation[some],
        interval=None,
        modulation_frequency=frequency,
    )


def _refuse_what_cannot_be_told_apart(cube: xr.Dataset) -> None:
    count = cube.sizes["modulation_frequency"]
    if count < _FEWEST_FREQUENCIES:
        frequency = float(cube["modulation_frequency"][0]) / 1e6
        raise CubeError(
            f"the cube has one modulation frequency, {frequency:g} MHz; joint "
            "estimation needs two or more to tell target from water: record a sweep, "
            "or use the open-water or a polarimetric method"
        )


def _refuse_errors_of_zero(errors: Covariance, usable: NDArray[np.bool_]) -> None:
    determinant = errors.in_phase * errors.quadrature - errors.cross**2
    if np.any(usable & ~(determinant > 0)):
        raise CubeError(
            "in_phase_uncertainty and quadrature_uncertainty must be above 0 V in "
            "every sample: joint estimation weighs the samples by them; state the "
            "noise of the instrument"
        )


def _checked_transfer(
    transfer: NDArray[np.complex128] | None, frequency: Floats
) -> Complex:
    if transfer is None:
        return np.ones(frequency.size, dtype=complex)
    given = np.asarray(transfer, dtype=complex)
    if given.shape != frequency.shape or not np.all(
        np.isfinite(given) & (np.abs(given) > 0)
    ):
        raise ValueError(
            f"echo_transfer must be one finite number other than 0 for each of the "
            f"{frequency.size} modulation frequencies, got shape {given.shape}"
        )
    return given
