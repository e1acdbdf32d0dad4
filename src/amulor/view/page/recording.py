"""Data file on the browser page: maps of each channel, before and after rejection."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor import pipeline, rejection
from amulor.cube import WATER_NOT_REMOVED, without_groups
from amulor.cube.provenance import software_versions
from amulor.cube.schema import RANGE_PREFIX, TERMS
from amulor.errors import AmulorError, CubeError
from amulor.imaging.common import own_variance
from amulor.imaging.edges import STEP_MARGIN, steps
from amulor.imaging.products import Deviation
from amulor.io import read_cube
from amulor.io.netcdf import is_large
from amulor.view.page.layers import BEFORE, MAPS, STEPS, Layer, described, flag_words
from amulor.view.page.pictures import (
    Channel,
    MemoryPicture,
    Nodes,
    Picture,
    large_picture,
    nodes_of,
    sharing_of,
)

Cubes = Mapping[str, xr.Dataset | None]


def spectrum(
    cubes: Cubes, channel: str, row: int, column: int
) -> dict[str, Any] | None:
    """Amplitude and phase of a pixel over frequency; None without the channel."""
    parts: dict[str, Any] = {}
    frequency: NDArray[np.float64] | None = None
    for name, cube in cubes.items():
        if cube is None or channel not in cube.amulor.polarizations:
            continue
        pixel = cube.sel(polarization=channel).isel(row=row, column=column)
        frequency = np.atleast_1d(cube["modulation_frequency"].values)
        signal = pixel["in_phase"].values + 1j * pixel["quadrature"].values
        error = np.hypot(
            pixel["in_phase_uncertainty"].values,
            pixel["quadrature_uncertainty"].values,
        )
        parts[name] = _line(signal, error / math.sqrt(2))
        if name == "after":
            water = (
                pixel["water_in_phase"].values + 1j * pixel["water_quadrature"].values
            )
            parts["water"] = _line(water, None)
    if frequency is None:
        return None
    return {"frequency": frequency.tolist(), **parts}


def spectra(cubes: Cubes, channel: str, *, most: int) -> dict[str, NDArray[np.float32]]:
    """Signals and uncertainties of a channel for a saved page; empty if too large."""
    encoded = {}
    for name, cube in cubes.items():
        if cube is None or channel not in cube.amulor.polarizations:
            continue
        samples = cube.sel(polarization=channel)
        if 6 * samples["in_phase"].size > most:
            return {}
        error = np.hypot(
            samples["in_phase_uncertainty"].values,
            samples["quadrature_uncertainty"].values,
        )
        parts = samples["in_phase"].values, samples["quadrature"].values, error / 2**0.5
        encoded[name] = np.stack(parts).astype("<f4")
    return encoded


def _line(
    signal: NDArray[np.complex128], error: NDArray[np.float64] | None
) -> dict[str, Any]:
    """Amplitude and phase over frequency, as lists."""
    signal = np.atleast_1d(signal)
    line = {"amplitude": np.abs(signal), "phase": np.angle(signal)}
    if error is not None:
        line["uncertainty"] = np.atleast_1d(error)
    return {name: _listed(values) for name, values in line.items()}


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


Interval = tuple[float, float] | None
#: Comparison of a range image with a reference: deviations, and result in words.
Comparison = Callable[[xr.Dataset], tuple[Deviation, str]]

#: More pixels than these are drawn by strides [1].
MOST_PIXELS = 10_000_000
#: Number of rows in which steps are searched at once [1].
_BAND = 512
#: Textures of most GPUs reach this far along a side [1].
LONGEST_SIDE = 8192


class Recording:
    """Data file as the browser page shows it; range images are computed on request."""

    def __init__(
        self,
        name: str,
        *,
        image: xr.Dataset | Picture | None = None,
        target: xr.Dataset | None = None,
        samples: xr.Dataset | None = None,
        interval: Interval = None,
        notes: list[str] | None = None,
    ) -> None:
        self.name = name
        #: Data file; None for data in memory.
        self.path: Path | None = None
        #: Comparison with a reference, of which the page shows the deviations.
        self.against: Comparison | None = None
        self.notes = [] if notes is None else notes
        self._given: Picture | None = (
            MemoryPicture(image) if isinstance(image, xr.Dataset) else image
        )
        self._target, self._samples = target, samples
        self._interval = interval
        self._channels: dict[str, Channel] = {}
        self._kept: xr.Dataset | None = None
        self._nodes: dict[str, Nodes] = {}
        self._digest = ""
        self._lock = threading.Lock()

    @property
    def channels(self) -> list[str]:
        """Names of the polarization channels."""
        for cube in (self._target, self._samples):
            if cube is not None:
                names: list[str] = cube.amulor.polarizations
                break
        else:
            names = []
        if self._given is not None:
            name = str(self._given.attributes.get("polarization", "none"))
            return [name]
        return names

    def digest(self) -> str:
        """SHA-256 digest of the data file; empty for data in memory."""
        if self.path is None:
            return ""
        if not self._digest:
            self._digest = cubes.digest(self.path)
        return self._digest

    @property
    def samples(self) -> xr.Dataset | None:
        """Cube of level `samples`, if it is available."""
        return self._samples

    def channel(self, name: str | None = None) -> Channel:
        """Range images of a channel; by default of the first channel."""
        chosen = self.channels[0] if name is None else name
        if chosen not in self.channels:
            raise CubeError(
                f"{self.name} has no channel {chosen!r}, only "
                f"{', '.join(self.channels)}"
            )
        with self._lock:
            if chosen not in self._channels:
                self._channels[chosen] = self._pictures_of(chosen)
            return self._channels[chosen]

    def _pictures_of(self, name: str) -> Channel:
        before = None if self._samples is None else self._imaged(self._raw(), name)
        after = self._given
        if after is None and self._target is not None:
            after = self._imaged(self._target, name)
        if after is None and before is None:
            raise CubeError(f"{self.name} holds nothing that can be shown as a picture")
        if after is not None and _water_in(after):
            before = None  # one picture for both
        if self.against is None or after is None:
            return Channel(after=after, before=before)
        try:
            image = after.whole()
            deviation, result = self.against(image)
        except CubeError as error:
            failure = f"Deviations cannot be shown: {error}"
            return Channel(after=after, before=before, compared=failure)
        after = MemoryPicture(_with_deviation(image, deviation))
        return Channel(after=after, before=before, compared=result)

    def _raw(self) -> xr.Dataset:
        if self._kept is None:
            assert self._samples is not None
            self._kept = rejection.keep_water(self._samples)
        return self._kept

    def _imaged(self, target: xr.Dataset, name: str) -> Picture:
        image = pipeline.run(target, polarization=name, interval=self._interval)
        return MemoryPicture(image)

    def one_row(self, channel: str, row: int) -> xr.Dataset | None:
        """Beams of one row, with its water signal if known; None without samples."""
        if self._samples is None or channel not in self._samples.amulor.polarizations:
            return None
        cube = self._samples
        if self._target is not None and channel in self._target.amulor.polarizations:
            cube = self._target
        names = [
            name for name in ("water_in_phase", "water_quadrature") if name in cube
        ]
        at = cube.amulor.polarizations.index(channel)
        # With unknown water, the samples contain the beams.
        part = cube[names or ["in_phase"]].isel(row=[row])
        part = part.isel(polarization=at, drop=True)
        return part if names else part.drop_vars("in_phase")

    @property
    def cubes(self) -> dict[str, xr.Dataset | None]:
        """Cubes before and after water rejection; None for a missing cube."""
        return {"before": self._samples, "after": self._target}

    @property
    def has_spectrum(self) -> bool:
        """Whether signals at each modulation frequency are available."""
        return self._samples is not None or self._target is not None

    def stride(self, channel: str) -> int:
        """Step in rows and columns at which the page draws pixels."""
        rows, columns = self.channel(channel).shown.shape
        stride = 1
        while (
            -(-rows // stride) * -(-columns // stride) > MOST_PIXELS
            or max(rows, columns) > LONGEST_SIDE * stride
        ):
            stride += 1
        return stride

    def layers(self, channel: str) -> dict[str, tuple[Layer, Picture, str]]:
        """Return the maps of a channel by name: layer, image and variable."""
        pictures = self.channel(channel)
        layers: dict[str, tuple[Layer, Picture, str]] = {}
        for picture, before in ((pictures.after, False), (pictures.before, True)):
            if picture is None:
                continue
            unknown = bool(picture.error_unknown)
            for variable, layer in MAPS.items():
                if not picture.has(variable) or (before and variable not in BEFORE):
                    continue
                if layer.is_error and unknown:
                    continue
                name = f"{layer.name}_before" if before else layer.name
                layers[name] = (
                    replace(layer, name=name, before=before),
                    picture,
                    variable,
                )
            name = f"{STEPS.name}_before" if before else STEPS.name
            layers[name] = (replace(STEPS, name=name, before=before), picture, "")
        return layers

    def layer(self, channel: str, name: str, stride: int) -> NDArray[Any]:
        """Values of one map at every `stride`-th row and column."""
        layers = self.layers(channel)
        if name not in layers:
            raise CubeError(f"{self.name} has no map {name!r} in channel {channel}")
        _, picture, variable = layers[name]
        return picture.values(variable, stride) if variable else _steps(picture, stride)

    def nodes(self, channel: str) -> Nodes:
        """Beams of a channel on a coarse grid of pixels."""
        if channel not in self._nodes:
            self._nodes[channel] = self._nodes_of(channel)
        return self._nodes[channel]

    def _nodes_of(self, channel: str) -> Nodes:
        picture = self.channel(channel).shown
        stride = self.stride(channel)
        ranges = picture.values("slant_range", stride)
        finite = ranges[np.isfinite(ranges)]
        return nodes_of(
            picture.beams(),
            picture.shape,
            farthest=float(finite.max()) if finite.size else 1.0,
            stride=stride,
        )

    def describe(self, channel: str | None = None) -> dict[str, Any]:
        """Return the description of the file, which the page needs before any map."""
        channel = channel or self.channels[0]
        pictures = self.channel(channel)
        picture = pictures.shown
        attributes = picture.attributes
        rows, columns = picture.shape
        nodes = self.nodes(channel)
        return {
            "name": self.name,
            "title": str(attributes.get("title", self.name)),
            "simulated": bool(attributes.get("simulated", 0)),
            "channel": channel,
            "channels": self.channels,
            "rows": rows,
            "columns": columns,
            "stride": self.stride(channel),
            "layers": [described(layer) for layer, *_ in self.layers(channel).values()],
            "flags": flag_words(),
            "frequencies": np.atleast_1d(
                attributes.get("modulation_frequencies", [])
            ).tolist(),
            "group_index": float(picture.geometry["group_index"]),
            "nodes": {"rows": nodes.rows.tolist(), "columns": nodes.columns.tolist()},
            "sharing": sharing_of(picture),
            "line_window": int(attributes.get("phasor_line_window", 0)),
            "error_unknown": picture.error_unknown,
            "water_in": pictures.after is not None and _water_in(picture),
            "spectrum": self.has_spectrum,
            "history": str(attributes.get("history", "")),
            "version": software_versions()["amulor"],
            "notes": [*self.notes, *_notes(pictures)],
        }


def _with_deviation(image: xr.Dataset, deviation: Deviation) -> xr.Dataset:
    """Range image with the deviations of its pixels and their uncertainties [m]."""
    values = {
        "deviation": deviation.value,
        "deviation_significant": np.where(
            deviation.significant, deviation.value, np.nan
        ),
        "deviation_uncertainty": deviation.uncertainty,
    }
    maps = {}
    for name, of_vertices in values.items():
        pixels = np.full(image["slant_range"].size, np.nan)
        pixels[deviation.surface.pixel] = of_vertices
        shape = image["slant_range"].shape
        maps[name] = (image["slant_range"].dims, pixels.reshape(shape))
    return image.assign(maps)


def _water_in(picture: Picture) -> bool:
    """Whether the ranges of an image still contain the water signal."""
    return WATER_NOT_REMOVED in picture.error_unknown


def _steps(picture: Picture, stride: int) -> NDArray[Any]:
    """Range steps: 1 for a step to the next column, 2 to the next row, 3 for both."""
    names = ["slant_range", "slant_range_uncertainty", "slant_range_common_uncertainty"]
    names += ["slant_range_bound", *(f"{RANGE_PREFIX}{term}" for term in TERMS)]
    maps = {
        name: (("row", "column"), picture.values(name, stride).astype(float))
        for name in names
        if picture.has(name)
    }
    image = xr.Dataset(maps)
    out = np.zeros(image["slant_range"].shape)
    for first in range(0, len(out), _BAND):
        low = max(first - STEP_MARGIN, 0)
        part = image.isel(row=slice(low, first + _BAND + STEP_MARGIN))
        across, down = steps(part["slant_range"].values, own_variance(part))
        band = (across + 2 * down)[first - low : first - low + _BAND]
        out[first : first + _BAND] = band
    return out


def _notes(pictures: Channel) -> list[str]:
    notes = [f"{pictures.compared}."] if pictures.compared else []
    if pictures.before is None and not _water_in(pictures.shown):
        notes.append(
            "A range image alone does not hold the picture before rejection; name the "
            "cube it was made from by --samples, or open the target signal."
        )
    words = pictures.shown.error_unknown
    if words:
        notes.insert(0, f"{words[0].upper()}{words[1:]}.")
        return notes
    unknown = str(pictures.shown.attributes.get("uncertainty_unknown", ""))
    if unknown:
        listed = ", ".join(word.replace("_", " ") for word in unknown.split())
        notes.append(f"Not in the uncertainty, because nobody knows it: {listed}.")
    return notes


def opened(
    path: Path, *, samples: Path | None = None, interval: Interval = None
) -> Recording:
    """Open a data file for the browser page."""
    if is_large(path, variables=["slant_range"]):
        recording = Recording(path.name, image=large_picture(path), interval=interval)
    else:
        recording = recording_of(
            read_cube(path),
            name=path.name,
            samples=None if samples is None else read_cube(samples),
            interval=interval,
        )
    recording.path = path
    return recording


def recording_of(
    cube: xr.Dataset,
    *,
    name: str = "cube",
    samples: xr.Dataset | None = None,
    interval: Interval = None,
) -> Recording:
    """Content of the browser page for a cube in memory."""
    level = str(cube.attrs.get("level"))
    if level == "range_image":
        recording = Recording(name, image=cube, interval=interval)
        if samples is not None:
            axes = ("row", "column")
            if any(samples.sizes.get(axis) != cube.sizes[axis] for axis in axes):
                raise CubeError(
                    f"the samples have {dict(samples.sizes)}, {name} has "
                    f"{dict(cube.sizes)}; name the cube that the image was made from"
                )
            raw, target = _levels(samples, recording.notes)
            return Recording(
                name, image=cube, target=target, samples=raw, interval=interval
            )
        return recording
    if level not in ("samples", "target_signal"):
        raise CubeError(
            f"{name} is of level {level!r}; the page shows samples, target_signal and "
            "range_image"
        )
    notes: list[str] = []
    raw, target = _levels(cube, notes)
    return Recording(name, target=target, samples=raw, interval=interval, notes=notes)


def _levels(cube: xr.Dataset, notes: list[str]) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return the samples with water, and the target signal if it can be computed."""
    if cube.attrs["level"] == "target_signal":
        return _with_water(cube), cube
    if cube.amulor.open_water is None:
        notes.append(
            "No open-water shots in this file: the water is still in the ranges."
        )
        return cube, None
    try:
        return cube, _rejected(cube)
    except AmulorError as error:
        notes.append(f"The water could not be removed: {error}.")
        return cube, None


def _rejected(cube: xr.Dataset) -> xr.Dataset:
    """Subtract open water from a scan whose channels may be incomplete.

    Channels are processed one by one, because a target that one channel has not yet
    measured would count as open water in all.
    """
    finite = np.isfinite(cube["in_phase"].values).all(axis=0)
    if bool((finite == finite[:1]).all()):
        return rejection.open_water(cube)
    begun = [
        name
        for name, measured in zip(cube.amulor.polarizations, finite, strict=True)
        if measured.any()
    ]
    parts = [rejection.open_water(cube.sel(polarization=[name])) for name in begun]
    return xr.concat(
        parts,
        dim="polarization",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )


def _with_water(target: xr.Dataset) -> xr.Dataset:
    """Return the samples of a target signal, with the water signal added back."""
    names = [
        str(name)
        for name in cubes.LEVELS["samples"].variables
        if name in target and name not in ("in_phase", "quadrature")
    ]
    samples = without_groups(target)[names].assign(
        {
            name: (target[name] + target[f"water_{name}"]).assign_attrs(
                target[name].attrs
            )
            for name in ("in_phase", "quadrature")
        }
    )
    return samples.assign_attrs({**target.attrs, "level": "samples"})
