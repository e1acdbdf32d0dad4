"""Daylight in the water: how bright it is where the receiver looks."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from amulor.survey.quantity import Description, Length, PerMetre, SpectralRadiance


class Daylight(Description):
    """Daylight that the receiver sees beside the laser's: it adds shot noise.

    Examples
    --------
    >>> from amulor.survey import Daylight
    >>> light = Daylight(
    ...     radiance="0.02 W/(m^2 sr nm)",
    ...     bandwidth="10 nm",
    ...     depth="12 m",
    ...     diffuse_attenuation="0.1 1/m",
    ... )
    >>> light.bandwidth, light.depth
    (1e-08, 12.0)
    """

    radiance: Annotated[SpectralRadiance, Field(ge=0)]
    """Spectral radiance just below the surface, from where the receiver looks, such as
    "0.01 W/m^2/sr/nm" [W/(m^2 sr m)]."""
    bandwidth: Annotated[Length, Field(gt=0, le=300e-9)]
    """Width of the optical filter before the detector [m]."""
    depth: Annotated[Length, Field(ge=0)] = 0.0
    """Depth of the instrument below the surface [m]."""
    diffuse_attenuation: Annotated[PerMetre, Field(ge=0)] = 0.0
    """Diffuse attenuation coefficient K_d of the water above it [1/m]."""
