"""Access to a cube: complex signals, groups, geometry, survey."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from amulor.cube import schema
from amulor.cube.values import restore_dimensions

if TYPE_CHECKING:
    from amulor.survey import Survey


def group(cube: xr.Dataset, name: str) -> xr.Dataset | None:
    """Return a group of a cube, its variables renamed without the group prefix.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level.
    name : str
        Name of the group: "open_water" or "truth".

    Returns
    -------
    xarray.Dataset or None
        Variables of the group without the prefix, with their coordinates; None if the
        cube has no such group.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> shots = cubes.group(samples.cube("ladder"), "open_water")
    >>> shots["in_phase"].sizes["shot"]
    540
    """
    prefix = f"{name}_"
    names = [str(key) for key in cube.data_vars if str(key).startswith(prefix)]
    if not names:
        return None
    short = {key: key.removeprefix(prefix) for key in names}
    # A coordinate of the cube must not collide with a variable of the group.
    clash = [name for name in short.values() if name in cube.coords]
    return (
        cube[names]
        .drop_vars(clash, errors="ignore")
        .rename(short)
        .drop_attrs(deep=False)
    )


def without_groups(cube: xr.Dataset, *groups: str) -> xr.Dataset:
    """Return a cube without groups such as open-water shots and true values.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level.
    *groups : str
        Groups to remove, "open_water" or "truth"; by default both.

    Returns
    -------
    xarray.Dataset
        Cube without the groups. Without both, it has only variables that every
        processing step may read.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> cube = samples.cube("ladder")
    >>> len(cube), len(cubes.without_groups(cube))  # variables
    (19, 6)
    """
    prefixes = tuple(f"{name}_" for name in groups or schema.GROUPS)
    names = [key for key in cube.data_vars if not str(key).startswith(prefixes)]
    # Selected by names alone, a cube has no coordinates of the dimension `reading`.
    readings = {
        name: values for name, values in cube.coords.items() if "reading" in values.dims
    }
    return cube[names].assign_coords(readings)


def attach(cube: xr.Dataset, part: xr.Dataset, name: str) -> xr.Dataset:
    """Return a cube with a group added, its variables under a common prefix.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level.
    part : xarray.Dataset
        Variables of the group, without the prefix.
    name : str
        Name of the group: "open_water" or "truth".

    Returns
    -------
    xarray.Dataset
        New cube with the group.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> cube = samples.cube("ladder")
    >>> shots = cubes.group(cube, "open_water")
    >>> again = cubes.attach(cubes.without_groups(cube), shots, "open_water")
    >>> again["open_water_in_phase"].dims
    ('modulation_frequency', 'polarization', 'shot')
    """
    prefixed = {f"{name}_{key}": part[key].variable for key in part.data_vars}
    return cube.assign(prefixed)


def flag_counts(cube: xr.Dataset) -> dict[str, int]:
    """Count the pixels or samples that have each quality flag.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level.

    Returns
    -------
    dict
        Number of pixels or samples by flag name, for flags that occur; empty without
        `quality_flag`.

    Examples
    --------
    >>> from amulor import cube as cubes, rejection, samples
    >>> cubes.flag_counts(rejection.keep_water(samples.cube("ladder")))
    {'no_open_water': 8000}
    """
    if "quality_flag" not in cube:
        return {}
    flag = cube["quality_flag"]
    counts = {
        meaning: int(np.count_nonzero(flag.values & mask))
        for mask, meaning in zip(
            flag.attrs["flag_masks"], flag.attrs["flag_meanings"].split(), strict=True
        )
    }
    return {meaning: count for meaning, count in counts.items() if count}


@lru_cache(maxsize=8)
def _survey_of(text: str) -> Survey:
    from amulor.survey import Survey

    return Survey.from_text(text, name="survey in the cube")


class CubeAccessor:
    """`cube.amulor`: signals, groups, geometry and survey of a cube.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level.

    Examples
    --------
    >>> from amulor import samples
    >>> cube = samples.cube("ladder")
    >>> cube.amulor.level, cube.amulor.polarizations
    ('samples', ['VV', 'VH'])
    >>> print(f"{float(cube.amulor.amplitude.max()):.3f} V")
    0.028 V
    """

    def __init__(self, cube: xr.Dataset) -> None:
        self._cube = cube

    @property
    def level(self) -> str:
        """Processing level: samples, target_signal, range_image or point_cloud."""
        return str(self._cube.attrs["level"])

    @property
    def restored(self) -> xr.Dataset:
        """Cube with the dimensions restored that selections of single values remove."""
        return restore_dimensions(self._cube)

    @property
    def polarizations(self) -> list[str]:
        """Names of the polarization channels, in the order of the cube."""
        return [str(name) for name in np.ravel(self._cube["polarization"].values)]

    @property
    def signal(self) -> xr.DataArray:
        """Complex signal, `in_phase + 1j * quadrature` [V]."""
        signal = self._cube["in_phase"] + 1j * self._cube["quadrature"]
        return signal.rename("signal").assign_attrs(units="V", long_name="signal")

    @property
    def amplitude(self) -> xr.DataArray:
        """Modulus of the signal [V]."""
        amplitude: xr.DataArray = xr.apply_ufunc(np.abs, self.signal)
        return amplitude.rename("amplitude").assign_attrs(
            units="V", long_name="amplitude of the modulation"
        )

    @property
    def phase(self) -> xr.DataArray:
        """Delay of the signal behind the reference, in (-pi, pi] [rad]."""
        phase: xr.DataArray = xr.apply_ufunc(np.angle, self.signal)
        return phase.rename("phase").assign_attrs(
            units="rad", long_name="delay behind the reference"
        )

    @property
    def water_signal(self) -> xr.DataArray:
        """Complex water signal that was subtracted [V]."""
        water = self._cube["water_in_phase"] + 1j * self._cube["water_quadrature"]
        return water.rename("water_signal").assign_attrs(
            units="V", long_name="water signal"
        )

    @property
    def covariance(self) -> xr.DataArray:
        """Covariance of in-phase and quadrature output, 0 if not in the cube [V^2]."""
        if "in_phase_quadrature_covariance" in self._cube:
            return self._cube["in_phase_quadrature_covariance"]
        return xr.zeros_like(self._cube["in_phase"]).assign_attrs(units="V2")

    @property
    def open_water(self) -> xr.Dataset | None:
        """Open-water references over frequency, channel and shot; None without any."""
        return group(self._cube, "open_water")

    @property
    def truth(self) -> xr.Dataset | None:
        """True values of a simulated cube; no processing step reads them."""
        return group(self._cube, "truth")

    @property
    def survey(self) -> Survey | None:
        """Survey of the cube, parsed once; None if the cube has no survey."""
        text = str(self._cube.attrs.get("survey") or "")
        return _survey_of(text) if text else None

    @property
    def geometry(self) -> dict[str, Any]:
        """Positions and refractive indices that convert phases to points."""
        return dict(self._cube["geometry"].attrs)


class _Accessor:
    """Descriptor that creates a `CubeAccessor` at each access of `cube.amulor`.

    xarray would keep an accessor with each cube, and the two would refer to each other.
    Cubes would then stay in memory until the garbage collector runs, which counts
    objects, not bytes.
    """

    def __get__(self, cube: xr.Dataset | None, owner: type) -> Any:
        return CubeAccessor if cube is None else CubeAccessor(cube)


xr.Dataset.amulor = _Accessor()  # type: ignore[attr-defined]
