"""What the server answers of a point cloud or a mesh."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from amulor.view.page.saved import saved_space
from amulor.view.page.space import Space
from amulor.view.page.web.answers import (
    Files,
    answered,
    explained,
    measurements_of,
    numbers,
)


def space_routes(space: Space) -> list[Any]:
    """Return what is answered of a cloud or a mesh.

    Parameters
    ----------
    space : Space
        What is shown.

    Returns
    -------
    list of Route
        The page, its files, a description, numbers, and the page as one file.
    """
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
