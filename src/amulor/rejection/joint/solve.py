"""Estimates of all pixels once what they share is known, with their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import (
    model as joint_model,
)
from amulor.rejection.joint import (
    pixels as joint_pixels,
)
from amulor.rejection.joint import (
    search as joint_search,
)
from amulor.rejection.joint._kernels import common as kernels
from amulor.rejection.joint.frame import Frame
from amulor.rejection.joint.pixels import Pixels
from amulor.rejection.joint.priors import Layout, Shared
from amulor.rejection.joint.scatter import is_seen
from amulor.rejection.joint.search import Estimates

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Result:
    """What is found for every pixel, flat arrays over the scan."""

    estimates: Estimates
    seen: NDArray[np.bool_]
    depth: Floats
    water: Complex
    common: Covariance
    stray: Complex | None
    shared_variance: Floats
    bound: Floats
    departure: Floats


def solve(frame: Frame, pixels: Pixels, shared: Shared, transfer: Complex) -> Result:
    """Return the estimates of some pixels with the shared ones known."""
    wavenumber = frame.wavenumber
    full = transfer * (1 + shared.echo)
    open_path = np.full(len(pixels), np.inf)
    stray = None
    near = joint_model.near(pixels, shared.table, wavenumber)
    if shared.fluctuation > 0:
        _, water, _ = joint_model.water_at(pixels, open_path, shared.table, wavenumber)
        stray = shared.fluctuation * shared.light(water, near)
    found = joint_search.estimate(
        joint_search.without_offset(
            pixels, shared.table, offset=shared.offset, wavenumber=wavenumber
        ),
        joint_pixels.weight(pixels, stray),
        shared.table,
        gain=shared.gain,
        transfer=full,
        wavenumber=wavenumber,
    )
    seen = is_seen(found)
    path = np.where(seen, found.path, np.inf)
    depth, water, _ = joint_model.water_at(pixels, path, shared.table, wavenumber)
    changes = joint_model.shape_changes(pixels, depth, shared.table, wavenumber)
    whole = shared.light(water, near)
    if shared.fluctuation > 0:
        stray = shared.fluctuation * whole
    slopes = _path_slopes(
        shared,
        found,
        water,
        near,
        changes,
        np.exp(1j * np.where(seen, path, 0.0)[:, None] * wavenumber) * transfer,
    )
    layout = _layout(shared)
    own = np.divide(
        1.0,
        found.information,
        out=np.full(len(pixels), np.nan),
        where=found.information > 0,
    )
    variance = np.einsum("ni,ni->n", slopes @ shared.covariance, slopes)
    basic = slopes[:, layout.parametric]
    parametric = np.einsum("ni,ni->n", basic @ shared.parametric, basic)
    free = slice(layout.blocks[1].start, layout.size)
    moved = np.abs(slopes[:, free] @ _free_parameters(shared))
    unsure = np.einsum(
        "ni,ni->n", slopes[:, free] @ shared.covariance[free, free], slopes[:, free]
    )
    # Nobody asks for the influences any more, and they are most of the memory.
    found = replace(found, influence=np.zeros((0, 0, 0), dtype=complex))
    return Result(
        found,
        seen,
        depth,
        whole,
        _common(shared, water, near, changes),
        stray,
        variance,
        own + parametric,
        np.hypot(moved, np.sqrt(np.maximum(unsure, 0.0))),
    )


def _layout(shared: Shared) -> Layout:
    channels, frequencies = shared.departure.shape
    return Layout(channels, frequencies, len(shared.shape.knots))


def _free_parameters(shared: Shared) -> Floats:
    """Return the departures of water and echo in the order of `Layout`."""
    return np.concatenate(
        [
            shared.departure.real.ravel(),
            shared.departure.imag.ravel(),
            shared.echo.real,
            shared.echo.imag,
        ]
    )


def _path_slopes(
    shared: Shared,
    found: Estimates,
    water: Complex,
    near: Complex,
    changes: Complex,
    echo: Complex,
) -> Floats:
    """Return how the paths move with the shared parameters, (pixel, parameter)."""
    layout = _layout(shared)
    channels = len(shared.strength)
    out = np.zeros((len(water), layout.size))
    pull = np.conj(found.influence)
    for c in range(channels):
        out[:, c] = -np.sum(
            (pull[:, c] * (water + shared.departure[c] * near)).real, axis=-1
        )
    turned = pull * shared.gain
    out[:, layout.shape] = -np.einsum("ncf,nmf->nm", turned, changes).real
    _, free, echoes = layout.blocks
    own = pull * shared.strength[:, None] * near[:, None]
    both = np.stack([-own.real, own.imag], axis=1)
    out[:, free] = both.reshape(len(water), -1)
    back = np.einsum("ncf,nc->nf", pull, found.amplitude) * echo
    out[:, echoes] = np.concatenate([-back.real, back.imag], axis=1)
    return out


def _common(
    shared: Shared, water: Complex, near: Complex, changes: Complex
) -> Covariance:
    """Return the covariance of the estimated water signal, which pixels share."""
    layout = _layout(shared)
    channels, frequencies = shared.departure.shape
    shape = (len(water), channels, frequencies)
    parts = [np.empty(shape) for _ in range(3)]
    inner = np.arange(layout.shape.start, layout.shape.stop)
    channel, frequency = np.indices((channels, frequencies))
    first = layout.blocks[1].start + channel * frequencies + frequency
    columns = np.concatenate(
        [
            channel[..., None],
            np.broadcast_to(inner, (channels, frequencies, inner.size)),
            first[..., None],
            first[..., None] + channels * frequencies,
        ],
        axis=-1,
    )
    matrix = shared.covariance[columns[..., :, None], columns[..., None, :]]
    kernels.common(
        shared.strength,
        np.ascontiguousarray(shared.gain),
        np.ascontiguousarray(shared.departure),
        near,
        water,
        changes,
        matrix,
        *parts,
    )
    return Covariance(*parts)
