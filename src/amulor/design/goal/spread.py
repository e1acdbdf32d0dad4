"""What is not known for sure: ranges of waters and targets with their distributions."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.survey.quantity import Angle, Description, Fraction, PerMetre

Distribution = Literal["uniform", "log-uniform", "normal", "log-normal"]


class _Spread(Description):
    distribution: Distribution = "uniform"
    """How likely the values between low and high are; of the normal ones 95 % lie
    between them, and none more than twice as far out."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        low: float = getattr(self, "low")  # noqa: B009
        high: float = getattr(self, "high")  # noqa: B009
        if low > high:
            raise ValueError(f"low ({low:g}) must not exceed high ({high:g})")
        if self.distribution.startswith("log") and low <= 0:
            raise ValueError(
                f"a {self.distribution} distribution needs low above 0, found {low:g}"
            )
        return self


class CoefficientSpread(_Spread):
    """A range of an attenuation, absorption or scattering coefficient."""

    low: Annotated[PerMetre, Field(ge=0)]
    """Lower end [1/m]."""
    high: Annotated[PerMetre, Field(gt=0)]
    """Upper end [1/m]."""


class FractionSpread(_Spread):
    """A range of a fraction."""

    low: Annotated[Fraction, Field(ge=0, le=1)]
    """Lower end [1]."""
    high: Annotated[Fraction, Field(ge=0, le=1)]
    """Upper end [1]."""


class AngleSpread(_Spread):
    """A range of an angle."""

    low: Annotated[Angle, Field(ge=0, le=1)]
    """Lower end [rad]."""
    high: Annotated[Angle, Field(ge=0, le=1)]
    """Upper end [rad]."""


#: Any of them.
Spread = CoefficientSpread | FractionSpread | AngleSpread
