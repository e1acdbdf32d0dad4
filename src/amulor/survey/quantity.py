"""Field types of survey files: text with a unit that becomes an SI float."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    ValidationInfo,
    WithJsonSchema,
)
from pydantic_core import CoreSchema

from amulor import units


class Description(BaseModel):
    """Base class of all survey sections, which are frozen and refuse unknown fields."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        use_attribute_docstrings=True,
        str_strip_whitespace=True,
    )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Return the JSON Schema for editors, without Python examples."""
        schema = handler(core_schema)
        resolved = handler.resolve_ref_schema(schema)
        if "description" in resolved:
            resolved["description"] = resolved["description"].split("\n\nExamples\n")[0]
        return schema

    def model_copy(
        self, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> Self:
        """Return a copy with changed fields, validated again."""
        copy = super().model_copy(deep=deep)
        if not update:
            return copy
        fields = {name: getattr(copy, name) for name in copy.model_fields_set}
        return type(self).model_validate({**fields, **update})


#: Largest value of a number in a file, unless a field has a smaller limit. Larger
#: numbers have a wrong digit or unit [SI]. A limit in volts may state "never" by a
#: large number.
_LARGEST = {"angle": 1e4, "voltage": 1e30}
_LARGEST_OTHER = 1e16
_LARGEST_COUNT = 2**53


def _read(quantity: str) -> Any:
    def read(value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, str):
            number = units.parse(value, quantity)
            largest = _LARGEST.get(quantity, _LARGEST_OTHER)
            if abs(number) > largest:
                raise ValueError(
                    f"found {value!r}; no {quantity} is beyond "
                    f"{units.write(largest, quantity)}"
                )
            return number
        from_text = bool(info.context and info.context.get("from_text"))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(
                f"found {value!r}; needed is the {quantity} as text such as "
                f'"{units.example(quantity)}"'
            )
        if from_text and quantity != "fraction":
            raise ValueError(
                f"found {value!r}, a number without a unit; needed is the {quantity} "
                f'as text such as "{units.example(quantity)}"'
            )
        return float(value)

    return BeforeValidator(read)


def _schema(quantity: str) -> WithJsonSchema:
    text = {
        "type": "string",
        "description": f"{quantity}, a number with a unit",
        "examples": [units.example(quantity)],
    }
    if quantity == "fraction":
        return WithJsonSchema({"anyOf": [text, {"type": "number"}]})
    return WithJsonSchema(text)


def _write(quantity: str) -> PlainSerializer:
    return PlainSerializer(
        lambda value: units.write(value, quantity),
        return_type=str,
        when_used="json-unless-none",
    )


_finite = Field(allow_inf_nan=False)

Length = Annotated[float, _read("length"), _finite, _write("length"), _schema("length")]
Wavelength = Annotated[
    float, _read("wavelength"), _finite, _write("wavelength"), _schema("wavelength")
]
Angle = Annotated[float, _read("angle"), _finite, _write("angle"), _schema("angle")]
Frequency = Annotated[
    float, _read("frequency"), _finite, _write("frequency"), _schema("frequency")
]
Time = Annotated[float, _read("time"), _finite, _write("time"), _schema("time")]
Speed = Annotated[float, _read("speed"), _finite, _write("speed"), _schema("speed")]
Power = Annotated[float, _read("power"), _finite, _write("power"), _schema("power")]
Voltage = Annotated[
    float, _read("voltage"), _finite, _write("voltage"), _schema("voltage")
]
Temperature = Annotated[
    float,
    _read("temperature"),
    _finite,
    _write("temperature"),
    _schema("temperature"),
]
PerMetre = Annotated[
    float,
    _read("attenuation coefficient"),
    _finite,
    _write("attenuation coefficient"),
    _schema("attenuation coefficient"),
]
PerSteradian = Annotated[
    float,
    _read("solid-angle density"),
    _finite,
    _write("solid-angle density"),
    _schema("solid-angle density"),
]
AngleSquared = Annotated[
    float,
    _read("angle squared"),
    _finite,
    _write("angle squared"),
    _schema("angle squared"),
]
MassConcentration = Annotated[
    float,
    _read("mass concentration"),
    _finite,
    _write("mass concentration"),
    _schema("mass concentration"),
]
SpectralRadiance = Annotated[
    float,
    _read("spectral radiance"),
    _finite,
    _write("spectral radiance"),
    _schema("spectral radiance"),
]
Fraction = Annotated[float, _read("fraction"), _finite, _schema("fraction")]


def _whole_number(value: Any) -> Any:
    """Return a value; ValueError for true, false and integers that are too large."""
    if isinstance(value, bool):
        raise ValueError(f"found {str(value).lower()}; needed is a whole number")
    if isinstance(value, int) and abs(value) > _LARGEST_COUNT:
        raise ValueError(f"found {value:.3g}; nothing is counted so far")
    return value


Count = Annotated[int, BeforeValidator(_whole_number)]

#: Coordinates: no reference system has larger ones [m].
_Coordinate = Annotated[Length, Field(ge=-1e9, le=1e9)]
Position = tuple[_Coordinate, _Coordinate, _Coordinate]
Rotation = tuple[Angle, Angle, Angle]
