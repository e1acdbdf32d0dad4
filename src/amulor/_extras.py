"""Optional dependencies: what each extra brings, asked for before work begins."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

from amulor.errors import MissingExtraError

#: Modules that an extra of pyproject.toml installs, by the name of their package.
MODULES = {
    "scene": {"trimesh": "trimesh"},
    "export": {
        "laspy[lazrs]": "lazrs",
        "ezdxf": "ezdxf",
        "tifffile": "tifffile",
        "pyproj": "pyproj",
    },
    "e57": {"pye57": "pye57"},
    "mie": {"miepython": "miepython"},
    "unwrap": {"scikit-image": "skimage"},
    "view": {
        "starlette": "starlette",
        "uvicorn": "uvicorn",
        "websockets": "websockets",
        "trimesh": "trimesh",
    },
    "site": {"small-gicp": "small_gicp"},
    "scale": {"dask": "dask", "distributed": "distributed"},
}


def require(*extras: str, purpose: str) -> None:
    """Refuse work that would fail on its way for want of a package.

    Parameters
    ----------
    *extras : str
        Keys of `MODULES`.
    purpose : str
        What needs them, to begin a sentence with.

    Raises
    ------
    MissingExtraError
        If a package is not installed; names all of them and one line that installs all.
    """
    missing = {
        extra: [
            package
            for package, module in MODULES[extra].items()
            if find_spec(module) is None
        ]
        for extra in extras
    }
    lacking = [extra for extra in extras if missing[extra]]
    if lacking:
        raise MissingExtraError(
            ", ".join(package for extra in lacking for package in missing[extra]),
            extra=",".join(lacking),
            purpose=purpose,
        )


def left_out(modules: Mapping[str, str]) -> dict[str, str]:
    """Return what cannot be done here, and the extra that each of it needs.

    Parameters
    ----------
    modules : mapping of str to str
        Module that each thing is done with, one of `MODULES`.

    Returns
    -------
    dict of str to str
        Name of the extra by the name of the thing.
    """
    return {
        thing: next(
            extra for extra, brought in MODULES.items() if name in brought.values()
        )
        for thing, name in modules.items()
        if find_spec(name) is None
    }
