"""Range images from a single frequency, by phase unwrapping between pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.errors import CubeError, MissingExtraError
from amulor.imaging.observation import channel_of, observe
from amulor.imaging.range_image import image_of_path
from amulor.optics import ambiguity

Floats = NDArray[np.float64]

#: Fraction of a surface that must lie in the interval; the rest may be noise [1].
_INSIDE = 0.98


def unwrapped_range_image(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float],
    polarization: str | None = None,
    modulation_frequency: float | None = None,
) -> xr.Dataset:
    """Unwrap the phase at one frequency into slant ranges along continuous surfaces.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `target_signal`.
    interval : tuple of float
        Nearest and farthest slant range that are possible [m]. It may contain several
        ambiguity intervals, but each connected surface must fit into it at a single
        distance.
    polarization : str, optional
        Channel to use; needed if there are several.
    modulation_frequency : float, optional
        Frequency to use, exactly as in the cube [Hz]. By default the frequency with the
        smallest range error.

    Returns
    -------
    xarray.Dataset
        Level `range_image`. Surfaces that fit into the interval at several distances,
        or at none, are flagged `AMBIGUOUS` and are NaN.

    Raises
    ------
    CubeError
        If the channel or the frequency is missing, or must be chosen among several.
    MissingExtraError
        If scikit-image is not installed.
    ValueError
        If the interval is empty.

    Notes
    -----
    This is a fallback for a single frequency. Several frequencies resolve the interval
    pixel by pixel, without any assumption about the scene (`range_image`). Here
    neighbors are assumed to differ by less than half an ambiguity interval. The method
    is the reliability-ordered unwrapping of scikit-image (M. A. Herraez et al., Appl.
    Opt. 41, 7437 (2002)). A larger step of the scene is too small by whole intervals in
    the result, without any sign of it. Regions that unusable pixels separate are
    unwrapped independently.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.unwrapped_range_image(target, interval=(1.0, 2.0))
    >>> print(f"{float(image['slant_range'].median()):.2f} m")
    1.43 m
    """
    cube = cubes.checked(cube, "target_signal")
    channel = channel_of(cube, polarization)
    channel = channel.isel(
        modulation_frequency=[_frequency(channel, modulation_frequency)]
    )
    observation = observe(channel)
    usable, sigma, phase = observation.usable, observation.sigma, observation.phase[0]
    wavelength = float(speed_of_light / observation.frequency[0])
    shortest, longest = np.broadcast_arrays(
        *observation.geometry.path_limits(interval, observation.frequency)
    )
    length = np.zeros(phase.shape)
    settled = np.zeros(phase.shape, dtype=bool)
    sigma_of_path = sigma[0] * wavelength / (2 * np.pi)
    slack = _SLACK * sigma_of_path
    for box, surface in _surfaces(usable):
        path = _unwrapped(phase[box], surface)[surface] * wavelength / (2 * np.pi)
        low = (shortest - slack)[box][surface]
        high = (longest + slack)[box][surface]
        first = int(np.ceil(np.min(low - path) / wavelength))
        last = int(np.floor(np.max(high - path) / wavelength))
        fits = [
            turns
            for turns in range(first, last + 1)
            if np.mean(
                (path + turns * wavelength >= low) & (path + turns * wavelength <= high)
            )
            >= _INSIDE
        ]
        chosen_length = path + (fits[0] if fits else 0) * wavelength
        length[box][surface] = chosen_length
        # A lone pixel just outside is rather one turn off.
        sure = (_MEDIAN_SLACK * sigma_of_path)[box][surface]
        beyond = np.maximum(
            np.median(shortest[box][surface] - sure - chosen_length),
            np.median(chosen_length - longest[box][surface] - sure),
        )
        settled[box][surface] = len(fits) == 1 and beyond <= 0
    chosen = ambiguity.Path(
        length=length,
        uncertainty=sigma_of_path,
        weight=np.ones((1, *phase.shape)),
        settled=settled,
        wrong=np.where(settled, 0.0, 1.0),
        residual=np.zeros((1, *phase.shape)),
        strain=np.zeros(phase.shape),
        left_out=np.zeros((1, *phase.shape), dtype=bool),
    )
    image = image_of_path(observation, chosen, interval=interval)
    return cubes.note(
        image, f"image, channel {image.attrs['polarization']}, unwrapped in space"
    )


#: A range may lie this many standard errors outside the interval: it was measured.
_SLACK = 4.0
#: The median of a surface may lie outside by fewer: one pixel is a surface, too.
_MEDIAN_SLACK = 2.0


def _frequency(channel: xr.Dataset, chosen: float | None) -> int:
    available = channel["modulation_frequency"].values
    if chosen is None:
        observation = observe(channel)
        if not observation.usable.any():
            return 0
        error = np.median(observation.sigma[:, observation.usable], axis=1)
        return int(np.argmin(error / available))
    which = np.flatnonzero(np.isclose(available, chosen, rtol=1e-9))
    if len(which) == 0:
        listed = ", ".join(f"{value / 1e6:g}" for value in available)
        raise CubeError(
            f"the cube has no target signal at {chosen / 1e6:g} MHz, but at {listed} "
            "MHz; choose one of these"
        )
    return int(which[0])


def _surfaces(
    usable: NDArray[np.bool_],
) -> list[tuple[tuple[slice, slice], NDArray[np.bool_]]]:
    """Return connected regions of usable pixels, each as bounding box and mask."""
    from scipy import ndimage

    label, _ = ndimage.label(usable)
    boxes = ndimage.find_objects(label)
    return [(box, label[box] == number + 1) for number, box in enumerate(boxes)]


def _unwrapped(phase: Floats, surface: NDArray[np.bool_]) -> Floats:
    """Unwrapped phase of one connected region [rad]."""
    try:
        from skimage.restoration import unwrap_phase
    except ImportError:
        raise MissingExtraError(
            "scikit-image", extra="unwrap", purpose="spatial unwrapping"
        ) from None
    unwrapped = phase.copy()
    if min(phase.shape) == 1:
        # A single row or column: the way from pixel to pixel is the only one.
        unwrapped[surface] = np.unwrap(phase[surface])
        return unwrapped
    hidden: Any = np.ma.array(phase, mask=~surface)
    solved = unwrap_phase(hidden)  # type: ignore[no-untyped-call]
    unwrapped[surface] = np.asarray(solved)[surface]
    return unwrapped
