"""The page's server: what it answers, to whom, and nothing else."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from amulor.errors import CubeError
from amulor.view.design.explorer import Explorer
from amulor.view.page.layers import stored
from amulor.view.page.live import Live
from amulor.view.page.measuring import measured
from amulor.view.page.offers import Made, Products
from amulor.view.page.recording import Recording
from amulor.view.page.saved import saved_page
from amulor.view.page.space import Space
from amulor.view.page.spectra import spectrum
from amulor.view.page.web import feed
from amulor.view.page.web.answers import (
    Files,
    answered,
    downloaded,
    explained,
    measurements_of,
    numbers,
    object_of,
)
from amulor.view.page.web.design_pages import design_routes
from amulor.view.page.web.security import Guard
from amulor.view.page.web.space_pages import space_routes


def application(
    shown: Recording | Live | Space | Explorer,
    *,
    token: str,
    hosts: Collection[str] = (),
    beyond: bool = False,
    products: Products | None = None,
) -> ASGIApp:
    """Return the page of a file, a scan or a design as an ASGI application.

    Parameters
    ----------
    shown : Recording, Live, Space or Explorer
        What it shows.
    token : str
        First part of every address.
    hosts : collection of str
        Names of this computer besides localhost.
    beyond : bool
        Whether other computers are served, too.
    products : Products, optional
        Makes files of a range image, which the browser keeps; none without.

    Returns
    -------
    callable
        Starlette behind a `Guard`. Nothing it answers changes a file or moves a device.
    """
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
            await feed.follow(self._shown, socket)
        except WebSocketDisconnect:
            return
