"""`amulor water`: optical constants of pure water, and the fit of measured water."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from amulor.cli._arguments import check_inputs
from amulor.cli._output import print_json, progress_bar


def water(
    *,
    wavelength: str,
    temperature: float,
    salinity: float,
    frequency: str = "39MHz",
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Print the optical constants of pure fresh or sea water.

    Parameters
    ----------
    wavelength
        Wavelength in vacuum, "400nm" to "700nm".
    temperature
        Temperature of the water, 0 to 30 [degC].
    salinity
        Salinity, 0 (fresh water) to 43, practical or in parts per thousand.
    frequency
        Modulation frequency for the ambiguity interval.
    json
        Print the result as JSON, in SI units.
    """
    from amulor.cli._arguments import UsageError, quantity_of, refusing
    from amulor.optics import ranging
    from amulor.optics.water import seawater

    state = {"temperature": temperature, "salinity": salinity}
    length = quantity_of("--wavelength", wavelength, "wavelength")
    if not 399.9e-9 < length < 700.1e-9:
        raise UsageError(
            f"--wavelength {wavelength}: the constants are known from 400 nm to 700 nm"
        )
    modulation = quantity_of("--frequency", frequency, "frequency")
    with refusing():
        group_index = float(seawater.group_index(length, **state))
        constants: dict[str, Any] = {
            "refractive_index_air": seawater.refractive_index(length, **state),
            "refractive_index_vacuum": seawater.refractive_index_vacuum(
                length, **state
            ),
            "group_index": group_index,
            "absorption_mason_2016_per_m": seawater.mason_absorption(length, **state),
            "absorption_mason_2016_uncertainty_per_m": (
                seawater.mason_absorption_uncertainty(length, **state)
            ),
            "absorption_pope_fry_1997_per_m": seawater.pope_fry_absorption(length),
            "molecular_scattering_per_m": seawater.molecular_scattering(
                length, **state
            ),
            "molecular_backscattering_per_m": seawater.molecular_backscattering(
                length, **state
            ),
            "ambiguity_interval_m": ranging.ambiguity_interval(
                modulation, group_index=group_index
            ),
        }
    if json:
        conditions = {
            "wavelength_m": length,
            "temperature_degC": temperature,
            "salinity": salinity,
            "modulation_frequency_hz": modulation,
            "absorption_default": "mason_2016",
        }
        print_json(conditions | constants)
        return
    number = {name: float(value) for name, value in constants.items()}
    print(
        f"Pure water, {length * 1e9:g} nm, {temperature:g} degC, salinity {salinity:g}"
    )
    for name, text in (
        (
            "refractive index",
            f"{number['refractive_index_air']:.5f} to air, "
            f"{number['refractive_index_vacuum']:.5f} to vacuum (Quan and Fry 1995)",
        ),
        ("group index", f"{number['group_index']:.4f} to vacuum"),
        (
            "absorption",
            f"{number['absorption_mason_2016_per_m']:.5f} +- "
            f"{number['absorption_mason_2016_uncertainty_per_m']:.5f} 1/m (WOPP v3, "
            "Mason 2016 below 510 nm)",
        ),
        (
            "",
            "the default: later, with an uncertainty and with salt",
        ),
        (
            "",
            f"{number['absorption_pope_fry_1997_per_m']:.5f} 1/m (Pope and Fry 1997, "
            "fresh, 22 degC)",
        ),
        (
            "molecular scattering",
            f"{number['molecular_scattering_per_m']:.6f} 1/m, backwards "
            f"{number['molecular_backscattering_per_m']:.6f} 1/m (Zhang 2009)",
        ),
        (
            "ambiguity interval",
            f"{number['ambiguity_interval_m']:.3f} m at {modulation / 1e6:g} MHz",
        ),
    ):
        print(f"{name:>22}: {text}" if name else f"{'':>22}  {text}")


def fit(
    cube: Path,
    /,
    *,
    no_target: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Fit the water of a cube: attenuation, angular spread, cut-off frequency.

    Parameters
    ----------
    cube
        Measurement cube (netCDF) with open-water shots at three or more frequencies.
    no_target
        The scan has no target: its samples are open water, too.
    json
        Print the result as JSON, in SI units.
    """
    check_inputs(cube)

    from dataclasses import asdict

    from amulor import io, rejection

    with progress_bar(quiet=json) as advance:
        advance("fit of the water", 0.0)
        result = rejection.water_fit(io.read_cube(cube), no_target=no_target)
    if json:
        print_json(asdict(result))
        return
    identified = dict(zip(result.names, result.identified, strict=True))
    for text, value, error, unit, name in (
        (
            "reduced attenuation k'",
            result.reduced_attenuation,
            result.reduced_attenuation_uncertainty,
            "1/m",
            "reduced_attenuation",
        ),
        (
            "spread b_f <theta^2>",
            result.spread,
            result.spread_uncertainty,
            "rad^2/m",
            "spread",
        ),
        (
            "forward scattering b_f",
            result.forward_scattering,
            result.forward_scattering_uncertainty,
            "1/m",
            "forward_scattering",
        ),
        (
            "depth of the maximum",
            result.depth_of_maximum,
            result.depth_of_maximum_uncertainty,
            "m",
            "",
        ),
        (
            "cut-off",
            result.cut_off / 1e6,
            result.cut_off_uncertainty / 1e6,
            "MHz",
            "",
        ),
    ):
        note = "" if identified.get(name, True) else " (not settled by these data)"
        print(f"{text:<24}{value:.4g} +- {error:.2g} {unit}{note}")
    print(f"{'fluctuation':<24}{result.fluctuation:.2%}")
    print(f"{'misfit':<24}{result.misfit:.3g} (1 if the model is right)")
