"""Browser page saved as one file that needs neither server nor network."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.view.page.layers import packed, stored
from amulor.view.page.notes import Notes, SpaceContent
from amulor.view.page.recording import MOST_PIXELS, Recording, spectra
from amulor.view.page.space import Space

#: Types of the page's files, in loading order: each follows those that it needs.
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".woff2": "font/woff2",
}
#: Largest number of spectra in a saved page [1].
_MOST_SPECTRA = 4_000_000
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'"
)


def static_files() -> dict[str, bytes]:
    """Return the static files of the page by name."""
    folder = resources.files("amulor.view.page") / "static"
    return {
        entry.name: entry.read_bytes()
        for entry in folder.iterdir()
        if entry.is_file() and Path(entry.name).suffix in TYPES
    }


def save_page(
    recording: Recording | Space,
    path: str | Path,
    *,
    measurements: Sequence[Mapping[str, Any]] = (),
    overwrite: bool = False,
) -> None:
    """Write the browser page of a data file or a cloud as one HTML file."""
    if isinstance(recording, Space):
        page = saved_space(recording, measurements=measurements)
    else:
        page = saved_page(recording, measurements=measurements)
    with atomic_output(Path(path), overwrite=overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8")


def saved_page(
    recording: Recording,
    *,
    measurements: Sequence[Mapping[str, Any]] = (),
    limits: str = "",
) -> str:
    """Browser page of a data file as the text of one HTML file."""
    files = static_files()
    scenes = {name: recording.describe(name) for name in _carried(recording)}
    content = {
        "scenes": scenes,
        "measurements": [dict(measurement) for measurement in measurements],
        "limits": limits,
        "digest": recording.digest(),
        "notes": Notes(recording.path).read(),
    }
    scripts = [_data("amulor-scene", json.dumps(content, allow_nan=False))]
    for channel in scenes:
        stride = recording.stride(channel)
        for name, (layer, *_) in recording.layers(channel).items():
            values = recording.layer(channel, name, stride)
            width = 2 if layer.kind == "flags" else 4
            text = packed(stored(values, layer), width=width)
            scripts.append(_data(f"layer/{channel}/{name}", text))
        nodes = np.ascontiguousarray(recording.nodes(channel).values, "<f4").tobytes()
        scripts.append(_data(f"layer/{channel}/beams", packed(nodes, width=4)))
        scripts += _spectra(recording, channel)
    return _assembled(files, scripts, page="index", starts="app.js")


def saved_space(
    space: Space,
    *,
    measurements: Sequence[Mapping[str, Any]] = (),
    limits: str = "",
) -> str:
    """Browser page of a point cloud or mesh as the text of one HTML file."""
    scene = space.describe()
    content = {
        "scenes": {"space": scene},
        "measurements": [dict(measurement) for measurement in measurements],
        "limits": limits,
        "notes": Notes(space.path, SpaceContent).read(),
    }
    scripts = [_data("amulor-scene", json.dumps(content, allow_nan=False))]
    names = ["position", *(str(layer["name"]) for layer in scene["layers"])]
    names += ["faces"] if scene["mesh"] else []
    names += ["colour"] if scene["colour"] else []
    for name in names:
        width = 1 if name == "colour" else 4
        text = packed(space.values(name), width=width)
        scripts.append(_data(f"layer/space/{name}", text))
    return _assembled(static_files(), scripts, page="space", starts="space.js")


def _carried(recording: Recording) -> list[str]:
    """Names of the channels that fit into one saved page."""
    rows, columns = recording.channel().shown.shape
    room = max(1, MOST_PIXELS // max(rows * columns, 1))
    return recording.channels[:room]


def _spectra(recording: Recording, channel: str) -> list[str]:
    cubes = spectra(recording.cubes, channel, most=_MOST_SPECTRA)
    return [
        _data(f"spectrum/{channel}/{name}", packed(values.tobytes(), width=4))
        for name, values in cubes.items()
    ]


def _data(name: str, text: str) -> str:
    # "<" could end the script early, or begin a comment in it.
    safe = text.replace("<", "\\u003c")
    named = html.escape(name, quote=True)
    return f'<script type="application/json" data-name="{named}">{safe}</script>'


def _assembled(
    files: Mapping[str, bytes], data: Sequence[str], *, page: str, starts: str
) -> str:
    """HTML text of a page in which all of its files are embedded."""
    text = files[f"{page}.html"].decode()
    style = _with_fonts(files["page.css"].decode(), files)
    modules = {
        name: _bare(content.decode())
        for name, content in files.items()
        if name in _modules(files, starts)
    }
    imports = {
        f"page/{name}": "data:text/javascript;base64,"
        + base64.b64encode(module.encode()).decode()
        for name, module in modules.items()
    }
    replaced = {
        '<link rel="stylesheet" href="static/page.css">': f"<style>{style}</style>",
        f'<script type="module" src="static/{starts}"></script>': "\n".join(
            [
                f'<script type="importmap">{json.dumps({"imports": imports})}</script>',
                *data,
                f'<script type="module">import "page/{starts}";</script>',
            ]
        ),
        "<!-- policy -->": (
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        ),
        '<link rel="icon" href="static/icon.svg" type="image/svg+xml">': (
            '<link rel="icon" type="image/svg+xml" href="data:image/svg+xml;base64,'
            + base64.b64encode(files["icon.svg"]).decode()
            + '">'
        ),
    }
    for old, new in replaced.items():
        if text.count(old) != 1:
            raise FormatError(
                f"{page}.html must hold {old!r} once; install amulor again"
            )
        text = text.replace(old, new)
    return text


def _with_fonts(style: str, files: Mapping[str, bytes]) -> str:
    """Style sheet with its fonts embedded."""
    for name, content in files.items():
        if name.endswith(".woff2"):
            data = base64.b64encode(content).decode()
            style = style.replace(
                f'url("{name}")', f"url(data:font/woff2;base64,{data})"
            )
    return style


def _modules(files: Mapping[str, bytes], starts: str) -> set[str]:
    """Names of a JavaScript module and of the modules that it imports."""
    modules: set[str] = set()
    pending = [starts]
    while pending:
        name = pending.pop()
        if name not in modules:
            modules.add(name)
            pending += re.findall(r'from\s+"\./([\w-]+\.js)"', files[name].decode())
    return modules


def _bare(module: str) -> str:
    """JavaScript module with its imports by name instead of by path."""
    return re.sub(r'(from\s+|import\s+)"\./([\w-]+\.js)"', r'\1"page/\2"', module)
