"""The hierarchy of boxes that rays walk, built in compiled loops.

A million triangles take a second of compiled code, and minutes of Python.
"""

from __future__ import annotations

import numpy as np

from amulor.transport._kernels.compiled import allocating_entry, kernel
from amulor.transport._kernels.mesh import ESCAPE, FIRST_TRIANGLE, TRIANGLES
from amulor.transport._kernels.types import Array, Integers

#: Triangles in a box without boxes, at most.
LEAF = 4


@kernel
def widest(centre: Array, number: Integers, first: int, last: int) -> int:
    """Return the axis along which the centres of some triangles spread the most."""
    axis = 0
    most = -1.0
    for k in range(3):
        low = high = centre[number[first], k]
        for i in range(first + 1, last):
            low = min(low, centre[number[i], k])
            high = max(high, centre[number[i], k])
        if high - low > most:
            most = high - low
            axis = k
    return axis


@kernel
def part(
    centre: Array, number: Integers, axis: int, first: int, last: int, middle: int
) -> None:
    """Order triangles so that none before the middle is beyond one after it.

    C. A. R. Hoare's Find, Commun. ACM 4, 321 (1961), doi:10.1145/366622.366647.
    """
    low, high = first, last - 1
    while low < high:
        pivot = centre[number[middle], axis]
        i, j = low, high
        while i <= j:
            while centre[number[i], axis] < pivot:
                i += 1
            while centre[number[j], axis] > pivot:
                j -= 1
            if i <= j:
                number[i], number[j] = number[j], number[i]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if i > middle:
            high = j


@allocating_entry
def split(centre: Array, number: Integers, link: Integers, sibling: Integers) -> int:
    """Order triangles into boxes, fill links and siblings, and return how many boxes.

    Boxes come before what is in them. sibling of a box is the second one of the two
    in it.
    """
    # First and last triangle, and the box around, of what waits; one for each level.
    waiting = np.empty((128, 3), dtype=np.int64)
    parent = np.empty(len(sibling), dtype=np.int64)
    waiting[0] = 0, len(number), -1
    count, left = 0, 1
    while left > 0:
        left -= 1
        first, last, above = waiting[left]
        parent[count] = above
        link[count, FIRST_TRIANGLE] = first
        link[count, TRIANGLES] = 0
        sibling[count] = -1
        if above >= 0:
            sibling[above] = count  # the second of the two comes last
        if last - first <= LEAF:
            link[count, TRIANGLES] = last - first
        else:
            middle = first + (last - first) // 2
            axis = widest(centre, number, first, last)
            part(centre, number, axis, first, last, middle)
            waiting[left] = middle, last, count
            waiting[left + 1] = first, middle, count
            left += 2
        count += 1
    link[0, ESCAPE] = count
    for k in range(1, count):
        second = sibling[parent[k]]
        link[k, ESCAPE] = link[parent[k], ESCAPE] if k == second else second
    return count


@kernel
def enclose(
    low: Array,
    high: Array,
    gap: float,
    link: Integers,
    sibling: Integers,
    box: Array,
) -> None:
    """Fill the corners of boxes from those of triangles, a gap around them."""
    for k in range(len(box) - 1, -1, -1):
        for axis in range(3):
            if sibling[k] < 0:
                first = link[k, FIRST_TRIANGLE]
                lower, upper = low[first, axis], high[first, axis]
                for i in range(first + 1, first + link[k, TRIANGLES]):
                    lower, upper = min(lower, low[i, axis]), max(upper, high[i, axis])
                box[k, axis], box[k, 3 + axis] = lower - gap, upper + gap
            else:
                one, two = k + 1, sibling[k]
                box[k, axis] = min(box[one, axis], box[two, axis])
                box[k, 3 + axis] = max(box[one, 3 + axis], box[two, 3 + axis])
