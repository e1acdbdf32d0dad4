"""Range profile of a pixel, and the surfaces along its beam, from a cube."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.errors import CubeError
from amulor.imaging.observation import channel_of, geometry_of
from amulor.optics import range_profile

Floats = NDArray[np.float64]

#: Points of the profile per resolution.
_POINTS = 16


@dataclass(frozen=True, kw_only=True)
class BeamProfile:
    """Range profile of a pixel, and the surfaces along its beam."""

    slant_range: Floats
    """Slant ranges of the profile [m]."""
    profile: Floats
    """Modulus of the profile of the target signal [V]."""
    water: Floats | None
    """Modulus of the profile of the subtracted water signal; None if none [V]."""
    noise: float
    """Standard uncertainty of real and imaginary part of the profile [V]."""
    surface: Floats
    """Slant ranges of the surfaces [m]."""
    surface_uncertainty: Floats
    """Standard uncertainties of these ranges, from the errors of the samples [m]."""
    amplitude: Floats
    """Amplitudes of the echoes [V]."""
    amplitude_uncertainty: Floats
    """Standard uncertainties of the amplitudes [V]."""
    misfit: float
    """Chi-square of the samples about surfaces and water [1]."""
    freedom: int
    """Degrees of freedom of chi-square."""
    resolution: float
    """Range resolution of the frequencies [m]."""
    unambiguous_span: float
    """Range after which the profile of a regular sweep repeats [m]."""


def beam_profile(
    cube: xr.Dataset,
    *,
    row: int,
    column: int,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
    most: int = 4,
) -> BeamProfile:
    """Range profile of a pixel of a target signal."""
    level = cube.attrs.get("level")
    if level != "target_signal":
        raise CubeError(
            "a range profile needs a target signal, but the file has the level "
            f"{level}; use a result of `amulor reject`"
        )
    rows, columns = cube.sizes["row"], cube.sizes["column"]
    if not (0 <= row < rows and 0 <= column < columns):
        raise CubeError(
            f"pixel {row},{column} is outside the cube of {rows} rows and {columns} "
            "columns; count both from 0"
        )
    channel = channel_of(cube, polarization)
    pixel = channel.isel(row=[row], column=[column])
    signal = pixel.amulor.signal.values[:, 0, 0]
    errors = [
        pixel[f"{part}_uncertainty"].values[:, 0, 0]
        for part in ("in_phase", "quadrature")
    ]
    error = np.hypot(*errors) / np.sqrt(2)
    water = None
    if "water_in_phase" in pixel and np.any(pixel["water_in_phase"]):
        water = pixel.amulor.water_signal.values[:, 0, 0]
    fitted = water is not None
    usable = np.isfinite(signal) & np.isfinite(error)
    if water is not None:
        usable &= np.isfinite(water)
    if "saturated" in pixel:
        usable &= pixel["saturated"].values[:, 0, 0] == 0
    frequency = pixel["modulation_frequency"].values[usable]
    if np.unique(frequency).size < range_profile.fewest(1):
        raise CubeError(
            f"pixel {row},{column} has valid samples at {np.unique(frequency).size} of "
            f"{usable.size} modulation frequencies; a range profile needs at least "
            f"{range_profile.fewest(1)}"
        )
    signal, error = signal[usable], error[usable]
    water = None if water is None else water[usable]
    if np.unique(frequency).size < range_profile.fewest(most):
        possible = np.unique(frequency).size - range_profile.fewest(0)
        raise CubeError(
            f"{np.unique(frequency).size} modulation frequencies do not determine "
            f"{most} surfaces; state at most {possible}"
        )
    geometry = geometry_of(pixel)
    index = geometry.medium.group_index
    sweep = {"modulation_frequency": frequency, "group_index": index}
    width = range_profile.resolution(**sweep)
    span = range_profile.unambiguous_span(**sweep)
    start = geometry.beam.length_before.item()
    end = geometry.slant_range(np.full((1, 1), 2 * index * span)).item()
    near, far = interval or (start, end)
    near = max(near, start)
    if width >= far - near:
        raise CubeError(
            f"the frequencies separate no two surfaces between {near:g} and {far:g} m: "
            f"their range resolution is {width:.3g} m; record a wider band, or "
            "frequencies with a smaller spacing"
        )
    place = np.linspace(near, far, 2 + int(_POINTS * (far - near) / width))
    half = geometry.optical_path(place[:, None, None]).ravel() / (2 * index)
    of = {**sweep, "standard_uncertainty": error, "slant_range": half}
    try:
        profile, noise = range_profile.range_profile(signal, **of)
        estimate = range_profile.surfaces(
            signal,
            standard_uncertainty=error,
            interval=(float(half[0]), float(half[-1])),
            water_signal=water,
            most=most,
            **sweep,
        )
    except ValueError as problem:
        raise CubeError(str(problem)) from None
    count = estimate.slant_range.size
    path = 2 * index * estimate.slant_range[:, None, None]
    surface, slope = geometry.slant_range_and_slope(path)
    amplitude_variance = np.diag(estimate.covariance)[count:]
    return BeamProfile(
        slant_range=place,
        profile=np.abs(profile),
        water=None
        if water is None
        else np.abs(range_profile.range_profile(water, **of)[0]),
        noise=float(noise),
        surface=surface.ravel(),
        surface_uncertainty=2 * index * slope.ravel() * estimate.uncertainty,
        amplitude=estimate.amplitude,
        amplitude_uncertainty=np.sqrt(amplitude_variance),
        misfit=estimate.misfit,
        freedom=2 * frequency.size - 2 * count - fitted,
        resolution=width,
        unambiguous_span=span,
    )
