"""Survey files in TOML: reading, writing, and error messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from amulor.errors import SurveyError
from amulor.survey import files, presets, toml_file
from amulor.survey.calibration import Calibration
from amulor.survey.instrument import Daylight, Instrument
from amulor.survey.limits import beyond
from amulor.survey.platform import Platform
from amulor.survey.quantity import Description
from amulor.survey.scan import Pose, Scan
from amulor.survey.target import Target
from amulor.survey.waters.named import WaterStated

_SIZE_LIMIT = 1_000_000


class Survey(Description):
    """Water, targets, instrument and scan of a measurement.

    Examples
    --------
    >>> from amulor.survey import Survey
    >>> survey = Survey.preset("amulor-2010")
    >>> survey.instrument.modulation_frequencies, survey.scan.columns
    ((39000000.0,), 40)
    >>> Survey.from_text(survey.to_toml()).name
    'AMULOR 2010, plate in the small tank'
    """

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """Title of the survey and of all its products."""
    water: WaterStated
    """Water of the survey."""
    targets: tuple[Target, ...] = ()
    """Objects in the water. A beam that hits no object measures water only."""
    instrument: Instrument
    """Instrument of the survey."""
    scan: Scan
    """Scan of the survey."""
    calibration: Calibration | None = None
    """Uncertainties of delay, geometry and refractive index; unknown by default."""
    daylight: Daylight | None = None
    """Daylight in the water; no daylight by default."""
    pose: Pose | None = None
    """Position and attitude of the instrument; unknown by default."""
    platform: Platform | None = None
    """Vehicle that carries the instrument during the scan; none by default. The targets
    are in the axes of an instrument at `pose`, or at the origin looking north."""

    @model_validator(mode="after")
    def _readings_at_once_share_the_light(self) -> Self:
        if self.platform is None or self.platform.readings != "at-once":
            return self
        depth = self.instrument.modulation_depth
        count = len(self.instrument.modulation_frequencies)
        if count > 1 and depth * count > 1 + 1e-9:
            raise ValueError(
                f"{count} frequencies at once, each with a modulation depth of "
                f"{depth:g}, would modulate {depth * count:.3g} of the light; lower "
                f"instrument.modulation_depth to {1 / count:.3g} or less, or state "
                'platform.readings = "in-turn"'
            )
        return self

    @model_validator(mode="after")
    def _dwell_lets_the_lock_in_settle(self) -> Self:
        tau = self.instrument.lock_in.time_constant
        if self.scan.dwell < 5 * tau:
            raise ValueError(
                f"scan.dwell ({self.scan.dwell:g} s) is shorter than five time "
                f"constants of the lock-in ({5 * tau:g} s), so that each pixel would "
                "still hold the one before; lengthen dwell or shorten time_constant"
            )
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a survey file.

        Parameters
        ----------
        path : str or pathlib.Path
            Survey file (TOML). Files named in it are relative to its folder.

        Returns
        -------
        Survey
            The survey, in SI units.

        Raises
        ------
        SurveyError
            If the file is invalid. The message has one line per error: file, field,
            value found and values allowed.
        """
        path = Path(path)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise SurveyError(
                f"{path}: cannot be read ({error.strerror}); check the name"
            ) from None
        if len(content) > _SIZE_LIMIT:
            raise SurveyError(
                f"{path}: has {len(content)} bytes, more than any survey file; a "
                "survey is a TOML text of a few kilobytes"
            )
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise SurveyError(
                f"{path}: is no text; a survey is a TOML file in UTF-8"
            ) from None
        survey = cls.from_text(text, name=str(path), folder=path.parent)
        slips = list(beyond(survey.model_dump(mode="python", exclude_none=True)))
        if slips:
            raise SurveyError(
                "\n".join(f"{path}: {field}: {message}" for field, message in slips)
            )
        return survey

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return the survey of a published instrument that comes with amulor.

        Parameters
        ----------
        name : str
            Name of the preset, such as "amulor-2010"; `amulor survey presets` lists
            all.

        Returns
        -------
        Survey
            Survey with the instrument of the source, and with water, target and scan as
            the source states or suggests.

        Raises
        ------
        SurveyError
            If there is no preset of this name.

        Examples
        --------
        >>> from amulor.survey import Survey
        >>> Survey.preset("amulor-2010").instrument.modulation_frequencies
        (39000000.0,)
        """
        return cls.from_text(presets.preset(name).text, name=name)

    @classmethod
    def from_text(
        cls, text: str, *, name: str = "survey", folder: Path | None = None
    ) -> Self:
        """Read a survey from the text of its file.

        Parameters
        ----------
        text : str
            Content of a survey file (TOML).
        name : str
            Name of the survey in messages.
        folder : pathlib.Path, optional
            Folder of files that the survey names; by default the working folder.

        Returns
        -------
        Survey
            The survey, in SI units.

        Raises
        ------
        SurveyError
            As `from_toml`.
        """
        survey = toml_file.described(
            text, cls, name=name, what="a survey", error=SurveyError
        )
        return files.settled(survey, folder or Path(), where=name)

    def with_(self, changes: Mapping[str, Any]) -> Self:
        """Return the survey with changed fields; they are validated as in a file.

        Parameters
        ----------
        changes : mapping of str to object
            New values by field path. A value is a number in SI units, a text with a
            unit as in a file, a table, a list, or a description such as `Water`. Paths
            number the items of lists from 0; None removes an optional field.

        Returns
        -------
        Survey
            New survey.

        Raises
        ------
        SurveyError
            If a new value is invalid. The message has one line per error: field, value
            found and values allowed.

        Examples
        --------
        >>> clear = amulor.Survey.from_toml("plate.toml")  # doctest: +SKIP
        >>> turbid = clear.with_(
        ...     {"water.scattering": "2 1/m", "scan.columns": 40}
        ... )  # doctest: +SKIP
        """
        before = self.model_dump(exclude_none=True)
        replaced = {
            other: None
            for name, value in changes.items()
            for other in _ALTERNATIVES.get(name, ())
            if value is not None and self.calibration is not None
            if getattr(self.calibration, other.partition(".")[2]) is not None
        }
        changes = {**replaced, **changes}
        content = _without_none(changed(before, changes, name="survey"))
        try:
            survey = type(self).model_validate(content)
        except ValidationError as error:
            lines = toml_file.lines(error, content, model=type(self), name="survey")
            raise SurveyError("\n".join(lines)) from None
        return files.settled(survey, Path(), where="survey")

    def to_toml(self) -> str:
        """Return the survey as TOML text, each quantity with its SI unit.

        Returns
        -------
        str
            Text that `from_text` converts back to an equal survey.
        """
        import tomli_w

        content = self.model_dump(mode="json", exclude_none=True)
        return tomli_w.dumps(content)


#: Statements that `with_` removes if a change states another one of the same quantity.
_ALTERNATIVES = {
    "calibration.group_index_uncertainty": (
        "calibration.temperature_uncertainty",
        "calibration.salinity_uncertainty",
    ),
    "calibration.temperature_uncertainty": ("calibration.group_index_uncertainty",),
    "calibration.salinity_uncertainty": ("calibration.group_index_uncertainty",),
}


def _without_none(content: Any) -> Any:
    """Return content without None fields, which validation then reports as missing."""
    if isinstance(content, dict):
        return {
            key: _without_none(item)
            for key, item in content.items()
            if item is not None
        }
    if isinstance(content, list):
        return [_without_none(item) for item in content]
    return content


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of survey files, for editors that check while typing.

    Returns
    -------
    dict
        JSON Schema, draft 2020-12.

    Examples
    --------
    >>> from amulor.survey import json_schema
    >>> schema = json_schema()
    >>> schema["title"], "water" in schema["required"]
    ('amulor survey', True)
    """
    schema = Survey.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "amulor survey",
    }


def changed(content: Any, changes: Mapping[str, Any], *, name: str) -> Any:
    """Return the content of a survey file with some values changed.

    Examples
    --------
    >>> changed({"water": {"salinity": 0}}, {"water.salinity": 35}, name="survey")
    {'water': {'salinity': 35}}
    """
    result = _plain(content)
    for path in changes:
        for nested in changes:
            if nested.startswith(f"{path}."):
                raise SurveyError(
                    f"{name}: {nested}: is a part of {path}, which is changed as well; "
                    f"state it in the new {path}"
                )
    for path, value in changes.items():
        *parents, last = path.split(".")
        table = result
        for depth, part in enumerate(parents, start=1):
            table = _at(table, part, path=".".join(parents[:depth]), name=name)
            if not isinstance(table, dict | list):
                missing = "is not there" if table is None else "is no table"
                raise SurveyError(
                    f"{name}: {path}: cannot be changed, since "
                    f"{'.'.join(parents[:depth])} {missing}; state it as a whole"
                )
        if isinstance(table, list):
            _at(table, last, path=path, name=name)
            table[int(last)] = _plain(value)
        else:
            table[last] = _plain(value)
    return result


def _at(table: Any, part: str, *, path: str, name: str) -> Any:
    """Return the entry of a table or list for one element of a path."""
    if isinstance(table, dict):
        return table.get(part)
    if not part.isdigit() or int(part) >= len(table):
        raise SurveyError(
            f"{name}: {path}: found {part!r}, but it must be the number of an item, "
            f"from 0 to {len(table) - 1}"
        )
    return table[int(part)]


def _plain(value: Any) -> Any:
    """Return tables and lists as plain dictionaries and lists."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    dump = getattr(value, "model_dump", None)
    return value if dump is None else _plain(dump(exclude_none=True))
