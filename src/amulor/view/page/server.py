"""The page's server: what it answers, to whom, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from amulor.errors import AmulorError, CubeError
from amulor.view.page import feed
from amulor.view.page.layers import stored
from amulor.view.page.live import Live
from amulor.view.page.measuring import measured
from amulor.view.page.recording import Recording
from amulor.view.page.saved import TYPES, saved_page, static_files
from amulor.view.page.security import Guard

#: Measurements that a saved page may begin with [1].
_MOST_MEASUREMENTS = 500


def application(
    shown: Recording | Live,
    *,
    token: str,
    hosts: Collection[str] = (),
    beyond: bool = False,
) -> ASGIApp:
    """Return the page of a file or a scan as an ASGI application.

    Parameters
    ----------
    shown : Recording or Live
        What it shows.
    token : str
        First part of every address.
    hosts : collection of str
        Names of this computer besides localhost.
    beyond : bool
        Whether other computers are served, too.

    Returns
    -------
    callable
        Starlette behind a `Guard`. Nothing it answers changes a file or moves a device.
    """
    pages = _Pages(shown)
    routes: list[Any] = [
        Route("/", pages.index),
        Route("/static/{name}", pages.static),
        Route("/scene", pages.scene),
        Route("/layer/{channel}/{name}", pages.layer),
        Route("/spectrum/{channel}/{row:int}/{column:int}", pages.spectrum),
        Route("/measure", pages.measure, methods=["POST"]),
        Route("/save", pages.save, methods=["POST"]),
        WebSocketRoute("/live", pages.live),
    ]
    inner = Starlette(routes=routes)
    return Guard(inner, token=token, hosts=hosts, beyond=beyond)


class _Pages:
    def __init__(self, shown: Recording | Live) -> None:
        self._shown = shown
        self._files = static_files()

    @property
    def _recording(self) -> Recording:
        return self._shown.recording if isinstance(self._shown, Live) else self._shown

    async def index(self, request: Request) -> Response:
        return Response(self._files["index.html"], media_type=TYPES[".html"])

    async def static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self._files:
            return JSONResponse({"error": "no such file"}, status_code=404)
        return Response(self._files[name], media_type=TYPES[Path(name).suffix])

    async def scene(self, request: Request) -> Response:
        channel = request.query_params.get("channel")

        def made() -> Response:
            return JSONResponse(
                {
                    **self._recording.describe(channel),
                    "live": isinstance(self._shown, Live),
                }
            )

        return await _answered(made)

    async def layer(self, request: Request) -> Response:
        channel, name = (request.path_params[key] for key in ("channel", "name"))

        def made() -> Response:
            recording = self._recording
            if name == "beams":
                values = recording.nodes(channel).values
                return _bytes(np.ascontiguousarray(values, "<f4").tobytes())
            known = recording.layers(channel)
            if name not in known:
                raise CubeError(f"there is no map {name[:40]!r}")
            stride = recording.stride(channel)
            values = recording.layer(channel, name, stride)
            return _bytes(stored(values, known[name][0]))

        return await _answered(made)

    async def spectrum(self, request: Request) -> Response:
        place = request.path_params

        def made() -> Response:
            recording = self._recording
            rows, columns = recording.channel(place["channel"]).shown.shape
            if not (place["row"] < rows and place["column"] < columns):
                raise CubeError("this pixel is outside of the scan")
            found = recording.spectrum(place["channel"], place["row"], place["column"])
            return JSONResponse(found)

        return await _answered(made)

    async def measure(self, request: Request) -> Response:
        async def made() -> Response:
            wanted = await _object(request)
            found = await run_in_threadpool(measured, self._recording, wanted)
            return JSONResponse(found)

        return await _explained(made())

    async def save(self, request: Request) -> Response:
        async def made() -> Response:
            kept = (await _object(request)).get("measurements", [])
            if not isinstance(kept, list) or len(kept) > _MOST_MEASUREMENTS:
                raise CubeError(f"at most {_MOST_MEASUREMENTS} measurements are kept")
            page = await run_in_threadpool(
                saved_page,
                self._recording,
                measurements=[one for one in kept if isinstance(one, dict)],
            )
            return Response(page.encode(), media_type="application/octet-stream")

        return await _explained(made())

    async def live(self, socket: WebSocket) -> None:
        if not isinstance(self._shown, Live):
            await socket.close(1008, "this is no running scan")
            return
        await socket.accept()
        try:
            await feed.follow(self._shown, socket)
        except WebSocketDisconnect:
            return


async def _object(request: Request) -> dict[str, Any]:
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


def _bytes(content: bytes) -> Response:
    return Response(content, media_type="application/octet-stream")


async def _answered(made: Callable[[], Response]) -> Response:
    """Return what was made in a thread, or why it could not be, for the page."""
    return await _explained(run_in_threadpool(made))


async def _explained(made: Awaitable[Response]) -> Response:
    """Return what is being made, or why it could not be, in words for the page."""
    try:
        return await made
    except (AmulorError, ValueError) as error:
        return JSONResponse({"error": str(error)}, status_code=422)
