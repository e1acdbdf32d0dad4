"""Phase functions in surveys: by name and parameters, or as a table."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from amulor.errors import SurveyError
from amulor.optics.phase_functions import mixture, models, tables
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.survey import files
from amulor.survey.quantity import Angle, Description, Fraction

_Asymmetry = Annotated[float, Field(ge=-0.9999, le=0.999999)]


class HenyeyGreenstein(Description):
    """Henyey-Greenstein phase function, with one asymmetry parameter.

    Examples
    --------
    >>> from amulor.survey import HenyeyGreenstein, Survey, water_properties
    >>> stated = HenyeyGreenstein(kind="henyey-greenstein", asymmetry=0.9)
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.9, 0.0229)
    """

    kind: Literal["henyey-greenstein"]
    """Kind of phase function."""
    asymmetry: _Asymmetry
    """Mean cosine g of the scattering angle [1]."""

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        return models.henyey_greenstein_function(asymmetry=self.asymmetry)


class TwoTerm(Description):
    """Sum of two Henyey-Greenstein terms, usually a forward and a backward term.

    Examples
    --------
    >>> from amulor.survey import TwoTerm, Survey, water_properties
    >>> stated = TwoTerm(
    ...     kind="two-term",
    ...     forward_asymmetry=0.95,
    ...     backward_asymmetry=-0.5,
    ...     forward_weight=0.97,
    ... )
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.906, 0.0354)
    """

    kind: Literal["two-term"]
    """Kind of phase function."""
    forward_asymmetry: _Asymmetry
    """Mean cosine of the scattering angle of the first term [1]."""
    backward_asymmetry: _Asymmetry
    """Mean cosine of the second term, usually negative [1]."""
    forward_weight: Annotated[Fraction, Field(ge=0, le=1)]
    """Weight of the first term, from 0 to 1 [1]."""

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        return models.two_term(
            forward_asymmetry=self.forward_asymmetry,
            backward_asymmetry=self.backward_asymmetry,
            forward_weight=self.forward_weight,
        )


class FournierForand(Description):
    """Fournier-Forand phase function of marine particles.

    Examples
    --------
    >>> from amulor.survey import FournierForand, Survey, water_properties
    >>> stated = FournierForand(
    ...     kind="fournier-forand", backscatter_fraction="1.83 %"
    ... )
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.93, 0.0183)
    """

    kind: Literal["fournier-forand"]
    """Kind of phase function."""
    relative_index: Annotated[float, Field(gt=1, le=1.5)] | None = None
    """Refractive index of the particles, relative to the water [1]."""
    slope: Annotated[float, Field(gt=3, lt=5)] | None = None
    """Exponent of the hyperbolic size distribution [1]."""
    backscatter_fraction: Annotated[Fraction, Field(ge=3e-4, le=0.2)] | None = None
    """Backscattering fraction, instead of index and slope [1]. Index and slope then
    follow from the relation of Mobley et al. 2002."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        pair = (self.relative_index is None, self.slope is None)
        if any(pair) != all(pair) or all(pair) == (self.backscatter_fraction is None):
            raise ValueError(
                "a Fournier-Forand phase function needs relative_index and slope, or "
                "backscatter_fraction in their place"
            )
        return self

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        if self.relative_index is None or self.slope is None:
            assert self.backscatter_fraction is not None
            return mixture.fournier_forand_with_backscatter(self.backscatter_fraction)
        return models.fournier_forand(
            relative_index=self.relative_index, slope=self.slope
        )


class Petzold(Description):
    """Phase function of natural water, measured by Petzold in 1972.

    Examples
    --------
    >>> from amulor.survey import Petzold, Survey, water_properties
    >>> stated = Petzold(kind="petzold", station="average_particle")
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.924, 0.0181)
    """

    kind: Literal["petzold"]
    """Kind of phase function."""
    station: Literal[
        "average_particle",
        "AUTEC 7",
        "AUTEC 8",
        "AUTEC 9",
        "HAOCE 5",
        "HAOCE 11",
        "NUC 2200",
        "NUC 2040",
        "NUC 2240",
    ]
    """Station: clear ocean (AUTEC), coast (HAOCE), San Diego Harbor (NUC), or the
    average particle of Mobley et al. 1993, without scattering by water molecules."""

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        return tables.petzold(self.station)


class Rayleigh(Description):
    """Phase function of water molecules, for water without particles.

    Examples
    --------
    >>> from amulor.survey import Rayleigh, Survey, water_properties
    >>> stated = Rayleigh(kind="rayleigh")
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.0, 0.5)
    """

    kind: Literal["rayleigh"]
    """Kind of phase function."""
    depolarization: Annotated[Fraction, Field(ge=0, le=1)] = 0.039
    """Depolarization ratio at 90 degrees; water has 0.039 [1]."""

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        return models.rayleigh_phase(depolarization=self.depolarization)


class Tabulated(Description):
    """Phase function or volume scattering function, tabulated by the user.

    Examples
    --------
    >>> from amulor.survey import Tabulated, Survey, water_properties
    >>> stated = Tabulated(
    ...     kind="tabulated",
    ...     angles=("0.1 deg", "10 deg", "90 deg", "180 deg"),
    ...     values=(100, 1, 0.02, 0.02),
    ... )
    >>> survey = Survey.preset("amulor-2010").with_(
    ...     {"water.phase_function": stated}
    ... )
    >>> function = water_properties(survey).phase_function
    >>> round(function.asymmetry, 3), round(function.backscatter_fraction, 4)
    (0.611, 0.1563)
    """

    kind: Literal["tabulated"]
    """Kind of phase function."""
    file: Path | None = None
    """Text file with two columns: angle in degrees, up to 180, and value in 1/sr.
    Columns are separated by commas or spaces, and # begins a comment. The path is
    relative to the survey file. amulor reads the table with the survey and stores it in
    the survey."""
    angles: tuple[Angle, ...] | None = None
    """Scattering angles, increasing to 180 degrees, instead of a file."""
    values: tuple[float, ...] | None = None
    """Values at the angles; amulor normalizes them [1/sr]."""

    @model_validator(mode="after")
    def _is_one_table(self) -> Self:
        inline = (self.angles is None, self.values is None)
        if any(inline) != all(inline) or all(inline) == (self.file is None):
            raise ValueError(
                "a tabulated phase function needs a file, or angles and values"
            )
        if self.angles is not None and self.values is not None:
            if len(self.angles) != len(self.values):
                raise ValueError(
                    f"found {len(self.angles)} angles and {len(self.values)} values; "
                    "there must be one value for each angle"
                )
            self.function()
        return self

    def settled(self, folder: Path, *, where: str) -> Self:
        """Return a copy that contains the table read from its file."""
        if self.file is None:
            return self
        columns = files.columns(folder / self.file, count=2, where=where)
        angles = (f"{angle!r} deg" for angle in columns[0])
        content: dict[str, Any] = {
            "kind": self.kind,
            "angles": tuple(angles),
            "values": tuple(columns[1]),
        }
        return files.validated(type(self), content, where=where)

    def function(self) -> PhaseFunction:
        """Return the phase function."""
        if self.angles is None or self.values is None:
            raise SurveyError(
                "phase_function.file: has not been read; make the survey with "
                "Survey.from_toml or Survey.from_text, or state angles and values"
            )
        return tables.tabulated(
            self.angles, value=self.values, name="tabulated in the survey"
        )


PhaseFunctionStated = Annotated[
    HenyeyGreenstein | TwoTerm | FournierForand | Petzold | Rayleigh | Tabulated,
    Field(discriminator="kind"),
]


@lru_cache(maxsize=64)
def phase_function(description: PhaseFunctionStated) -> PhaseFunction:
    """Return the phase function that a survey describes; cached."""
    return description.function()
