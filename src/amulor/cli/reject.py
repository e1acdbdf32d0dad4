"""`amulor reject`: takes the water signal out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def reject(
    cube: Path,
    /,
    *,
    method: Literal["open-water", "cross-polarized", "co-polarized", "unmix", "none"],
    output: Annotated[Path, Parameter(alias="-o")],
    target_ratio: float | None = None,
    water_ratio: float | None = None,
    water_fluctuation: str | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Take the water signal out of a measurement cube.

    Parameters
    ----------
    cube
        Measurement cube (netCDF).
    method
        What to do; "none" keeps the water in, for comparison.
    output
        File to write (netCDF).
    target_ratio
        Cross- over co-polarized signal of the target, for unmix.
    water_ratio
        Cross- over co-polarized signal of the water, for unmix.
    water_fluctuation
        Relative change of the water signal from sample to sample, such
        as "5 %", for unmix without open-water shots.
    nearest
        Nearest possible slant range, such as "0.5 m", for open-water.
    farthest
        Farthest possible slant range, such as "3 m"; with --nearest.
    overwrite
        Replace a file that is there.
    """
    from amulor import io, rejection, units
    from amulor.cli._arguments import interval_of
    from amulor.errors import CubeError

    interval = interval_of(nearest, farthest)
    io.check_output(output, overwrite=overwrite, inputs=[cube])
    samples = io.read_cube(cube)
    if method == "unmix":
        if target_ratio is None or water_ratio is None:
            raise CubeError(
                "unmix needs --target-ratio and --water-ratio, the cross- over "
                "co-polarized signal of target and water"
            )
        try:
            target = rejection.unmix(
                samples,
                target_ratio=target_ratio,
                water_ratio=water_ratio,
                water_fluctuation=(
                    None
                    if water_fluctuation is None
                    else units.parse(water_fluctuation, "share")
                ),
            )
        except ValueError as error:
            raise CubeError(str(error)) from None
    elif method == "open-water":
        try:
            target = rejection.open_water(samples, interval=interval)
        except ValueError as error:
            raise CubeError(str(error)) from None
    else:
        function = {
            "cross-polarized": rejection.cross_polarized,
            "co-polarized": rejection.co_polarized,
            "none": rejection.keep_water,
        }[method]
        target = function(samples)
    io.write_cube(target, output, overwrite=overwrite)
    flagged = float((target["quality_flag"] != 0).mean())
    print(f"{output}: target signal, {flagged:.1%} of the samples flagged")
