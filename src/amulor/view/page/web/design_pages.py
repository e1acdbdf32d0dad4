"""What the server answers of a design whose numbers are dragged."""

from __future__ import annotations

from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from amulor.errors import SurveyError
from amulor.view.design.explorer import Explorer
from amulor.view.page.web.answers import Files, answered, explained, numbers, object_of


def design_routes(shown: Explorer) -> list[Any]:
    """Return what is answered of a design.

    Parameters
    ----------
    shown : Explorer
        What is dragged.

    Returns
    -------
    list of Route
        The page, its files, a description, maps, what is met, and the instrument as
        a survey.
    """
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
