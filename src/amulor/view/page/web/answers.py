"""What the page's server says: numbers, or words about why there are none."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from amulor.errors import AmulorError, CubeError
from amulor.view.page.offers import Made
from amulor.view.page.saved import TYPES, static_files

#: Measurements that a saved page may begin with [1].
_MOST_MEASUREMENTS = 500


class Files:
    """Answers with the files of the page, and with no other.

    Parameters
    ----------
    first : str
        The one that the address of the page itself gives.
    """

    def __init__(self, first: str) -> None:
        self._first = first
        self._files = static_files()

    async def index(self, request: Request) -> Response:
        """Answer with the page."""
        return Response(self._files[self._first], media_type=TYPES[".html"])

    async def static(self, request: Request) -> Response:
        """Answer with a file by its name."""
        name = request.path_params["name"]
        if name not in self._files:
            return JSONResponse({"error": "no such file"}, status_code=404)
        return Response(self._files[name], media_type=TYPES[Path(name).suffix])


async def measurements_of(request: Request) -> list[dict[str, Any]]:
    """Return the measurements that a page wants to be saved with it."""
    kept = (await object_of(request)).get("measurements", [])
    if not isinstance(kept, list) or len(kept) > _MOST_MEASUREMENTS:
        raise CubeError(f"at most {_MOST_MEASUREMENTS} measurements are kept")
    return [one for one in kept if isinstance(one, dict)]


async def object_of(request: Request) -> dict[str, Any]:
    """Return the JSON object of a request."""
    try:
        content = json.loads(await request.body())
    except (ValueError, RecursionError):
        raise CubeError("the request is no JSON") from None
    except ClientDisconnect:
        raise CubeError("the request is too long, or was broken off") from None
    if not isinstance(content, dict):
        raise CubeError("the request must be a JSON object")
    return content


def numbers(content: bytes) -> Response:
    """Return bytes as an answer."""
    return Response(content, media_type="application/octet-stream")


def downloaded(made: Made) -> Response:
    """Return a product that the browser keeps as a file, and what it is in a header."""
    name = quote(made.name, safe="")
    return Response(
        made.content,
        media_type="application/octet-stream",
        headers={
            "content-disposition": f"attachment; filename*=UTF-8''{name}",
            "amulor-said": quote(made.said),
        },
    )


async def answered(made: Callable[[], Response]) -> Response:
    """Return what was made in a thread, or why it could not be, for the page."""
    return await explained(run_in_threadpool(made))


async def explained(made: Awaitable[Response]) -> Response:
    """Return what is being made, or why it could not be, in words for the page."""
    try:
        return await made
    except (AmulorError, ValueError) as error:
        return JSONResponse({"error": str(error)}, status_code=422)
