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
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Take the water signal out of a measurement cube.

    Parameters
    ----------
    cube: Measurement cube (netCDF).
    method: What to do; "none" keeps the water in, for comparison.
    output: File to write (netCDF).
    target_ratio: Cross- over co-polarized signal of the target, for unmix.
    water_ratio: Cross- over co-polarized signal of the water, for unmix.
    overwrite: Replace a file that is there.
    """
    from amulor import io, rejection
    from amulor.errors import CubeError

    samples = io.read_cube(cube)
    if method == "unmix":
        if target_ratio is None or water_ratio is None:
            raise CubeError(
                "unmix needs --target-ratio and --water-ratio, the cross- over "
                "co-polarized signal of target and water"
            )
        try:
            target = rejection.unmix(
                samples, target_ratio=target_ratio, water_ratio=water_ratio
            )
        except ValueError as error:
            raise CubeError(str(error)) from None
    else:
        function = {
            "open-water": rejection.open_water,
            "cross-polarized": rejection.cross_polarized,
            "co-polarized": rejection.co_polarized,
            "none": rejection.keep_water,
        }[method]
        target = function(samples)
    io.write_cube(target, output, overwrite=overwrite)
    flagged = float((target["quality_flag"] != 0).mean())
    print(f"{output}: target signal, {flagged:.1%} of the samples flagged")
