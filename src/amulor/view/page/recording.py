"""What the page shows of one file: pictures of each channel, before and after."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import without_groups
from amulor.cube.terms import ALIKE_TERMS, WATER_TERMS
from amulor.errors import AmulorError, CubeError
from amulor.imaging.measure import reference_basis
from amulor.io import read_cube
from amulor.view.page import beams
from amulor.view.page.layers import BEFORE, MAPS, Layer, described, flag_words

Interval = tuple[float, float] | None

#: More pixels than these are drawn by strides [1].
MOST_PIXELS = 10_000_000
#: Textures of most graphics units reach this far along a side [1].
LONGEST_SIDE = 8192


class Picture(Protocol):
    """A range image that is read map by map."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of its geometry."""

    def has(self, variable: str) -> bool:
        """Return whether there is a variable."""

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Return every so many rows and columns of a variable."""

    def beams(self) -> beams.BeamReader:
        """Return what reads the beams."""

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Return an image that holds some pixels, and the scan they belong to."""

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Return where a pixel of the scan is in the image of `around`."""


@dataclass(frozen=True)
class MemoryPicture:
    """A range image in memory."""

    image: xr.Dataset
    """Level `range_image`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.image["slant_range"].shape
        return rows, columns

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the image."""
        return {str(key): value for key, value in self.image.attrs.items()}

    @property
    def geometry(self) -> dict[str, Any]:
        """Attributes of its geometry."""
        return dict(self.image["geometry"].attrs)

    def has(self, variable: str) -> bool:
        """Return whether there is a variable."""
        return variable in self.image

    def values(self, variable: str, stride: int) -> NDArray[Any]:
        """Return every so many rows and columns of a variable."""
        return np.asarray(self.image[variable].values[::stride, ::stride])

    def beams(self) -> beams.BeamReader:
        """Return what reads the beams."""
        return beams.reader_of(self.image)

    def around(self, rows: list[int], columns: list[int]) -> xr.Dataset:
        """Return the whole image."""
        return self.image

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Return the pixel itself."""
        return row, column


@dataclass(frozen=True, kw_only=True)
class Channel:
    """The pictures of one channel."""

    after: Picture | None
    """Water taken out, if it was."""
    before: Picture | None
    """Water left in, if it is known."""

    @property
    def shown(self) -> Picture:
        """The picture that measuring takes: the corrected one where there is one."""
        picture = self.after or self.before
        assert picture is not None
        return picture


class Recording:
    """A file as the page sees it; pictures are made when they are asked for.

    Parameters
    ----------
    name : str
        Name of the file.
    image : xarray.Dataset or Picture, optional
        A range image that is there already.
    target : xarray.Dataset, optional
        Level `target_signal`.
    samples : xarray.Dataset, optional
        Level `samples`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    notes : list of str, optional
        What the page says of the file.
    """

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
        self.notes = [] if notes is None else notes
        self._given: Picture | None = (
            MemoryPicture(image) if isinstance(image, xr.Dataset) else image
        )
        self._target, self._samples = target, samples
        self._interval = interval
        self._channels: dict[str, Channel] = {}
        self._kept: xr.Dataset | None = None
        self._nodes: dict[str, beams.Nodes] = {}
        self._lock = threading.Lock()

    @property
    def channels(self) -> list[str]:
        """Names of the polarization channels."""
        for cube in (self._target, self._samples):
            if cube is not None:
                known: list[str] = cube.amulor.polarizations
                break
        else:
            known = []
        if self._given is not None:
            own = str(self._given.attributes.get("polarization", "none"))
            return [own]
        return known

    @property
    def samples(self) -> xr.Dataset | None:
        """Level `samples`, if it is known."""
        return self._samples

    def channel(self, name: str | None = None) -> Channel:
        """Return the pictures of a channel, the first one if none is named."""
        wanted = self.channels[0] if name is None else name
        if wanted not in self.channels:
            raise CubeError(
                f"{self.name} has no channel {wanted!r}, only "
                f"{', '.join(self.channels)}"
            )
        with self._lock:
            if wanted not in self._channels:
                self._channels[wanted] = self._made(wanted)
            return self._channels[wanted]

    def _made(self, name: str) -> Channel:
        before = None if self._samples is None else self._imaged(self._raw(), name)
        after = self._given
        if after is None and self._target is not None:
            after = self._imaged(self._target, name)
        if after is None and before is None:
            raise CubeError(f"{self.name} holds nothing that can be shown as a picture")
        return Channel(after=after, before=before)

    def _raw(self) -> xr.Dataset:
        if self._kept is None:
            assert self._samples is not None
            self._kept = rejection.keep_water(self._samples)
        return self._kept

    def _imaged(self, target: xr.Dataset, name: str) -> Picture:
        image = imaging.range_image(target, polarization=name, interval=self._interval)
        return MemoryPicture(imaging.flag_outliers(imaging.flag_mixed(image)))

    def one_row(self, channel: str, row: int) -> xr.Dataset | None:
        """Return water signal and beams of one row.

        Parameters
        ----------
        channel : str
            Polarization channel.
        row : int
            Row of the scan.

        Returns
        -------
        xarray.Dataset or None
            Without dimension polarization; `water_in_phase` and `water_quadrature` if
            the water is known. None without samples.
        """
        if self._samples is None or channel not in self._samples.amulor.polarizations:
            return None
        cube = self._samples
        if self._target is not None and channel in self._target.amulor.polarizations:
            cube = self._target
        names = [
            name for name in ("water_in_phase", "water_quadrature") if name in cube
        ]
        at = cube.amulor.polarizations.index(channel)
        # The samples carry the beams along where the water is not known.
        part = cube[names or ["in_phase"]].isel(row=[row])
        part = part.isel(polarization=at, drop=True)
        return part if names else part.drop_vars("in_phase")

    def spectrum(self, channel: str, row: int, column: int) -> dict[str, Any] | None:
        """Return amplitude and phase of a pixel over the modulation frequency.

        Parameters
        ----------
        channel : str
            Polarization channel.
        row, column : int
            Pixel.

        Returns
        -------
        dict or None
            `frequency` [Hz] and, for each of `before`, `after` and `water` that is
            known, `amplitude` and `uncertainty` [V] and `phase` [rad].
        """
        parts: dict[str, Any] = {}
        frequency: NDArray[np.float64] | None = None
        for name, cube in (("before", self._samples), ("after", self._target)):
            if cube is None or channel not in cube.amulor.polarizations:
                continue
            one = cube.sel(polarization=channel).isel(row=row, column=column)
            frequency = np.atleast_1d(cube["modulation_frequency"].values)
            signal = one["in_phase"].values + 1j * one["quadrature"].values
            error = np.hypot(
                one["in_phase_uncertainty"].values,
                one["quadrature_uncertainty"].values,
            )
            parts[name] = _line(signal, error / math.sqrt(2))
            if name == "after":
                water = (
                    one["water_in_phase"].values + 1j * one["water_quadrature"].values
                )
                parts["water"] = _line(water, None)
        if frequency is None:
            return None
        return {"frequency": frequency.tolist(), **parts}

    def spectra(self, channel: str, *, most: int) -> dict[str, NDArray[np.float32]]:
        """Return all spectra of a channel for a page that has no server.

        Parameters
        ----------
        channel : str
            Polarization channel.
        most : int
            Empty if there are more numbers than this [1].

        Returns
        -------
        dict
            `before` and `after` as far as they are known, arrays over (part,
            frequency, row, column) with in phase, quadrature and uncertainty [V].
        """
        found = {}
        for name, cube in (("before", self._samples), ("after", self._target)):
            if cube is None or channel not in cube.amulor.polarizations:
                continue
            one = cube.sel(polarization=channel)
            if 6 * one["in_phase"].size > most:
                return {}
            error = np.hypot(
                one["in_phase_uncertainty"].values,
                one["quadrature_uncertainty"].values,
            )
            parts = one["in_phase"].values, one["quadrature"].values, error / 2**0.5
            found[name] = np.stack(parts).astype("<f4")
        return found

    @property
    def has_spectrum(self) -> bool:
        """Whether samples are known, not only ranges."""
        return self._samples is not None or self._target is not None

    def stride(self, channel: str) -> int:
        """Return of how many rows and columns one is drawn."""
        rows, columns = self.channel(channel).shown.shape
        stride = 1
        while (
            -(-rows // stride) * -(-columns // stride) > MOST_PIXELS
            or max(rows, columns) > LONGEST_SIDE * stride
        ):
            stride += 1
        return stride

    def layers(self, channel: str) -> dict[str, tuple[Layer, Picture, str]]:
        """Return the maps of a channel: layer, picture and variable of each name."""
        pictures = self.channel(channel)
        found: dict[str, tuple[Layer, Picture, str]] = {}
        for picture, before in ((pictures.after, False), (pictures.before, True)):
            if picture is None:
                continue
            for variable, layer in MAPS.items():
                if not picture.has(variable) or (before and variable not in BEFORE):
                    continue
                name = f"{layer.name}_before" if before else layer.name
                found[name] = (
                    replace(layer, name=name, before=before),
                    picture,
                    variable,
                )
        return found

    def layer(self, channel: str, name: str, stride: int) -> NDArray[Any]:
        """Return one map, every so many rows and columns."""
        known = self.layers(channel)
        if name not in known:
            raise CubeError(f"{self.name} has no map {name!r} in channel {channel}")
        _, picture, variable = known[name]
        return picture.values(variable, stride)

    def nodes(self, channel: str) -> beams.Nodes:
        """Return the beams of a channel on a coarse grid."""
        if channel not in self._nodes:
            self._nodes[channel] = self._nodes_of(channel)
        return self._nodes[channel]

    def _nodes_of(self, channel: str) -> beams.Nodes:
        picture = self.channel(channel).shown
        stride = self.stride(channel)
        ranges = picture.values("slant_range", stride)
        finite = ranges[np.isfinite(ranges)]
        return beams.nodes_of(
            picture.beams(),
            picture.shape,
            farthest=float(finite.max()) if finite.size else 1.0,
            stride=stride,
        )

    def describe(self, channel: str | None = None) -> dict[str, Any]:
        """Return all that the page needs to know before it asks for maps."""
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
            "spectrum": self.has_spectrum,
            "history": str(attributes.get("history", "")),
            "notes": [*self.notes, *_notes(pictures)],
        }


def opened(
    path: Path, *, samples: Path | None = None, interval: Interval = None
) -> Recording:
    """Open a file for the page.

    Parameters
    ----------
    path : pathlib.Path
        Cube of level `samples`, `target_signal` or `range_image`.
    samples : pathlib.Path, optional
        Samples or target signal that a range image was made from; with them the page
        shows the picture before rejection, and spectra.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Recording
        Pictures are made when they are asked for.

    Raises
    ------
    FormatError
        If a file is damaged or is none of these.
    CubeError
        If what it holds cannot be shown.
    """
    from amulor.view.page.large import is_large, large_picture

    if is_large(path):
        return Recording(path.name, image=large_picture(path), interval=interval)
    cube = read_cube(path)
    if samples is None:
        return recording_of(cube, name=path.name, interval=interval)
    beside = read_cube(samples)
    return recording_of(cube, name=path.name, samples=beside, interval=interval)


def recording_of(
    cube: xr.Dataset,
    *,
    name: str = "cube",
    samples: xr.Dataset | None = None,
    interval: Interval = None,
) -> Recording:
    """Return a cube in memory as the page sees it.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, `target_signal` or `range_image`.
    name : str
        What the page calls it.
    samples : xarray.Dataset, optional
        Samples or target signal that a range image was made from.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Recording
        Its pictures.

    Raises
    ------
    CubeError
        If the cube has another level, or the two are not of one scan.
    """
    level = str(cube.attrs.get("level"))
    if level == "range_image":
        found = Recording(name, image=cube, interval=interval)
        if samples is not None:
            own = ("row", "column")
            if any(samples.sizes.get(axis) != cube.sizes[axis] for axis in own):
                raise CubeError(
                    f"the samples have {dict(samples.sizes)}, {name} has "
                    f"{dict(cube.sizes)}; name the cube that the image was made from"
                )
            raw, target = _levels(samples, found.notes)
            return Recording(
                name, image=cube, target=target, samples=raw, interval=interval
            )
        return found
    if level not in ("samples", "target_signal"):
        raise CubeError(
            f"{name} is of level {level!r}; the page shows samples, target_signal and "
            "range_image"
        )
    notes: list[str] = []
    raw, target = _levels(cube, notes)
    return Recording(name, target=target, samples=raw, interval=interval, notes=notes)


def _levels(cube: xr.Dataset, notes: list[str]) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return samples with the water in them, and the target signal if there is one."""
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
        notes.append(f"The water could not be taken out: {error}.")
        return cube, None


def _rejected(cube: xr.Dataset) -> xr.Dataset:
    """Return samples less their open water, of a scan that goes on channel by channel.

    A target that one channel has not seen yet would count as none at all.
    """
    there = np.isfinite(cube["in_phase"].values).all(axis=0)
    if bool((there == there[:1]).all()):
        return rejection.open_water(cube)
    begun = [
        name
        for name, seen in zip(cube.amulor.polarizations, there, strict=True)
        if seen.any()
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
    """Return the samples that a target signal was, water and target together."""
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


def sharing_of(picture: Picture) -> dict[str, Any] | None:
    """Return how errors of two pixels correlate, for the page to work it out alone.

    Parameters
    ----------
    picture : Picture
        A range image.

    Returns
    -------
    dict or None
        `alike` and `of_water`, names of the maps of terms; `scale`, means and factors
        of azimuth and elevation; `powers` of their monomials, and `matrix` that turns
        those into the basis of the reference. None if the image knows no shared part.
    """
    if not picture.has("slant_range_common_uncertainty"):
        return None
    names = {
        kind: [
            MAPS[f"slant_range_uncertainty_{term}"].name
            for term in terms
            if picture.has(f"slant_range_uncertainty_{term}")
        ]
        for kind, terms in (
            ("alike", ALIKE_TERMS),
            ("of_water", WATER_TERMS),
        )
    }
    basis: dict[str, Any] = {}
    if "open_water_degree" in picture.attributes:
        thin = max(1, int(np.sqrt(picture.shape[0] * picture.shape[1] / 250_000)))
        angles = [picture.values(name, thin) for name in ("azimuth", "elevation")]
        degree = int(np.max(picture.attributes["open_water_degree"]))
        basis = reference_basis(*angles, degree=degree)
    return {**names, **basis}


def _line(
    signal: NDArray[np.complex128], error: NDArray[np.float64] | None
) -> dict[str, Any]:
    """Return amplitude and phase of a spectrum as lists."""
    signal = np.atleast_1d(signal)
    line = {"amplitude": np.abs(signal), "phase": np.angle(signal)}
    if error is not None:
        line["uncertainty"] = np.atleast_1d(error)
    return {name: _listed(values) for name, values in line.items()}


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _notes(pictures: Channel) -> list[str]:
    notes = []
    if pictures.before is None:
        notes.append(
            "A range image alone does not hold the picture before rejection; name the "
            "cube it was made from by --samples, or open the target signal."
        )
    reason = pictures.shown.attributes.get("interval_unsettled", "")
    if reason:
        notes.append(f"Ranges may be off by whole intervals: {reason}.")
    unknown = str(pictures.shown.attributes.get("uncertainty_unknown", ""))
    if unknown:
        listed = ", ".join(word.replace("_", " ") for word in unknown.split())
        notes.append(f"Not in the uncertainty, because nobody knows it: {listed}.")
    return notes
