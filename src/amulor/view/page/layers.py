"""Maps of the browser page: names, descriptions and binary encoding."""

from __future__ import annotations

import base64
import zlib
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from amulor.cube import UNUSABLE, QualityFlag, schema
from amulor.cube.schema import ALIKE_TERMS, RANGE_PREFIX, WATER_TERMS


@dataclass(frozen=True, kw_only=True)
class Layer:
    """Map on the browser page, with one value for each pixel of a scan."""

    name: str
    """Name in URLs."""
    label: str
    """Label on the page."""
    unit: str
    """Unit of the encoded values."""
    kind: Literal["range", "amplitude", "error", "signed", "chance", "flags", "hidden"]
    """Kind of color scale."""
    before: bool = False
    """Whether the map shows the range image before water rejection."""

    @property
    def is_error(self) -> bool:
        """Whether the map shows the range uncertainty or one of its components."""
        return self.kind == "error" or self.name.startswith(("common", "term_"))


#: Variables of a range image and the layers that they become.
MAPS = {
    "slant_range": Layer(name="range", label="Range", unit="m", kind="range"),
    "intensity": Layer(name="amplitude", label="Amplitude", unit="V", kind="amplitude"),
    "slant_range_uncertainty": Layer(
        name="uncertainty", label="Uncertainty", unit="m", kind="error"
    ),
    "slant_range_bias": Layer(name="bias", label="Bias", unit="m", kind="signed"),
    "quality_flag": Layer(name="flags", label="Flags", unit="", kind="flags"),
    "slant_range_wrong_interval": Layer(
        name="wrong", label="Wrong interval", unit="1", kind="chance"
    ),
    "deviation": Layer(name="deviation", label="Deviation", unit="m", kind="signed"),
    "deviation_significant": Layer(
        name="significant", label="Significant", unit="m", kind="signed"
    ),
    "deviation_uncertainty": Layer(
        name="deviation_uncertainty", label="Deviation ±", unit="m", kind="error"
    ),
    "time": Layer(name="time", label="Time", unit="s", kind="hidden"),
    "slant_range_common_uncertainty": Layer(
        name="common", label="Shared uncertainty", unit="m", kind="hidden"
    ),
    **{
        f"{RANGE_PREFIX}{term}": Layer(
            name=f"term_{term}", label=term.replace("_", " "), unit="m", kind="hidden"
        )
        for term in (*ALIKE_TERMS, *WATER_TERMS)
    },
}
#: Steps of the surface to the next pixel, which averages do not cross.
STEPS = Layer(name="steps", label="Steps", unit="1", kind="hidden")
#: Maps that are available before rejection, too.
BEFORE = ("slant_range", "intensity", "quality_flag", "slant_range_uncertainty")


def flag_words() -> list[dict[str, Any]]:
    """Quality flags with bit, name and description."""
    words = schema.flag_words()["pixel"]
    return [
        {
            "mask": int(flag),
            "name": str(flag.name).lower().replace("_", " "),
            "words": words[str(flag.name)]["short"],
            "unusable": bool(flag & UNUSABLE),
        }
        for flag in QualityFlag
        if flag
    ]


def described(layer: Layer) -> dict[str, Any]:
    """Properties of a map that the browser page needs."""
    return asdict(layer)


def stored(values: np.ndarray, layer: Layer) -> bytes:
    """Values of a map as little-endian bytes: flags with 16 bits, others with 32."""
    form = "<u2" if layer.kind == "flags" else "<f4"
    return np.ascontiguousarray(values).astype(form).tobytes()


#: Fast level: after sorting of the bytes the remainder is noise, which no level
#: compresses.
_LEVEL = 4


def packed(content: bytes, *, width: int) -> str:
    """Binary values of `width` bytes, compressed and encoded as base64 text."""
    sorted_bytes = np.frombuffer(content, np.uint8).reshape(-1, width).T.tobytes()
    return base64.b64encode(zlib.compress(sorted_bytes, _LEVEL)).decode()


def unpacked(text: str, *, width: int) -> bytes:
    """Binary values decoded from base64 text that `packed` encoded."""
    content = zlib.decompress(base64.b64decode(text))
    return np.frombuffer(content, np.uint8).reshape(width, -1).T.tobytes()
