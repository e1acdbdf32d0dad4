"""One channel of a cube as ranges need it: phases, errors, geometry, survey."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import UNUSABLE, QualityFlag
from amulor.cube.error import flags_of_pixels
from amulor.cube.tiles import Span
from amulor.errors import CubeError, SurveyError
from amulor.imaging.noise import with_noise_scaled
from amulor.optics import ambiguity, detection, ranging, rays
from amulor.optics._geometry import Geometry
from amulor.survey import Survey

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_WINDOW = (
    "window_distance",
    "window_thickness",
    "window_refractive_index",
    "window_group_index",
)


def geometry_of(cube: xr.Dataset) -> Geometry:
    """Return the geometry of the pixels of a cube of any level."""
    stated = cube["geometry"].attrs
    emitter, receiver = (
        np.asarray(stated[f"{name}_position"], dtype=float)
        for name in ("emitter", "receiver")
    )
    shape = (*cube["azimuth"].shape, 3)
    starts, ends = (np.broadcast_to(each, shape).copy() for each in (emitter, receiver))
    for axis, name in enumerate(("origin_x", "origin_y", "origin_z")):
        if name in cube.coords:
            starts[..., axis] = cube[name].values
            ends[..., axis] += cube[name].values - emitter[axis]
    return Geometry(
        azimuth=cube["azimuth"].values,
        elevation=cube["elevation"].values,
        emitter=starts,
        receiver=ends,
        medium=rays.Medium(
            refractive_index=float(stated["refractive_index"]),
            group_index=float(stated["group_index"]),
            **{name: float(stated[name]) for name in _WINDOW if name in stated},
        ),
    )


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One channel of a target signal, each quantity read from it once.

    Arrays run over (frequency, row, column), those of pixels over (row, column).
    """

    channel: xr.Dataset
    """The channel: what its image takes over, and further variables."""
    geometry: Geometry
    """Beams, receivers and media of the pixels."""
    survey: Survey | None
    """The survey; None where the cube has none that can be read."""
    most_outliers: float = ambiguity.BREAKDOWN
    """Largest share of the frequencies of a pixel that may be left out [1]."""
    span: Span | None = None
    """Directions of the scan; None where the channel is all of it."""

    @cached_property
    def frequency(self) -> Floats:
        """Modulation frequencies [Hz]."""
        return np.asarray(self.channel["modulation_frequency"].values)

    @cached_property
    def path_per_phase(self) -> Floats:
        """Optical paths, out and back: twice the range at a group index of 1 [m]."""
        return 2 * ranging.range_per_phase(
            self.frequency[:, None, None], group_index=1.0
        )

    @cached_property
    def signal(self) -> Complex:
        """Target signal [V]."""
        return np.asarray(self.channel.amulor.signal.values)

    @cached_property
    def _flags(self) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        return flags_of_pixels(
            self.channel["quality_flag"].values, most_outliers=self.most_outliers
        )

    @property
    def flag(self) -> NDArray[np.int16]:
        """Quality flags of the pixels."""
        return self._flags[0]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Pixels without an unusable flag."""
        return np.asarray((self.flag & UNUSABLE) == 0)

    @property
    def phase(self) -> Floats:
        """Phases, 0 in unusable pixels [rad]."""
        return np.where(self.usable, np.angle(self.signal), 0.0)

    @cached_property
    def sigma(self) -> Floats:
        """Standard uncertainties of the phases, infinite where left out [rad]."""
        return np.where(self._flags[1], np.inf, self._sigma("", self.usable))

    @property
    def own_sigma(self) -> Floats:
        """Uncertainties of the phases without what the pixels share [rad]."""
        shared = self.shared_sigma(self.usable)
        if shared is None:
            return self.sigma
        return np.sqrt(np.maximum(self.sigma**2 - shared**2, 0.0))

    def shared_sigma(self, usable: NDArray[np.bool_]) -> Floats | None:
        """Uncertainties of the phases that pixels share; None if not stated [rad]."""
        if "common_covariance" not in self.channel:
            return None
        return self._sigma("common_", usable)

    def _sigma(self, prefix: str, usable: NDArray[np.bool_]) -> Floats:
        """Phase uncertainty from the errors of the outputs, arbitrary if unusable."""
        one, signal = self.channel, self.signal
        cross = one["common_covariance"] if prefix else one.amulor.covariance
        good = np.broadcast_to(usable, signal.shape)
        in_phase, quadrature = (
            np.where(good, one[f"{prefix}{output}_uncertainty"].values ** 2, 1.0)
            for output in ("in_phase", "quadrature")
        )
        return detection.phase_uncertainty(
            np.where(good, signal, 1.0),
            in_phase_variance=in_phase,
            quadrature_variance=quadrature,
            covariance=np.where(good, cross.values, 0.0),
        )

    @cached_property
    def shift(self) -> Floats:
        """Shifts of the phases by water left in, NaN where not known [rad]."""
        one = self.channel
        if "residual_in_phase" in one:
            left = one["residual_in_phase"].values
            left = left + 1j * one["residual_quadrature"].values
            return ranging.phase_shift(self.signal, residual=left)
        taken_out = (one["quality_flag"].values & QualityFlag.NO_OPEN_WATER) == 0
        return np.where(taken_out, 0.0, np.nan)

    @property
    def has_late_light(self) -> bool:
        """Whether scattered light may come late: measured, or simulated with it."""
        stated = self.channel.attrs.get("late_echo")
        if stated is None:
            return not self.channel.attrs.get("simulated", 0)
        return str(stated) != "absent"

    def joint_values(self, *names: str) -> tuple[float, ...] | None:
        """Return attributes of a joint estimation; None where they are not there."""
        stated = self.channel.attrs
        if "joint_slant_range" not in self.channel:
            return None
        if any(f"joint_{name}" not in stated for name in names):
            return None
        return tuple(float(stated[f"joint_{name}"]) for name in names)

    def with_noise(self, factor: float) -> Observation:
        """Return the observation with larger errors of its own."""
        return replace(self, channel=with_noise_scaled(self.channel, factor))


def observe(channel: xr.Dataset, **options: Any) -> Observation:
    """Return the observation of one channel of a target signal."""
    return Observation(
        channel=channel,
        geometry=geometry_of(channel),
        survey=readable_survey(channel),
        **options,
    )


def channel_of(cube: xr.Dataset, polarization: str | None) -> xr.Dataset:
    """Return one polarization channel of a cube."""
    present = cube.amulor.polarizations
    if polarization is None and len(present) > 1:
        raise CubeError(
            f"the cube has the channels {', '.join(present)}; choose one with "
            "polarization (command line: --polarization)"
        )
    chosen = present[0] if polarization is None else polarization
    if chosen not in present:
        raise CubeError(
            f"the cube has no channel {chosen!r}, but {', '.join(present)}; choose one"
        )
    return cube.sel(polarization=chosen)


def readable_survey(cube: xr.Dataset) -> Survey | None:
    """Return the survey of a cube; None if it has none that can be read."""
    try:
        survey: Survey | None = cube.amulor.survey
    except SurveyError:
        return None
    return survey
