"""Axes and rejection methods of a design evaluation, and array broadcasting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.design import _kernels as kernel
from amulor.errors import SurveyError

__all__ = [
    "AXES",
    "LOCK_IN_SHARE",
    "PREDICTED",
    "Arranged",
    "Axis",
    "Method",
    "Predicted",
    "arranged",
]

Floats = NDArray[np.float64]

#: Share of the dwell that the lock-in's time constant may have [1].
LOCK_IN_SHARE = 0.1


@dataclass(frozen=True)
class Axis:
    """Variable parameter of instrument, water or target in an evaluation."""

    meaning: str
    """Short description of the parameter."""
    unit: str
    """SI unit."""
    least: float = 0.0
    """Smallest allowed value [unit]."""
    open: bool = True
    """Whether the smallest value is excluded."""
    most: float = np.inf
    """Largest allowed value [unit]."""


#: All axes with numbers, by name.
AXES = {
    "distance": Axis("slant range of the target", "m"),
    "attenuation": Axis("attenuation coefficient, at the albedo of the water", "1/m"),
    "absorption": Axis("absorption coefficient", "1/m", open=False),
    "scattering": Axis("scattering coefficient", "1/m", open=False),
    "reflectance": Axis("reflectance of the target", "1", most=1.0),
    "target_m22": Axis("Mueller element m22 of the target", "1", -1.0, False, 1.0),
    "water_m22": Axis("Mueller element m22 of the water", "1", -1.0, False, 1.0),
    "slope": Axis("inclination of the surface", "rad", 0.0, False, 1.5),
    "texture": Axis("change of reflectance over the beam's half-width", "1", 0, False),
    "power": Axis("mean launched power", "W"),
    "modulation_depth": Axis("modulation depth", "1", most=1.0),
    "frequency": Axis("modulation frequency", "Hz"),
    "baseline": Axis("distance of emitter and receiver", "m", 0.0, False),
    "aim": Axis("distance at which the receiver's axis meets the beam", "m"),
    "radius": Axis("1/e half-width of the aperture", "m"),
    "field_of_view": Axis("1/e half-width of the field of view", "rad", most=0.5),
    "dwell": Axis("time on each pixel, frequency and channel", "s"),
    "speed": Axis("speed of the vehicle", "m/s", 0.0, False),
    "phase_floor": Axis("phase error that no light removes", "rad", 0.0, False),
    "dark_rate": Axis("dark counts", "1/s", 0.0, False),
    "radiance": Axis("daylight just below the surface", "W/(m2 sr m)", 0.0, False),
    "fluctuation": Axis("random change of the water signal", "1", 0.0, False, 1.0),
    "water_change": Axis("change of the water since the shots", "1", 0.0, False, 1.0),
    "column_uncertainty": Axis(
        "uncertainty of the water behind the target", "1", 0.0, False, 1.0
    ),
    "ratio_uncertainty": Axis(
        "uncertainty of depolarization ratios", "1", 0.0, False, 1.0
    ),
    "departure": Axis("departure of the water from its model", "1", 0.0, False, 1.0),
}


Method = Literal["none", "frequency", "open-water", "polarization", "combined", "joint"]


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Properties of a rejection method for the prediction of its error."""

    kernel: int
    """Number of the method in the compiled loops."""
    channel_pair: bool = False
    """Whether a co-polarized and a cross-polarized channel are required."""
    separate_frequencies: bool = True
    """Whether the phase errors determine an optimum dwell time per frequency."""
    assumptions: tuple[str, ...] = ()
    """Fields of `Assumptions` that affect the error."""


#: By the names of `amulor.rejection.names`.
PREDICTED: dict[str, Predicted] = {
    "none": Predicted(kernel=kernel.KEPT),
    "frequency": Predicted(kernel=kernel.ONE_FREQUENCY, separate_frequencies=False),
    "open-water": Predicted(
        kernel=kernel.OPEN_WATER,
        assumptions=("water_change", "column_uncertainty"),
    ),
    "polarization": Predicted(
        kernel=kernel.UNMIX, channel_pair=True, assumptions=("ratio_uncertainty",)
    ),
    "combined": Predicted(
        kernel=kernel.COMBINED,
        channel_pair=True,
        assumptions=("water_change", "column_uncertainty", "ratio_uncertainty"),
    ),
    "joint": Predicted(
        kernel=kernel.JOINT,
        separate_frequencies=False,
        assumptions=("departure",),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Arranged:
    """Values of all varied parameters, with common dimensions."""

    sizes: dict[str, int]
    """Length of each dimension by its name."""
    values: dict[str, Floats]
    """Values of each axis, with all dimensions, of length 1 if constant."""
    frequencies: Floats | None
    """Sets of modulation frequencies, (K, ...), padded with NaN [Hz]."""
    coordinates: dict[str, Any]
    """Coordinates of the array dimensions."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return tuple(self.sizes.values())


def arranged(
    axes: Mapping[str, Any], frequencies: Sequence[Sequence[float]] | None
) -> Arranged:
    """Reshape the arguments of an evaluation to common dimensions."""
    if "attenuation" in axes and {"absorption", "scattering"} & set(axes):
        raise SurveyError(
            "attenuation is the sum of absorption and scattering; state it alone, or "
            "the other two"
        )
    if frequencies is not None and "frequency" in axes:
        raise SurveyError("state frequency, or frequencies, not both")
    by_axis: dict[str, tuple[tuple[str, ...], Floats]] = {}
    sizes: dict[str, int] = {}
    coordinates: dict[str, Any] = {}
    for name, value in axes.items():
        dims, values = _axis_values(name, value)
        by_axis[name] = dims, values
        for dim, size in zip(dims, values.shape, strict=True):
            if sizes.setdefault(dim, size) != size:
                raise SurveyError(
                    f"{name}: has {size} values along {dim}, others have {sizes[dim]}"
                )
        if isinstance(value, xr.DataArray):
            coordinates |= {str(key): value.coords[key] for key in value.coords}
        elif dims:
            axis = AXES[name]
            coordinates[name] = (
                name,
                values,
                {"long_name": axis.meaning, "units": axis.unit},
            )
    set_columns: list[Floats] = []
    if frequencies is not None:
        sizes["frequency_set"] = len(frequencies)
        set_columns, texts = _sets(frequencies)
        coordinates["frequency_set"] = ("frequency_set", texts)
    order = list(sizes)

    def spread(dims: tuple[str, ...], values: Floats) -> Floats:
        moved = np.transpose(values, np.argsort([order.index(dim) for dim in dims]))
        return moved.reshape([sizes[dim] if dim in dims else 1 for dim in order])

    shape = [-1 if dim == "frequency_set" else 1 for dim in order]
    sets = (
        np.stack([column.reshape(shape) for column in set_columns])
        if set_columns
        else None
    )
    return Arranged(
        sizes=sizes,
        values={name: spread(*axis_values) for name, axis_values in by_axis.items()},
        frequencies=sets,
        coordinates=coordinates,
    )


def _axis_values(name: str, value: Any) -> tuple[tuple[str, ...], Floats]:
    """Dimensions and values of a parameter; SurveyError for a wrong name or value."""
    if name not in AXES:
        raise SurveyError(
            f"{name}: is no axis of a design; allowed are {', '.join(AXES)}, "
            "frequencies, polarization, method"
        )
    axis = AXES[name]
    dims: tuple[str, ...] = ()
    values = np.asarray(value, dtype=float)
    if isinstance(value, xr.DataArray):
        dims = tuple(map(str, value.dims))
    elif values.ndim == 1:
        dims = (name,)
    elif values.ndim > 1:
        raise SurveyError(
            f"{name}: has {values.ndim} dimensions without names; give a number, a "
            "list, or an xarray.DataArray"
        )
    low = values > axis.least if axis.open else values >= axis.least
    good = low & (values <= axis.most) & ~np.isnan(values)
    if name != "aim":
        good &= np.isfinite(values)
    if not values.size or not good.all():
        refused = f"{values[~good].flat[0]:g} {axis.unit}" if values.size else "nothing"
        above = "above" if axis.open else "at least"
        most = f" and at most {axis.most:g}" if np.isfinite(axis.most) else ""
        raise SurveyError(
            f"{name}: found {refused}, but it must be {above} {axis.least:g}{most} "
            f"{axis.unit}"
        )
    return dims, values


def _sets(frequencies: Sequence[Sequence[float]]) -> tuple[list[Floats], list[str]]:
    """First, second, ... frequencies of all sets, as arrays; and labels of the sets."""
    most = max((len(members) for members in frequencies), default=0)
    if min((len(members) for members in frequencies), default=0) < 1:
        raise SurveyError("frequencies: each set needs one frequency at least")
    filled = np.full((most, len(frequencies)), np.nan)
    for number, members in enumerate(frequencies):
        filled[: len(members), number] = sorted(members)
    if not np.all(filled[np.isfinite(filled)] > 0):
        raise SurveyError("frequencies: all must be above 0 Hz")
    texts = [
        " + ".join(f"{f / 1e6:.6g}" for f in sorted(s)) + " MHz" for s in frequencies
    ]
    return list(filled), texts
