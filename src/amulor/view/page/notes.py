"""Saved views and annotations of browser pages, in a small file beside the data."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from amulor.errors import CubeError
from amulor.io.files import atomic_output

#: Largest file of notes that is read [byte].
_LARGEST = 4_000_000

Name = Annotated[str, Field(max_length=60)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Triple = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Limits = Annotated[list[Finite | None], Field(min_length=3, max_length=3)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Annotation(_Model):
    """Text at a pixel."""

    name: Name
    text: Annotated[str, Field(max_length=2000)]
    channel: Name
    row: Annotated[int, Field(ge=0)]
    column: Annotated[int, Field(ge=0)]


class Camera(_Model):
    """Position and direction of the 3-D view."""

    turn: Finite
    rise: Finite
    distance: Annotated[Finite, Field(gt=0)]
    target: Triple
    orthographic: bool


class Clip(_Model):
    """Limits of the clip box [m]."""

    low: Limits
    high: Limits


class View(_Model):
    """Saved view: map, color limits, camera and clip box."""

    name: Name
    channel: Name
    layer: Name
    limits: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None
    camera: Camera
    clip: Clip | None


class SpaceAnnotation(_Model):
    """Text at a point of a cloud, a mesh or a site."""

    name: Name
    text: Annotated[str, Field(max_length=2000)]
    place: Triple


class SpaceView(_Model):
    """Saved view of a cloud, a mesh or a site."""

    name: Name
    layer: Name
    limits: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None
    camera: Camera
    up: Literal["z", "y", "-y"]
    hidden: Annotated[list[Name], Field(max_length=1000)]


class Content(_Model):
    """Content of a file of notes; the revision counts its changes."""

    revision: Annotated[int, Field(ge=0)] = 0
    annotations: Annotated[list[Annotation], Field(max_length=200)] = []
    views: Annotated[list[View], Field(max_length=50)] = []


class SpaceContent(_Model):
    """Content of a file of notes on a cloud, a mesh or a site."""

    revision: Annotated[int, Field(ge=0)] = 0
    annotations: Annotated[list[SpaceAnnotation], Field(max_length=200)] = []
    views: Annotated[list[SpaceView], Field(max_length=50)] = []


class Notes:
    """Notes on a data file; without a file, they stay in the browser."""

    def __init__(
        self, data: Path | None, kind: type[Content] | type[SpaceContent] = Content
    ) -> None:
        self._path = None if data is None else data.with_name(f"{data.name}.notes.json")
        self._kind = kind
        self._lock = threading.Lock()

    def read(self) -> dict[str, Any]:
        """Read the notes, with the name of their file."""
        content = self._kind() if self._path is None else self._content(self._path)
        name = None if self._path is None else self._path.name
        return {**content.model_dump(), "file": name}

    def _content(self, path: Path) -> Content | SpaceContent:
        if not path.exists():
            return self._kind()
        try:
            if path.stat().st_size > _LARGEST:
                raise CubeError(f"{path.name} is too large for notes; move it away")
            return self._kind.model_validate_json(path.read_bytes())
        except (ValidationError, OSError) as error:
            raise CubeError(
                f"{path.name} beside the data cannot be read as notes; move it away"
            ) from error

    def write(self, request: dict[str, Any]) -> dict[str, Any]:
        """Write changed notes; refuse a change of an older revision."""
        if self._path is None:
            raise CubeError("there is no data file beside which notes can be kept")
        try:
            content = self._kind.model_validate(request)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"])
            raise CubeError(f"notes: {place[:80]}: {first['msg']}") from None
        with self._lock:
            if content.revision != self._content(self._path).revision:
                raise CubeError(
                    "these notes were changed in another window; reload the page"
                )
            changed = content.model_copy(update={"revision": content.revision + 1})
            with atomic_output(self._path, overwrite=True) as temporary:
                temporary.write_text(
                    json.dumps(changed.model_dump(), indent=1), encoding="utf-8"
                )
        return {"revision": changed.revision}
