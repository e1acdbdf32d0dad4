"""The page's server: its routes and answers."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from collections.abc import Awaitable, Callable, Collection
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from amulor.errors import AmulorError, CubeError, SurveyError
from amulor.view.design.explorer import Explorer
from amulor.view.page.layers import stored
from amulor.view.page.live import POLL, Live, Rows
from amulor.view.page.measuring import Made, Products, measured
from amulor.view.page.recording import Recording, spectrum
from amulor.view.page.saved import TYPES, saved_page, saved_space, static_files
from amulor.view.page.security import Guard
from amulor.view.page.space import Space

#: Measurements that a saved page may begin with [1].
_MOST_MEASUREMENTS = 500


class Files:
    """Answers with the files of the page, and with no other."""

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


async def follow(live: Live, socket: WebSocket) -> None:
    """Send a page what is new in a scan until the page is gone."""
    live.start()
    gone = asyncio.create_task(_until_gone(socket))
    sent_picture, sent_version = live.pictures, 0
    sent_status: dict[str, Any] | None = None
    try:
        while not gone.done():
            picture, status, rows = live.snapshot(sent_version)
            if picture != sent_picture:
                await socket.send_text(json.dumps({"type": "picture"}))
                sent_picture = picture
            if rows:
                for one in rows:
                    await socket.send_bytes(message_of(one))
                sent_version = rows[-1].version
            if status and status != sent_status:
                await socket.send_text(json.dumps({"type": "status", **status}))
                sent_status = status
            await asyncio.wait({gone}, timeout=POLL)
    finally:
        gone.cancel()


async def _until_gone(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_text()


def message_of(rows: Rows) -> bytes:
    """Return a row as it travels: length of a JSON head, head, numbers of 32 bits."""
    head = json.dumps(
        {
            "type": "rows",
            "channel": rows.channel,
            "row": rows.row,
            "layers": list(rows.layers),
        }
    ).encode()
    head += b" " * (-len(head) % 4)
    numbers = [np.asarray(values, "<f4").tobytes() for values in rows.layers.values()]
    return struct.pack("<I", len(head)) + head + b"".join(numbers)


def design_routes(shown: Explorer) -> list[Any]:
    """Return what is answered of a design."""
    files = Files("design.html")

    async def scene(request: Request) -> Response:
        return await answered(lambda: JSONResponse(shown.describe()))

    async def dragged(request: Request) -> tuple[dict[str, Any], str]:
        wanted = await object_of(request)
        settings, water = wanted.get("settings", {}), wanted.get("water", "own")
        if not isinstance(settings, dict) or not isinstance(water, str):
            raise SurveyError("settings must be an object, and water a name")
        return settings, water

    async def errors(request: Request) -> Response:
        async def made() -> Response:
            settings, water = await dragged(request)
            found = await run_in_threadpool(shown.map, settings, water=water)
            return JSONResponse(found)

        return await explained(made())

    async def met(request: Request) -> Response:
        async def made() -> Response:
            settings, water = await dragged(request)
            found = await run_in_threadpool(shown.met, settings, water=water)
            return JSONResponse(found)

        return await explained(made())

    async def survey(request: Request) -> Response:
        async def made() -> Response:
            settings, water = await dragged(request)
            text = await run_in_threadpool(shown.as_survey, settings, water=water)
            return numbers(text.encode())

        return await explained(made())

    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", scene),
        Route("/map", errors, methods=["POST"]),
        Route("/met", met, methods=["POST"]),
        Route("/survey", survey, methods=["POST"]),
    ]


def space_routes(space: Space) -> list[Any]:
    """Return what is answered of a cloud or a mesh."""
    files = Files("space.html")

    async def scene(request: Request) -> Response:
        return await answered(lambda: JSONResponse(space.describe()))

    async def layer(request: Request) -> Response:
        name = request.path_params["name"]
        return await answered(lambda: numbers(space.values(name)))

    async def save(request: Request) -> Response:
        async def made() -> Response:
            kept = await measurements_of(request)
            page = await run_in_threadpool(saved_space, space, measurements=kept)
            return numbers(page.encode())

        return await explained(made())

    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", scene),
        Route("/layer/space/{name}", layer),
        Route("/save", save, methods=["POST"]),
    ]


def application(
    shown: Recording | Live | Space | Explorer,
    *,
    token: str,
    hosts: Collection[str] = (),
    beyond: bool = False,
    products: Products | None = None,
) -> ASGIApp:
    """Return the page of a file, a scan or a design as an ASGI application."""
    if isinstance(shown, Space):
        routes = space_routes(shown)
    elif isinstance(shown, Explorer):
        routes = design_routes(shown)
    else:
        routes = _routes(shown, products)
    inner = Starlette(routes=routes)
    return Guard(inner, token=token, hosts=hosts, beyond=beyond)


def _routes(shown: Recording | Live, products: Products | None) -> list[Any]:
    """Return what is answered of a picture or a scan."""
    pages, files = _Pages(shown, products), Files("index.html")
    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", pages.scene),
        Route("/layer/{channel}/{name}", pages.layer),
        Route("/spectrum/{channel}/{row:int}/{column:int}", pages.spectrum),
        Route("/measure", pages.measure, methods=["POST"]),
        Route("/save", pages.save, methods=["POST"]),
        Route("/products", pages.products),
        Route("/product", pages.product, methods=["POST"]),
        WebSocketRoute("/live", pages.live),
    ]


class _Pages:
    def __init__(self, shown: Recording | Live, products: Products | None) -> None:
        self._shown, self._products = shown, products

    @property
    def _recording(self) -> Recording:
        return self._shown.recording if isinstance(self._shown, Live) else self._shown

    async def scene(self, request: Request) -> Response:
        channel = request.query_params.get("channel")

        def made() -> Response:
            return JSONResponse(
                {
                    **self._recording.describe(channel),
                    "live": isinstance(self._shown, Live),
                }
            )

        return await answered(made)

    async def layer(self, request: Request) -> Response:
        channel, name = (request.path_params[key] for key in ("channel", "name"))

        def made() -> Response:
            recording = self._recording
            if name == "beams":
                values = recording.nodes(channel).values
                return numbers(np.ascontiguousarray(values, "<f4").tobytes())
            known = recording.layers(channel)
            if name not in known:
                raise CubeError(f"there is no map {name[:40]!r}")
            stride = recording.stride(channel)
            values = recording.layer(channel, name, stride)
            return numbers(stored(values, known[name][0]))

        return await answered(made)

    async def spectrum(self, request: Request) -> Response:
        place = request.path_params

        def made() -> Response:
            recording = self._recording
            rows, columns = recording.channel(place["channel"]).shown.shape
            if not (place["row"] < rows and place["column"] < columns):
                raise CubeError("this pixel is outside of the scan")
            at = (place["row"], place["column"])
            found = spectrum(recording.cubes, place["channel"], *at)
            return JSONResponse(found)

        return await answered(made)

    async def measure(self, request: Request) -> Response:
        async def made() -> Response:
            wanted = await object_of(request)
            found = await run_in_threadpool(measured, self._recording, wanted)
            return JSONResponse(found)

        return await explained(made())

    async def save(self, request: Request) -> Response:
        async def made() -> Response:
            kept = await measurements_of(request)
            page = await run_in_threadpool(
                saved_page, self._recording, measurements=kept
            )
            return Response(page.encode(), media_type="application/octet-stream")

        return await explained(made())

    async def products(self, request: Request) -> Response:
        offered = [] if self._products is None else self._products.offered()
        return JSONResponse(offered)

    async def product(self, request: Request) -> Response:
        async def made() -> Response:
            wanted = await object_of(request)
            return downloaded(await run_in_threadpool(self._product, wanted))

        return await explained(made())

    def _product(self, wanted: dict[str, Any]) -> Made:
        if self._products is None:
            raise CubeError("this server makes no products")
        recording = self._recording
        channel = str(wanted.get("channel", recording.channels[0]))
        image = recording.channel(channel).shown.whole()
        stem = recording.name.rpartition(".")[0] or recording.name
        if len(recording.channels) > 1:
            stem = f"{stem}-{channel}"
        return self._products.make(image, wanted, stem=stem)

    async def live(self, socket: WebSocket) -> None:
        if not isinstance(self._shown, Live):
            await socket.close(1008, "this is no running scan")
            return
        await socket.accept()
        try:
            await follow(self._shown, socket)
        except WebSocketDisconnect:
            return
