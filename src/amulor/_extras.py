"""Optional dependencies, checked before a long computation."""

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
    "platform": {
        "pynmeagps": "pynmeagps",
        "mcap-ros2-support": "mcap_ros2",
        "pyproj": "pyproj",
    },
    "ptu": {"ptufile": "ptufile"},
    "scale": {"dask": "dask", "distributed": "distributed"},
}


def require(*extras: str, purpose: str) -> None:
    """Raise if optional packages are missing that a computation will need."""
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
    """Return the features with missing packages, and the extra that installs each."""
    return {
        feature: next(
            extra for extra, brought in MODULES.items() if name in brought.values()
        )
        for feature, name in modules.items()
        if find_spec(name) is None
    }
