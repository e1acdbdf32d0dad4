"""Medium of photon transport: homogeneous layers of water."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.transport.scattering import ScatteringMatrix

__all__ = ["Layer", "Medium"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Layer:
    """Homogeneous layer of water, or of empty space, between two parallel planes.

    Raises
    ------
    ValueError
        If a coefficient is below zero or not finite, both are zero in an unbounded
        layer, or the thickness is not above zero.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import isotropic
    >>> from amulor.transport import Layer
    >>> layer = Layer(absorption=0.25, scattering=0.5, phase_function=isotropic())
    >>> layer.attenuation
    0.75
    """

    absorption: float
    """Absorption coefficient a [1/m]."""
    scattering: float
    """Scattering coefficient b [1/m]."""
    phase_function: PhaseFunction | ScatteringMatrix
    """Phase function, or scattering matrix for polarized transport."""
    thickness: float = math.inf
    """Thickness of the layer [m]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for invalid coefficients or thickness."""
        for name in ("absorption", "scattering"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(
                    f"{name} must be at least 0 1/m, got {value!r} 1/m; the "
                    "single-scattering albedo b / (a + b) has to be from 0 to 1"
                )
        if self.attenuation == 0 and math.isinf(self.thickness):
            raise ValueError(
                "absorption and scattering must not both be 0 1/m in a layer without "
                "end"
            )
        if not self.thickness > 0:
            raise ValueError(f"thickness must be above 0 m, got {self.thickness!r} m")

    @property
    def attenuation(self) -> float:
        """Attenuation coefficient c = a + b [1/m]."""
        return self.absorption + self.scattering


@dataclass(frozen=True, eq=False, kw_only=True)
class Medium:
    """Stack of water layers along the forward axis.

    Light that leaves the first or the last layer is absorbed. All layers have the same
    refractive index, so that rays are straight.

    Raises
    ------
    ValueError
        If there is no layer, an inner layer is unbounded, only some layers have
        scattering matrices, or light could travel forever.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import isotropic
    >>> medium = Medium.homogeneous(
    ...     absorption=0.2, scattering=0.8, phase_function=isotropic(), group_index=1.38
    ... )
    >>> print(medium.edges)
    (-inf, inf)
    """

    layers: tuple[Layer, ...]
    """Layers in forward order."""
    group_index: float
    """Group index of all layers [1]."""
    top: float = -math.inf
    """Forward coordinate at which the first layer starts [m]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid index or stack of layers."""
        if not (math.isfinite(self.group_index) and self.group_index >= 1):
            raise ValueError(
                f"group_index must be at least 1, got {self.group_index!r}"
            )
        if not self.layers:
            raise ValueError("a medium needs at least one layer, got none")
        if (
            len({isinstance(x.phase_function, ScatteringMatrix) for x in self.layers})
            > 1
        ):
            raise ValueError(
                "either all layers have a ScatteringMatrix or none: Stokes vectors "
                "need one in each layer"
            )
        endless = [math.isinf(layer.thickness) for layer in self.layers]
        if math.isinf(self.top) and not (len(self.layers) == 1 and endless[0]):
            raise ValueError(
                "top must be a finite place on the forward axis [m] if there is more "
                "than one layer, or one with a thickness"
            )
        if math.isnan(self.top) or self.top == math.inf:
            raise ValueError(
                f"top must be a place on the forward axis [m], got {self.top!r} m"
            )
        if all(layer.attenuation == 0 for layer in self.layers):
            raise ValueError(
                "a medium needs a layer that absorbs or scatters, got only layers with "
                "an attenuation of 0 1/m"
            )
        if any(endless[:-1]):
            raise ValueError("only the last layer may be without a thickness")
        if endless[-1] and self.layers[-1].absorption == 0:
            raise ValueError(
                "a layer without end needs an absorption above 0 1/m: without it "
                "light would never end its way"
            )

    @classmethod
    def homogeneous(
        cls,
        *,
        absorption: float,
        scattering: float,
        phase_function: PhaseFunction | ScatteringMatrix,
        group_index: float,
    ) -> Self:
        """Return a medium of homogeneous, unbounded water.

        Parameters
        ----------
        absorption, scattering : float
            Coefficients a and b [1/m].
        phase_function : PhaseFunction or ScatteringMatrix
            Phase function, or scattering matrix for polarized light.
        group_index : float
            Group index [1].

        Returns
        -------
        Medium
            Medium of one unbounded layer.
        """
        layer = Layer(
            absorption=absorption, scattering=scattering, phase_function=phase_function
        )
        return cls(layers=(layer,), group_index=group_index)

    @classmethod
    def layered(
        cls, layers: Sequence[Layer], *, group_index: float, top: float = 0.0
    ) -> Self:
        """Return a medium of several water layers in forward order.

        Parameters
        ----------
        layers : sequence of Layer
            Layers in the order in which light passes them forward.
        group_index : float
            Group index [1].
        top : float
            Beginning of the first layer on the forward axis [m].

        Returns
        -------
        Medium
            Medium of these layers, with absorbing space before and behind them.
        """
        return cls(layers=tuple(layers), group_index=group_index, top=top)

    @property
    def edges(self) -> tuple[float, ...]:
        """Boundaries of the layers on the forward axis [m]."""
        if math.isinf(self.top):
            return (-math.inf, math.inf)
        edges = [self.top]
        for layer in self.layers:
            edges.append(edges[-1] + layer.thickness)
        return tuple(edges)

    @property
    def polarized(self) -> bool:
        """Whether transport in this medium computes Stokes vectors."""
        return isinstance(self.layers[0].phase_function, ScatteringMatrix)

    @property
    def unbounded(self) -> bool:
        """Whether the medium is a single layer of water that fills all space."""
        return all(math.isinf(edge) for edge in self.edges)
