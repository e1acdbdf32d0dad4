"""HTTP server of the browser page: routes, responses, start and stop."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
import threading
from collections.abc import Awaitable, Callable, Collection, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import h11
import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from amulor.errors import AmulorError, CubeError, FormatError, SurveyError
from amulor.view.design.explorer import Explorer
from amulor.view.page.layers import stored
from amulor.view.page.live import POLL, Live, Rows
from amulor.view.page.measuring import Made, Products, measured
from amulor.view.page.notes import Notes, SpaceContent
from amulor.view.page.recording import Recording, spectrum
from amulor.view.page.saved import TYPES, saved_page, saved_space, static_files
from amulor.view.page.security import Guard, new_token
from amulor.view.page.space import Space

#: Largest number of measurements in a saved page [1].
_MOST_MEASUREMENTS = 500
#: Letters in the color limits of all maps of a page [1].
_LONGEST_LIMITS = 2000


class Files:
    """HTTP endpoint for the static files of the page."""

    def __init__(self, first: str) -> None:
        self._first = first
        self._files = static_files()

    async def index(self, request: Request) -> Response:
        """Respond with the HTML page."""
        return Response(self._files[self._first], media_type=TYPES[".html"])

    async def static(self, request: Request) -> Response:
        """Respond with a static file."""
        name = request.path_params["name"]
        if name not in self._files:
            return JSONResponse({"error": "no such file"}, status_code=404)
        return Response(self._files[name], media_type=TYPES[Path(name).suffix])


async def saving(request: Request) -> dict[str, Any]:
    """Measurements and typed color limits in a request to save the page."""
    query = await object_of(request)
    measurements, limits = query.get("measurements", []), query.get("limits", "")
    if not isinstance(measurements, list) or len(measurements) > _MOST_MEASUREMENTS:
        raise CubeError(f"at most {_MOST_MEASUREMENTS} measurements are kept")
    if not isinstance(limits, str) or len(limits) > _LONGEST_LIMITS:
        raise CubeError(f"color limits are text of at most {_LONGEST_LIMITS} letters")
    kept = [
        measurement for measurement in measurements if isinstance(measurement, dict)
    ]
    return {"measurements": kept, "limits": limits}


async def object_of(request: Request) -> dict[str, Any]:
    """JSON object in the body of a request."""
    try:
        content = json.loads(await request.body())
    except (ValueError, RecursionError):
        raise CubeError("the request is no JSON") from None
    except ClientDisconnect:
        raise CubeError("the request is too long, or was broken off") from None
    if not isinstance(content, dict):
        raise CubeError("the request must be a JSON object")
    return content


def box_of(query: dict[str, Any]) -> tuple[list[float], list[float]]:
    """Low and high corner of a box in a request [m]."""
    try:
        corners = np.array([query.get("low"), query.get("high")], dtype=float)
    except (TypeError, ValueError):
        corners = np.empty(0)
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise CubeError("a box has three finite numbers low and three high [m]")
    return corners[0].tolist(), corners[1].tolist()


def numbers(content: bytes) -> Response:
    """HTTP response with the binary values of a map or of points."""
    return Response(content, media_type="application/octet-stream")


def downloaded(product: Made) -> Response:
    """HTTP response that downloads a product, with its file name in a header."""
    name = quote(product.name, safe="")
    return Response(
        product.content,
        media_type="application/octet-stream",
        headers={
            "content-disposition": f"attachment; filename*=UTF-8''{name}",
            "amulor-said": quote(product.said),
        },
    )


async def answered(answer: Callable[[], Response]) -> Response:
    """HTTP response computed in a thread, or the reason for its failure."""
    return await explained(run_in_threadpool(answer))


async def explained(answer: Awaitable[Response]) -> Response:
    """HTTP response that is awaited, or the reason for its failure."""
    try:
        return await answer
    except (AmulorError, ValueError) as error:
        return JSONResponse({"error": str(error)}, status_code=422)
    except asyncio.CancelledError:  # the server ends before the answer is there
        return JSONResponse({"error": "the server has ended"}, status_code=503)


async def follow(live: Live, socket: WebSocket) -> None:
    """Send status and new rows of a scan to a page until the page is closed."""
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
                for row in rows:
                    await socket.send_bytes(message_of(row))
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
    """Binary message of a row: size of the JSON header, the header, 32-bit numbers."""
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


def design_routes(explorer: Explorer) -> list[Any]:
    """HTTP routes of the design page."""
    files = Files("design.html")

    async def scene(request: Request) -> Response:
        return await answered(lambda: JSONResponse(explorer.describe()))

    async def dragged(request: Request) -> tuple[dict[str, Any], str]:
        request_body = await object_of(request)
        settings, water = (
            request_body.get("settings", {}),
            request_body.get("water", "own"),
        )
        if not isinstance(settings, dict) or not isinstance(water, str):
            raise SurveyError("settings must be an object, and water a name")
        return settings, water

    async def errors(request: Request) -> Response:
        async def answer() -> Response:
            settings, water = await dragged(request)
            result = await run_in_threadpool(explorer.map, settings, water=water)
            return JSONResponse(result)

        return await explained(answer())

    async def met(request: Request) -> Response:
        async def answer() -> Response:
            settings, water = await dragged(request)
            result = await run_in_threadpool(explorer.met, settings, water=water)
            return JSONResponse(result)

        return await explained(answer())

    async def survey(request: Request) -> Response:
        async def answer() -> Response:
            settings, water = await dragged(request)
            text = await run_in_threadpool(explorer.as_survey, settings, water=water)
            return numbers(text.encode())

        return await explained(answer())

    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", scene),
        Route("/map", errors, methods=["POST"]),
        Route("/met", met, methods=["POST"]),
        Route("/survey", survey, methods=["POST"]),
    ]


def space_routes(space: Space) -> list[Any]:
    """HTTP routes of the page of a point cloud or mesh."""
    files = Files("space.html")
    notes = _NotePages(Notes(space.path, SpaceContent))

    async def scene(request: Request) -> Response:
        return await answered(lambda: JSONResponse(space.describe()))

    async def layer(request: Request) -> Response:
        name = request.path_params["name"]
        return await answered(lambda: numbers(space.values(name)))

    async def save(request: Request) -> Response:
        async def answer() -> Response:
            page = await run_in_threadpool(saved_space, space, **await saving(request))
            return numbers(page.encode())

        return await explained(answer())

    async def closer(request: Request) -> Response:
        async def answer() -> Response:
            low, high = box_of(await object_of(request))
            return numbers(await run_in_threadpool(space.closer, low, high))

        return await explained(answer())

    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", scene),
        Route("/layer/space/{name}", layer),
        Route("/closer", closer, methods=["POST"]),
        Route("/save", save, methods=["POST"]),
        *notes.routes(),
    ]


class _NotePages:
    """Reading and writing of the notes of a page."""

    def __init__(self, notes: Notes) -> None:
        self._notes = notes

    def routes(self) -> list[Any]:
        """HTTP routes of the notes."""
        return [
            Route("/notes", self.read),
            Route("/notes", self.write, methods=["POST"]),
        ]

    async def read(self, request: Request) -> Response:
        return await answered(lambda: JSONResponse(self._notes.read()))

    async def write(self, request: Request) -> Response:
        async def answer() -> Response:
            content = await object_of(request)
            return JSONResponse(await run_in_threadpool(self._notes.write, content))

        return await explained(answer())


def application(
    content: Recording | Live | Space | Explorer,
    *,
    token: str,
    hosts: Collection[str] = (),
    beyond: bool = False,
    products: Products | None = None,
) -> ASGIApp:
    """ASGI application of the page for a file, a running scan or a design."""
    if isinstance(content, Space):
        routes = space_routes(content)
    elif isinstance(content, Explorer):
        routes = design_routes(content)
    else:
        routes = _routes(content, products)
    inner = Starlette(routes=routes)
    return Guard(inner, token=token, hosts=hosts, beyond=beyond)


def _routes(content: Recording | Live, products: Products | None) -> list[Any]:
    """HTTP routes of the page of a data file or a running scan."""
    pages, files = _Pages(content, products), Files("index.html")
    return [
        Route("/", files.index),
        Route("/static/{name}", files.static),
        Route("/scene", pages.scene),
        Route("/layer/{channel}/{name}", pages.layer),
        Route("/spectrum/{channel}/{row:int}/{column:int}", pages.spectrum),
        Route("/traces/{channel}/{frequency:int}", pages.traces),
        Route("/coverage", pages.coverage),
        Route("/measure", pages.measure, methods=["POST"]),
        Route("/save", pages.save, methods=["POST"]),
        *_NotePages(Notes(pages.path)).routes(),
        Route("/digest", pages.digest),
        Route("/products", pages.products),
        Route("/product", pages.product, methods=["POST"]),
        WebSocketRoute("/live", pages.live),
    ]


class _Pages:
    def __init__(self, content: Recording | Live, products: Products | None) -> None:
        self._shown, self._products = content, products

    @property
    def path(self) -> Path | None:
        """File of the data."""
        return self._recording.path

    @property
    def _recording(self) -> Recording:
        return self._shown.recording if isinstance(self._shown, Live) else self._shown

    async def scene(self, request: Request) -> Response:
        channel = request.query_params.get("channel")

        def answer() -> Response:
            return JSONResponse(
                {
                    **self._recording.describe(channel),
                    "live": isinstance(self._shown, Live),
                    "moves": getattr(self._shown, "coverage", None) is not None,
                }
            )

        return await answered(answer)

    async def layer(self, request: Request) -> Response:
        channel, name = (request.path_params[key] for key in ("channel", "name"))

        def answer() -> Response:
            recording = self._recording
            if name == "beams":
                values = recording.nodes(channel).values
                return numbers(np.ascontiguousarray(values, "<f4").tobytes())
            layers = recording.layers(channel)
            if name not in layers:
                raise CubeError(f"there is no map {name[:40]!r}")
            stride = recording.stride(channel)
            values = recording.layer(channel, name, stride)
            return numbers(stored(values, layers[name][0]))

        return await answered(answer)

    async def spectrum(self, request: Request) -> Response:
        place = request.path_params

        def answer() -> Response:
            recording = self._recording
            rows, columns = recording.channel(place["channel"]).shown.shape
            if not (place["row"] < rows and place["column"] < columns):
                raise CubeError("this pixel is outside of the scan")
            at = (place["row"], place["column"])
            values = spectrum(recording.cubes, place["channel"], *at)
            return JSONResponse(values)

        return await answered(answer)

    async def traces(self, request: Request) -> Response:
        channel, frequency = (request.path_params[k] for k in ("channel", "frequency"))

        def answer() -> Response:
            if not isinstance(self._shown, Live):
                raise CubeError("signals over time are those of a running scan")
            return JSONResponse(self._shown.traces.over_time(channel, frequency))

        return await answered(answer)

    async def coverage(self, request: Request) -> Response:
        def answer() -> Response:
            live = self._shown
            if not isinstance(live, Live) or live.coverage is None:
                raise CubeError("track and coverage are those of a scan from a vehicle")
            return JSONResponse(live.coverage.state)

        return await answered(answer)

    async def measure(self, request: Request) -> Response:
        async def answer() -> Response:
            query = await object_of(request)
            result = await run_in_threadpool(measured, self._recording, query)
            return JSONResponse(result)

        return await explained(answer())

    async def save(self, request: Request) -> Response:
        async def answer() -> Response:
            page = await run_in_threadpool(
                saved_page, self._recording, **await saving(request)
            )
            return Response(page.encode(), media_type="application/octet-stream")

        return await explained(answer())

    async def digest(self, request: Request) -> Response:
        return await answered(lambda: JSONResponse(self._recording.digest()))

    async def products(self, request: Request) -> Response:
        offered = [] if self._products is None else self._products.offered()
        return JSONResponse(offered)

    async def product(self, request: Request) -> Response:
        async def answer() -> Response:
            query = await object_of(request)
            return downloaded(await run_in_threadpool(self._product, query))

        return await explained(answer())

    def _product(self, query: dict[str, Any]) -> Made:
        if self._products is None:
            raise CubeError("this server makes no products")
        recording = self._recording
        channel = str(query.get("channel", recording.channels[0]))
        image = recording.channel(channel).shown.whole()
        stem = recording.name.rpartition(".")[0] or recording.name
        if len(recording.channels) > 1:
            stem = f"{stem}-{channel}"
        return self._products.make(image, query, stem=stem)

    async def live(self, socket: WebSocket) -> None:
        if not isinstance(self._shown, Live):
            await socket.close(1008, "this is no running scan")
            return
        await socket.accept()
        try:
            await follow(self._shown, socket)
        except WebSocketDisconnect:
            return


#: Largest message of a page on a websocket, which has one or two words [byte].
_LARGEST_MESSAGE = 4096
#: Longest time from a connection to the end of the headers of a request, and from there
#: to the end of its body [s].
_HEADER_TIME, _BODY_TIME = 10.0, 30.0
_EVERYWHERE = ("0.0.0.0", "::")


class _Connection(H11Protocol):
    """HTTP connection that is closed if a request takes too long."""

    _timer: asyncio.TimerHandle | None = None
    _awaited: object = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._limit_time()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._limit_time()

    def _limit_time(self) -> None:
        """Start the timer of the headers or the body that is awaited; else stop it."""
        # A websocket has taken over the connection of its request, and may stay.
        own = self.transport.get_protocol() is self
        state = self.conn.their_state if own else h11.DONE
        if state is self._awaited:
            return
        self._awaited = state
        if self._timer is not None:
            self._timer.cancel()
        limit = {h11.IDLE: _HEADER_TIME, h11.SEND_BODY: _BODY_TIME}.get(state)
        self._timer = (
            self.loop.call_later(limit, self.transport.close) if limit else None
        )


def serve(
    content: Recording | Live | Space | Explorer,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    announce: Callable[[str], None] = lambda address: None,
    token: str | None = None,
    products: Products | None = None,
) -> None:
    """Serve a browser page until Ctrl-C."""
    with contextlib.closing(_listener(host, port)) as listener:
        address, server = _server(
            content, host, listener, token or new_token(), products
        )
        announce(address)
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


@contextlib.contextmanager
def background(
    content: Recording | Live | Space | Explorer,
    *,
    token: str | None = None,
    products: Products | None = None,
) -> Iterator[str]:
    """Serve a browser page in the background, as in a notebook."""
    with contextlib.closing(_listener("127.0.0.1", 0)) as listener:
        address, server = _server(
            content, "127.0.0.1", listener, token or new_token(), products
        )
        thread = threading.Thread(
            target=server.run, kwargs={"sockets": [listener]}, daemon=True
        )
        thread.start()
        try:
            yield address
        finally:
            server.should_exit = True
            thread.join(10)


def _listener(host: str, port: int) -> socket.socket:
    """Return a listening socket; early requests wait in it for the server."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # With its protocol named, asyncio sends each answer at once; else a browser that
    # keeps its connection waits 40 ms for each.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise FormatError(
            f"{host}, port {port}, cannot be listened at: "
            f"{error.strerror or error}; leave out --port, or name another"
        ) from error
    return listener


def _server(
    content: Recording | Live | Space | Explorer,
    host: str,
    listener: socket.socket,
    token: str,
    products: Products | None,
) -> tuple[str, uvicorn.Server]:
    """Address of a page, and the server for it."""
    name = socket.gethostname() if host in _EVERYWHERE else host
    in_address = f"[{name}]" if ":" in name else name
    config = uvicorn.Config(
        application(
            content,
            token=token,
            hosts=[name],
            products=products,
            beyond=host not in ("127.0.0.1", "::1", "localhost"),
        ),
        access_log=False,
        log_level="error",
        server_header=False,
        http=_Connection,
        ws="websockets-sansio",
        ws_max_size=_LARGEST_MESSAGE,
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    port = listener.getsockname()[1]
    return f"http://{in_address}:{port}/{token}/", uvicorn.Server(config)
