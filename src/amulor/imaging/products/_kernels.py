"""Compiled rasterization of triangles, with hidden surfaces removed."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor._compiled import numba


@numba.njit(cache=True)
def draw(corners: Any, triangles: Any, height: Any, owner: Any, weight: Any) -> None:
    """Fill height, triangle number and vertex weights of the covered cells.

    `corners` are vertices in columns, rows and height; `owner` gets the number of the
    triangle, `weight` the shares of its first two vertices.
    """
    rows, columns = height.shape
    for number in range(triangles.shape[0]):
        i, j, k = triangles[number]
        ax, ay = corners[i, 0], corners[i, 1]
        bx, by = corners[j, 0], corners[j, 1]
        cx, cy = corners[k, 0], corners[k, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        left = max(0, int(np.ceil(min(ax, bx, cx) - 0.5)))
        right = min(columns - 1, int(np.floor(max(ax, bx, cx) - 0.5)))
        top = max(0, int(np.ceil(min(ay, by, cy) - 0.5)))
        bottom = min(rows - 1, int(np.floor(max(ay, by, cy) - 0.5)))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                third = 1.0 - first - second
                if first < -1e-9 or second < -1e-9 or third < -1e-9:
                    continue
                candidate = (
                    first * corners[i, 2]
                    + second * corners[j, 2]
                    + third * corners[k, 2]
                )
                if not candidate <= height[row, column]:
                    height[row, column] = candidate
                    owner[row, column] = number
                    weight[row, column, 0] = first
                    weight[row, column, 1] = second
