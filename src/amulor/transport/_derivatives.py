"""Parameters to which a transport run computes derivatives, and their scores."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.transport._problem import Problem, cells_of, digest_of

__all__ = ["Derivatives", "PhaseFunctionChange"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Parameters of a receiver, in the order of their scores.
_RECEIVER = (
    "receiver_right",
    "receiver_down",
    "receiver_radius",
    "receiver_tilt_right",
    "receiver_tilt_down",
)
#: Parameters that have no phase function.
_PARAMETERS = ("absorption", "scattering", "reflectance", "range", *_RECEIVER)


#: Largest distance of the source from the plane of the receiver's face, over the range.
#: The derivative to the range is wrong by about as much [1].
_LEVEL = 0.01


class Range(NamedTuple):
    """Numbers of the derivative to the range, which the other derivatives give."""

    range: float
    """Distance from the source to the target along the beam [m]."""
    attenuation: float
    """Attenuation coefficient [1/m]."""
    scattering: float
    """Scattering coefficient [1/m]."""
    right: float
    """Place of the source to the right of the receiver [m]."""
    down: float
    """Place of the source below the receiver [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseFunctionChange:
    """Change of the phase function with a parameter, for derivatives of the light.

    Raises
    ------
    ValueError
        If the step is not finite or is zero, or the name is that of another parameter.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> from amulor.transport import PhaseFunctionChange
    >>> change = PhaseFunctionChange(
    ...     name="asymmetry",
    ...     lower=henyey_greenstein_function(asymmetry=0.949),
    ...     upper=henyey_greenstein_function(asymmetry=0.951),
    ...     step=0.002,
    ... )
    >>> change.name, change.step
    ('asymmetry', 0.002)
    """

    name: str
    """Name of the parameter."""
    lower: PhaseFunction
    """Phase function half a step below the value of the parameter."""
    upper: PhaseFunction
    """Phase function half a step above the value."""
    step: float
    """Difference of the parameter between both phase functions."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid step or name."""
        if not (math.isfinite(self.step) and self.step != 0):
            raise ValueError(
                f"step must be a finite number other than 0, got {self.step!r}"
            )
        if self.name in _PARAMETERS:
            raise ValueError(
                f"name must not be one of {', '.join(_PARAMETERS)}, got {self.name!r}"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class Derivatives:
    """Parameters of the derivatives of a run, and the scores of its scatterings."""

    names: tuple[str, ...] = ()
    """Names of the parameters."""
    events: tuple[str, ...] = ()
    """Names of those with a score at each scattering."""
    score: Array = field(default_factory=lambda: np.zeros((0, 1, 1)))
    """Derivative of ln(b p), shape (events, layers, angle cells)."""
    radius: float = 1.0
    """Radius of the receiver [m]."""
    distance: Range | None = None
    """Numbers of the derivative to the range, if requested."""

    @classmethod
    def of(
        cls, parameters: Sequence[str | PhaseFunctionChange], problem: Problem
    ) -> Derivatives:
        """Return the scores of parameters; ValueError if the problem has none."""
        names = tuple(p if isinstance(p, str) else p.name for p in parameters)
        if len(set(names)) < len(names):
            raise ValueError(f"derivatives must have different names, got {names}")
        water = problem.water
        events, scores = [], []
        for name, parameter in zip(names, parameters, strict=True):
            if isinstance(parameter, PhaseFunctionChange):
                if len(water.value) > 1:
                    raise ValueError(
                        "the derivative to a phase function needs the same phase "
                        f"function in all layers, got {len(water.value)}"
                    )
                events.append(name)
                scores.append(_phase_score(parameter, water.value[0], problem))
            elif name == "scattering":
                scattering = water.albedo * water.attenuation
                if not np.all(scattering > 0):
                    raise ValueError(
                        "the derivative to scattering needs layers that all scatter, "
                        "got a layer with a scattering of 0 1/m"
                    )
                events.append(name)
                scores.append(
                    np.repeat(1 / scattering[:, np.newaxis], water.value.shape[1], 1)
                )
            elif name == "reflectance":
                if not problem.surface.reflectance > 0:
                    raise ValueError(
                        "the derivative to reflectance needs a target with a "
                        "reflectance above 0"
                    )
                if problem.surface.gloss > 0:
                    raise ValueError(
                        "the derivative to reflectance needs a target without gloss, "
                        f"got a gloss of {problem.surface.gloss:g}"
                    )
            elif name == "range" or name in _RECEIVER:
                _refuse_receiver(problem, name)
            elif name != "absorption":
                raise ValueError(
                    f"derivatives must be {', '.join(_PARAMETERS)} or a "
                    f"PhaseFunctionChange, got {name!r}"
                )
        distance = _range_of(problem) if "range" in names else None
        if distance is not None and "scattering" not in events:
            events.append("scattering")
            inverse = 1 / distance.scattering if distance.scattering > 0 else 0.0
            scores.append(np.full((1, water.value.shape[1]), inverse))
        if any(name == "range" or name in _RECEIVER for name in names):
            events += _RECEIVER
            nothing = np.zeros((water.albedo.size, water.value.shape[1]))
            scores += [nothing] * len(_RECEIVER)
        shape = (len(events), *water.albedo.shape, water.value.shape[1])
        return cls(
            names=names,
            events=tuple(events),
            score=np.array(scores, dtype=np.float64).reshape(shape),
            radius=problem.face.radius,
            distance=distance,
        )

    @property
    def moved(self) -> bool:
        """Whether there are scores of the receiver's place, size and tilt."""
        return _RECEIVER[0] in self.events

    @property
    def scores(self) -> tuple[str, ...]:
        """Names of the scores that a run records, in the order of their rows."""
        last = ("reflectance",) if "reflectance" in self.names else ()
        return (*self.events, *last)

    @property
    def lengths(self) -> bool:
        """Whether light times path length is recorded."""
        return not {"absorption", "scattering", "range"}.isdisjoint(self.names)

    @property
    def digest(self) -> str:
        """Text that tells runs with different derivatives apart."""
        return f" {self.names} {digest_of(self.score)}" if self.names else ""

    def rows(self, scored: Complex, length: Complex, wavenumber: Complex) -> Complex:
        """Return the derivatives of water and target, two rows for each parameter.

        scored has two rows for each score, length is light times path length.
        """
        events = {name: scored[2 * k : 2 * k + 2] for k, name in enumerate(self.scores)}
        rows = []
        for name in self.names:
            row = events.get(name, np.zeros_like(length))
            if name in ("absorption", "scattering"):
                row = row - length
            elif name == "receiver_radius":
                row = row / self.radius
            elif name == "range" and self.distance is not None:
                row = self._range(events, length, wavenumber)
            rows.append(row)
        return np.concatenate([*rows, length[:0]])

    def _range(
        self, events: dict[str, Complex], length: Complex, wavenumber: Complex
    ) -> Complex:
        """Return the derivative to the range.

        With N scatterings, light changes by N + (q - c) L with the logarithm of all
        lengths together. Range, place and radius of the receiver are all of them.
        """
        distance = self.distance
        assert distance is not None
        scaled: Complex = distance.scattering * events["scattering"]
        scaled = scaled + (wavenumber - distance.attenuation) * length
        scaled += distance.right * events["receiver_right"]
        scaled += distance.down * events["receiver_down"]
        scaled -= events["receiver_radius"]
        return scaled / distance.range


def _refuse_receiver(problem: Problem, name: str) -> None:
    """Raise a ValueError unless the receiver is Gaussian, without a sharp edge."""
    if not problem.face.gaussian:
        raise ValueError(
            f"the derivative to {name} needs a GaussianReceiver: a sharp edge has no "
            "derivative along a path"
        )


def _range_of(problem: Problem) -> Range:
    """Return the numbers of the derivative to the range; ValueError without one."""
    beam, surface, water = problem.beam, problem.surface, problem.water
    scattering = float((water.albedo * water.attenuation)[0])
    if not (surface.has_plane and problem.medium.unbounded and water.albedo.size == 1):
        raise ValueError(
            "the derivative to range needs a PlaneTarget in water without layers and "
            "bounds"
        )
    above = float(surface.normal @ beam.centre - surface.height)
    distance = above / -float(surface.normal @ beam.axis)
    if beam.radius > 0 or abs(beam.centre[2]) > _LEVEL * distance:
        raise ValueError(
            "the derivative to range needs a beam without width that starts in the "
            f"plane of the receiver's face, got a radius of {beam.radius:g} m, "
            f"{beam.centre[2]:g} m before the face"
        )
    return Range(
        range=distance,
        attenuation=float(water.attenuation[0]),
        scattering=scattering,
        right=float(beam.centre[0]),
        down=float(beam.centre[1]),
    )


def _phase_score(change: PhaseFunctionChange, value: Array, problem: Problem) -> Array:
    """Return the derivative of ln p by layer and angle cell."""
    lower, upper = cells_of(change.lower).value, cells_of(change.upper).value
    slope = (upper - lower) / change.step
    score = np.divide(slope, value, out=np.zeros_like(slope), where=value > 0)
    return np.repeat(score[np.newaxis], problem.water.albedo.size, 0)
