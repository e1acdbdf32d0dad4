"""Two visits of a sloping plane, placed by hand, for drawings of a site."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from amulor.handover.site_drawings import SiteOrder, _Visit
from amulor.imaging.frame import Frame
from amulor.imaging.products import Surface
from amulor.site import Site
from amulor.site.merging.plan import PlacedScan

#: Side of the squares of a scan [m].
STEP = 0.25
FRAME = Frame(name="pose", rotation=np.eye(3), position=np.zeros(3))


def placed(
    name: str, epoch: str, west: float, *, height: float = 0.0, moving: int = 0
) -> PlacedScan:
    """Return a scan 3 m wide and 2 m deep that goes up by 0.1 to the north."""
    x, y = np.meshgrid(west + STEP * np.arange(13), STEP * np.arange(9))
    position = np.stack([x, y, height + 0.1 * y], axis=-1).reshape(-1, 3)
    number = np.arange(len(position)).reshape(x.shape)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    )
    count = len(position)
    surface = Surface(
        position=position,
        direction=np.tile([0.0, 0.0, -1.0], (count, 1)),
        normal=np.tile([0.0, -0.1, 1.0] / np.sqrt(1.01), (count, 1)),
        own=np.full(count, 3e-3), shared=np.full(count, 4e-3),
        amplitude=np.ones(count), pixel=np.arange(count),
        triangles=np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]),
        shape=x.shape, frame=FRAME, attributes={},
    )  # fmt: skip
    return PlacedScan(
        name=name, epoch=epoch, surface=surface, upward=np.full(count, 5e-3),
        doubtful=np.zeros(count), moving=moving,
    )  # fmt: skip


#: The visit of the plan has two scans side by side, 0.5 m of both overlap.
SCANS = [
    placed("a", "one", 0.0, height=0.3, moving=5),
    placed("b", "two", 0.0, moving=7),
    placed("c", "two", 2.5, moving=4),
]
SITE = Site.model_validate(
    {
        "name": "Harbor",
        "epoch": [{"name": "one"}, {"name": "two"}],
        "scan": [
            {"name": s.name, "file": f"{s.name}.nc", "epoch": s.epoch} for s in SCANS
        ],
    }
)


def pose(*place: float) -> Any:
    """Return the pose of an instrument at a place."""
    return SimpleNamespace(position=np.array([*place, 4.0]))


class Known:
    """Registration of three poses, the first one with an error of 3, 2 and 1 mm."""

    poses = {"a": pose(1.0, 1.0), "b": pose(1.0, -2.0), "c": pose(4.0, 1.0)}  # noqa: RUF012
    points = {"T": np.array([0.5, 0.5, 0.0])}  # noqa: RUF012

    def covariance_of(self, *names: str) -> np.ndarray:
        """Return independent errors of the poses."""
        variances = {
            "pose a": np.array([4e-6, 9e-6, 1e-6, 0, 0, 0]),
            "pose b": np.array([1e-4, 4e-4, 1e-6, 0, 0, 0]),
            "pose c": np.array([1e-4, 1e-4, 1e-6, 0, 0, 0]),
        }
        return np.diag(np.concatenate([variances[name] for name in names]))


def visit(order: SiteOrder | None = None, site: Site = SITE, **changes: Any) -> _Visit:
    """Return the last visit of the site."""
    registration: Any = Known()
    fields: dict[str, Any] = {
        "site": site, "registration": registration, "scans": SCANS,
        "order": order or SiteOrder(),
    }  # fmt: skip
    return _Visit(**(fields | changes))
