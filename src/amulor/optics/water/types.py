r"""Named waters: Jerlov types, Petzold's stations, milk and Maalox in tap water.

Each result states whether its numbers are measured or modeled, and their possible
error. Coefficients of natural waters include those of the water itself.

References
----------
.. [1] M. G. Solonenko and C. D. Mobley, Appl. Opt. 54, 5392 (2015),
   :doi:`10.1364/AO.54.005392`.
.. [2] C. A. Williamson and R. C. Hollins, Appl. Opt. 61, 9951 (2022); dataset
   :doi:`10.6084/m9.figshare.20290782`.
.. [3] T. J. Petzold, Volume Scattering Functions for Selected Ocean Waters, SIO Ref.
   72-78 (1972).
.. [4] J. R. Frisvad, N. J. Christensen and H. W. Jensen, ACM Trans. Graph. 26(3), 60
   (2007), :doi:`10.1145/1276377.1276452`.
.. [5] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
   :doi:`10.1155/2010/958360`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _tables
from amulor.optics._bounds import within
from amulor.optics.phase_functions.tables import STATIONS as PETZOLD_STATIONS

__all__ = [
    "JERLOV_SOURCES",
    "MAALOX_VOLUME_FRACTION",
    "PETZOLD_STATIONS",
    "JerlovWater",
    "Milk",
    "PetzoldStation",
    "jerlov",
    "milk",
    "petzold_station",
]

_Array = NDArray[np.float64]

JERLOV_SOURCES = {
    "solonenko-mobley-2015": "solonenko_mobley_2015.csv",
    "williamson-hollins-2022": "williamson_hollins_2022.csv",
}
"""Published sources of the Jerlov types, with their table files."""

_MEASURED = "williamson_hollins_2022_measured.csv"

MAALOX_VOLUME_FRACTION = 0.1e-6 / 27e-3
"""Volume fraction of Maalox in ref. [5]: 0.1 ml in 27 liters, 3.7e-6 [1].

The dose is all that is known: no scattering coefficient of Maalox at 405 nm has a
source to cite, and a number without one would be worse than none. Measure the
attenuation of the mixture [1/m] and state that.
"""

# Fat by mass: scattering of undiluted milk [1/m] and asymmetry, both at 405 nm.
_MILKS = {0.001: (3.4e3, 0.25), 0.015: (12.5e3, 0.63), 0.035: (37e3, 0.80)}


@dataclass(frozen=True, kw_only=True)
class JerlovWater:
    """Absorption and scattering of a Jerlov water type, arrays of one shape.

    Examples
    --------
    >>> from amulor.optics.water.types import jerlov
    >>> water = jerlov("III", 475e-9, source="solonenko-mobley-2015")
    >>> bool(water.scattering > water.absorption > 0), str(water.status)
    (True, 'model')
    """

    absorption: _Array
    """Absorption coefficient a, pure water included [1/m]."""
    scattering: _Array
    """Scattering coefficient b, pure water included [1/m]."""
    status: NDArray[np.str_]
    """`measured` for fits to averaged measurements, else `model`."""
    absorption_deviation: _Array
    """Standard deviation of a between campaigns; NaN for a model [1/m]."""
    scattering_deviation: _Array
    """Standard deviation of b between campaigns; NaN for a model [1/m]."""


@dataclass(frozen=True, kw_only=True)
class PetzoldStation:
    """Optical properties measured at one of Petzold's stations.

    Examples
    --------
    >>> from amulor.optics.water.types import petzold_station
    >>> harbour = petzold_station("NUC 2200")
    >>> print(harbour.place, f"c = {harbour.attenuation:.3f} 1/m")
    San Diego Harbor c = 1.920 1/m
    """

    name: str
    """Station name in Petzold's report."""
    water: str
    """Kind of water for which the station is commonly used."""
    place: str
    """Place of the measurement."""
    date: str
    """Date of the measurement, ISO 8601."""
    wavelength: float
    """Wavelength [m]."""
    attenuation: float
    """Measured attenuation coefficient c [1/m]."""
    scattering: float
    """Scattering coefficient b, integrated from the measured function [1/m]."""
    absorption: float
    """Absorption coefficient a = c - b [1/m]."""
    backscatter_fraction: float
    """Ratio of backscattering to scattering, b_b / b [1]."""
    median_angle: float
    """Median scattering angle [rad]."""
    status: Literal["measured"] = "measured"
    """Source of the numbers."""


@dataclass(frozen=True, kw_only=True)
class Milk:
    """Scattering coefficient and asymmetry of milk in the water.

    Examples
    --------
    >>> from amulor.optics.water.types import milk
    >>> added = milk(1e-4, fat=0.035)
    >>> print(f"{float(added.scattering):.2f} 1/m at {added.wavelength * 1e9:.0f} nm")
    3.70 1/m at 405 nm
    """

    wavelength: float
    """Wavelength [m]."""
    scattering: _Array
    """Scattering coefficient of the milk alone [1/m]."""
    asymmetry: float
    """Mean cosine of the scattering angle [1]."""
    uncertainty_factor: float
    """Uncertainty of the scattering as a factor, up and down [1]."""
    status: Literal["model"] = "model"
    """Source of the numbers."""


def jerlov(water_type: str, wavelength: ArrayLike, *, source: str) -> JerlovWater:
    """Return absorption and scattering of a Jerlov water type.

    Parameters
    ----------
    water_type : str
        Name of the type, such as "IB" (clear ocean), "III" or "3C" (coastal).
    wavelength : array_like
        Wavelength in vacuum, 300e-9 to 700e-9, or to 800e-9 by the second source [m].
    source : str
        "solonenko-mobley-2015": a model fitted to diffuse attenuation, types I, IA, IB,
        II, III, 1C, 3C (to 650 nm), 5C (to 575 nm), 7C and 9C.
        "williamson-hollins-2022": averages of measurements, types IB, II, III, 1C, 3C
        and 5C.

    Returns
    -------
    JerlovWater
        Coefficients of the shape of `wavelength`, their status and deviation.

    Raises
    ------
    ValueError
        If the source does not have this type or this wavelength.

    Notes
    -----
    Refs. [1] and [2] of this module, linear between the printed wavelengths. Jerlov's
    types are classes of diffuse attenuation, which does not fix absorption and
    scattering apart: from 400 nm on the two sources differ by up to a factor of 5.2 in
    scattering and 2.9 in absorption (type III, 400 and 442 nm), so there is no default.
    Ref. [1] gives no uncertainty, and its scattering of types I and IA contradicts its
    own Table 3. From 412 to 555 nm the campaigns behind ref. [2] scatter by 14 to 45 %
    in scattering and by 10 to 45 % in absorption, and by 5 % in that of IB at 555 nm.
    Its curves are `measured` from 412 to 715 nm, II to 676 nm and IB to 555 nm; 405 nm
    is an extrapolation of 7 nm. They are fits that leave 8 % (root mean square) of the
    averages, at worst 19 % in scattering and 32 % in absorption. Deviations are linear
    between the averages; the zero of absorption at 715 nm (1C, 3C, 5C) is the table's
    and no measured one.

    Examples
    --------
    >>> for source in JERLOV_SOURCES:
    ...     water = jerlov("III", [405e-9, 440e-9], source=source)
    ...     print(water.scattering.round(3), water.status)
    [1.656 1.436] ['model' 'model']
    [0.323 0.312] ['model' 'measured']
    """
    if source not in JERLOV_SOURCES:
        raise ValueError(
            f"source must be one of {', '.join(JERLOV_SOURCES)}, got {source!r}: the "
            "two differ by a factor of several, so one has to be chosen"
        )
    rows = _tables.rows(JERLOV_SOURCES[source])
    types = list(dict.fromkeys(row["water_type"] for row in rows))
    if water_type not in types:
        raise ValueError(
            f"water_type must be one of {', '.join(types)} for source {source}, got "
            f"{water_type!r}"
        )
    grid, absorption, scattering = _columns(
        rows, water_type, "absorption_per_m", "scattering_per_m"
    )
    inside = within(wavelength, grid[0], grid[-1], name="wavelength", unit="m")
    measured = np.zeros(inside.shape, dtype=bool)
    deviations = [np.full(inside.shape, np.nan) for _ in range(2)]
    if source == "williamson-hollins-2022":
        points, *spreads = _columns(
            _tables.rows(_MEASURED),
            water_type,
            "absorption_deviation_per_m",
            "scattering_deviation_per_m",
        )
        rounding = 1e-12 * points[-1]
        measured = (inside >= points[0] - rounding) & (inside <= points[-1] + rounding)
        deviations = [
            np.where(measured, np.interp(inside, points, spread), np.nan)
            for spread in spreads
        ]
    return JerlovWater(
        absorption=np.asarray(np.interp(inside, grid, absorption)),
        scattering=np.asarray(np.interp(inside, grid, scattering)),
        status=np.where(measured, "measured", "model"),
        absorption_deviation=deviations[0],
        scattering_deviation=deviations[1],
    )


def petzold_station(name: str) -> PetzoldStation:
    """Return the optical properties at one of Petzold's stations.

    Parameters
    ----------
    name : str
        One of `PETZOLD_STATIONS`. Textbooks usually show "AUTEC 8" (clear ocean),
        "HAOCE 11" (coastal) and "NUC 2040" (turbid harbour).

    Returns
    -------
    PetzoldStation
        Numbers at 530 nm as printed in the report.

    Raises
    ------
    ValueError
        If there is no such station.

    Notes
    -----
    Ref. [3] of this module, three decimals; the report gives no uncertainty. Its volume
    scattering functions reproduce the printed scattering within 0.3 % and the
    backscatter fraction within 0.0008. Scattering below the first measured angle, some
    0.1 to 0.2 degrees, is extrapolated in the report. In turbid water, absorption is a
    small difference of two numbers. All numbers are for 530 nm. At 405 nm the shape of
    the phase function may be used, but not the coefficients.

    Examples
    --------
    >>> station = petzold_station("NUC 2040")
    >>> print(station.water, station.attenuation, station.backscatter_fraction)
    harbour 2.19 0.02
    """
    for row in _tables.rows("petzold_1972_coefficients.csv"):
        if row["station"] == name:
            return PetzoldStation(
                name=name,
                water=row["water"],
                place=row["place"],
                date=row["date"],
                wavelength=530e-9,
                attenuation=float(row["attenuation_per_m"]),
                scattering=float(row["scattering_per_m"]),
                absorption=float(row["absorption_per_m"]),
                backscatter_fraction=float(row["backscatter_fraction"]),
                median_angle=math.radians(float(row["median_angle_deg"])),
            )
    raise ValueError(f"name must be one of {', '.join(PETZOLD_STATIONS)}, got {name!r}")


def milk(volume_fraction: ArrayLike, *, fat: float) -> Milk:
    """Return the scattering coefficient and asymmetry of milk in water at 405 nm.

    Parameters
    ----------
    volume_fraction : array_like
        Milk per volume of the mixture, 0 to 1; 0.001 is 1 ml in a litre [1].
    fat : float
        Fat of the milk by mass, 0.001, 0.015 or 0.035 [1]. Scattering is not
        proportional to fat, so other values are refused.

    Returns
    -------
    Milk
        Scattering of the shape of `volume_fraction`, asymmetry, uncertainty.

    Raises
    ------
    ValueError
        If a volume fraction is out of range or there is no such milk.

    Notes
    -----
    Mie spheres of fat and casein with the sizes and indices of ref. [4] of this module:
    3400, 12500 and 37000 1/m of undiluted milk, with asymmetries of 0.25, 0.63 and
    0.80. The milk of ref. [5] had 1.5 % of fat: 12.5 1/m for 1 ml in a litre. Expect an
    error of up to a factor of 1.5 either way. At 550 nm the model has a reduced
    scattering of 0.99 and 4.8 per mm for the leanest and the fattest of these milks,
    measured are 1.22 and 3.2 to 5.8 per mm; another interpretation of its size law, and
    of the index of the whey, gives 1.1 to 1.5 times the scattering at 405 nm.
    Homogenization and brand change it, too. For a reliable value, measure the
    attenuation of the mixture. Absorption is neglected: 12 to 20 1/m of undiluted milk
    in the blue band of a camera, less than a hundredth of the scattering.

    Examples
    --------
    >>> mixture = milk(1e-3, fat=0.015)
    >>> print(f"{mixture.scattering:.1f} 1/m within {mixture.uncertainty_factor}")
    12.5 1/m within 1.5
    """
    fraction = within(volume_fraction, 0, 1, name="volume_fraction")
    for fat_content, (scattering, asymmetry) in _MILKS.items():
        if math.isclose(fat, fat_content, rel_tol=1e-9):
            return Milk(
                wavelength=405e-9,
                scattering=np.asarray(scattering * fraction),
                asymmetry=asymmetry,
                uncertainty_factor=1.5,
            )
    listed = ", ".join(f"{fat_content:g}" for fat_content in _MILKS)
    raise ValueError(f"fat must be one of {listed} (by mass), got {fat:g}")


def _columns(
    rows: tuple[dict[str, str], ...], water_type: str, *names: str
) -> list[_Array]:
    """Return wavelengths [m] and named columns of a Jerlov water type."""
    selected = [row for row in rows if row["water_type"] == water_type]
    grid = 1e-9 * np.array([float(row["wavelength_nm"]) for row in selected])
    return [grid, *(np.array([float(row[name]) for row in selected]) for name in names)]
