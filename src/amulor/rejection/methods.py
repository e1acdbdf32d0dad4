"""Register of rejection methods, each declared beside its function.

A method is a function from samples to a target signal under the decorator `method`, and
an entry point of the group `amulor.rejection`, in amulor itself or in another package.
The command line, `auto`, work by rows and sites take it from here.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from typing import Any, TypeVar, cast

import xarray as xr

from amulor import _plugins
from amulor import cube as cubes
from amulor.cube import tiles
from amulor.errors import AmulorError, CubeError
from amulor.rejection.reference.instrument import without_drift

__all__ = ["Method", "Needs", "load", "method", "names", "reject"]

_Function = TypeVar("_Function", bound=Callable[..., xr.Dataset])


@dataclass(frozen=True, kw_only=True)
class Needs:
    """Additional measurements that a rejection method requires.

    Examples
    --------
    >>> from amulor import rejection
    >>> rejection.load("combined").needs
    Needs(open_water=True, channel_pair=True)
    """

    open_water: bool | None = None
    """Open-water reference measurements: True if required, False if the method is for
    scans without them only, None if optional."""
    channel_pair: bool = False
    """Whether a co-polarized channel and its cross-polarized partner are required."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """Rejection method: its function, its requirements, and its fit to a scan.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> frequency = rejection.load("frequency")
    >>> frequency.options
    ('modulation_frequency', 'interval')
    """

    name: str
    """Name on the command line, in site files, in comparisons and for `reject`."""
    function: Callable[..., xr.Dataset]
    """Function from a cube of level `samples` to one of level `target_signal`; its
    keyword-only arguments are the options."""
    needs: Needs = Needs()
    """Measurements required by the method."""
    simplicity: int | None = None
    """Rank in a comparison, the simplest method first; None excludes it from `auto`."""
    keeps_one_frequency: bool = False
    """Whether the result has a single modulation frequency, with a short ambiguity
    interval."""
    distrusts_open_water: bool = False
    """Whether `auto` repeats the method without the reference measurements if few
    pixels are trusted."""
    unsuited: Callable[[xr.Dataset, tuple[float, float] | None], str] | None = None
    """Function of samples and interval that returns the reason why a comparison leaves
    the method out, empty if it takes part; None for a method that always does."""
    refine: Callable[[xr.Dataset], xr.Dataset] | None = None
    """Function that improves the target signal of another method, the option `base`;
    a comparison tries it on the best method."""
    remark: str = ""
    """Property of the result that a comparison states if it recommends the method."""
    fitter: Callable[..., tiles.OfRows] | None = None
    """Fit of the method to a source of rows, called with the options; None for a method
    whose result at a pixel depends on the samples of its row and on the reference
    measurements only."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options of the function."""
        return tuple(
            parameter.name
            for parameter in inspect.signature(self.function).parameters.values()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        )

    def __call__(self, cube: xr.Dataset, **options: Any) -> xr.Dataset:
        """Run the method on a whole cube.

        Parameters
        ----------
        cube : xarray.Dataset
            Level `samples`.
        **options
            Options of the method, as in `unknown`; None keeps the default.

        Returns
        -------
        xarray.Dataset
            Level `target_signal`.

        Raises
        ------
        AmulorError, ValueError
            As the method; ValueError for an option that it does not have.
        """
        return self.function(cube, **self._accepted(options))

    def fit(self, source: tiles.Source, **options: Any) -> tiles.OfRows:
        """Fit the method to a scan; return a function for the target signal of rows.

        Parameters
        ----------
        source : Source
            The scan.
        **options
            Options of the method, as in a call.

        Returns
        -------
        callable
            Function of some rows of the scan and the number of their first row. It
            returns their target signal, bit for bit as in processing the whole scan.

        Raises
        ------
        AmulorError, ValueError
            As in a call of the method.
        """
        accepted = self._accepted(options)
        if self.fitter is None:
            return lambda rows, first: self.function(rows, **accepted)
        of = self.fitter(tiles.Changed(source, without_drift), **accepted)
        return lambda rows, first: of(without_drift(rows), first)

    def without_open_water(self) -> Method:
        """Return a copy of the method that ignores open-water reference measurements.

        Returns
        -------
        Method
            Method whose name ends in "without shots".
        """
        fit = self.fit

        def run(cube: xr.Dataset, **options: Any) -> xr.Dataset:
            return self.function(_bare(cube), **options)

        def fitter(source: tiles.Source, **options: Any) -> tiles.OfRows:
            of = fit(tiles.Changed(source, _bare), **options)
            return lambda rows, first: of(_bare(rows), first)

        run.__signature__ = inspect.signature(self.function)  # type: ignore[attr-defined]
        return replace(
            self,
            name=f"{self.name}{_WITHOUT}",
            function=run,
            fitter=fitter,
            distrusts_open_water=False,
        )

    def of(self, base: str) -> Method:
        """Return a copy of a method with `refine` that starts from another method.

        Parameters
        ----------
        base : str
            Name of the other method.

        Returns
        -------
        Method
            Method whose name ends in "of" and the name of the other one.

        Examples
        --------
        >>> from amulor import rejection
        >>> rejection.load("smooth-surface").of("joint").name
        'smooth-surface of joint'
        """
        return replace(
            self,
            name=f"{self.name}{_OF}{base}",
            function=functools.partial(self.function, base=base),
            fitter=functools.partial(cast("Any", self.fitter), base=base),
            needs=load(base).needs,
        )

    def unknown(self, options: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the options that are not None and not supported by the method.

        Parameters
        ----------
        options : mapping of str to object
            Options by name. An option that is None counts as not stated. Every method
            accepts an interval, even if it uses none.

        Returns
        -------
        tuple of str
            Names of the options that the method lacks.
        """
        accepted = {*self.options, "interval"}
        return tuple(
            name
            for name, value in options.items()
            if value is not None and name not in accepted
        )

    def _accepted(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options that are not None; ValueError if one is unsupported."""
        if unknown := self.unknown(options):
            raise ValueError(
                f"the method {self.name} has no option {', '.join(unknown)}; it has "
                f"{', '.join(self.options) or 'none'}"
            )
        return {
            name: value
            for name, value in options.items()
            if value is not None and name in self.options
        }


_WITHOUT = " without shots"
_OF = " of "


def _bare(cube: xr.Dataset) -> xr.Dataset:
    """Correct the instrument drift, then remove the open-water references."""
    return cubes.without_groups(without_drift(cube), "open_water")


def method(name: str, **declared: Any) -> Callable[[_Function], _Function]:
    """Declare a function as a rejection method.

    Parameters
    ----------
    name : str
        Name of the method, equal to that of its entry point in the group
        `amulor.rejection`.
    **declared
        Fields of `Method`: `needs`, `simplicity`, `keeps_one_frequency`,
        `distrusts_open_water`, `unsuited`, `refine`, `remark`, `fitter`.

    Returns
    -------
    callable
        Decorator of the function. The drift of the phase that the open-water
        references show is removed from the samples before the function is called.

    Notes
    -----
    A scan that is larger than memory is processed some rows at a time. A method that
    uses a statistic of the whole scan, such as a median or a threshold, declares a
    `fitter`. The fitter is called once with the source of the rows and the options. It
    estimates the statistics, for instance from the cube
    `amulor.cube.tiles.sample_of(source)`, and returns a function of some rows and the
    number of their first row. Without a `fitter` the method is called with some rows at
    a time.

    Examples
    --------
    >>> from amulor import rejection
    >>> @rejection.method("nothing", simplicity=99)
    ... def nothing(cube):
    ...     return rejection.keep_water(cube)
    >>> nothing.declared.name
    'nothing'

    A method with a statistic of the scan, the median of its quadratures, and one that
    builds on another, whose fit it calls:

    >>> from amulor.cube import tiles
    >>> def less(cube, median):
    ...     kept = rejection.keep_water(cube)
    ...     return kept.assign(quadrature=kept["quadrature"] - median)
    >>> def fit_median(source):
    ...     median = float(tiles.sample_of(source)["quadrature"].median())
    ...     return lambda rows, first: less(rows, median)
    >>> @rejection.method("less-median", fitter=fit_median)
    ... def less_median(cube):
    ...     return less(cube, float(cube["quadrature"].median()))
    >>> def fit_half(source):
    ...     of = rejection.load("open-water").fit(source)
    ...     return lambda rows, first: of(rows, first) / 2
    >>> less_median.declared.name
    'less-median'
    """

    def declare(function: _Function) -> _Function:
        @functools.wraps(function)
        def of_steady(cube: xr.Dataset, **options: Any) -> xr.Dataset:
            return function(without_drift(cube), **options)

        of_steady.declared = Method(  # type: ignore[attr-defined]
            name=name, function=of_steady, **declared
        )
        return cast("_Function", of_steady)

    return declare


def names() -> tuple[str, ...]:
    """List the names of the installed rejection methods, without loading them.

    Returns
    -------
    tuple of str
        Names in alphabetical order, including methods of other packages.

    Examples
    --------
    >>> from amulor import rejection
    >>> [name for name in rejection.names() if "polar" in name]
    ['co-polarized', 'cross-polarized', 'polarization', 'polarization-difference']
    """
    return _plugins.names(_plugins.REJECTION)


def load(name: str) -> Method:
    """Load a rejection method.

    Parameters
    ----------
    name : str
        One of `names`. With " without shots" appended, the method ignores the
        open-water reference measurements. "smooth-surface of joint" is the method
        `smooth-surface` with the option `base` "joint".

    Returns
    -------
    Method
        Method as declared.

    Raises
    ------
    CubeError
        If there is no such method, or the package that offers it is broken.

    Examples
    --------
    >>> from amulor import rejection
    >>> rejection.load("open-water").options
    ('interval', 'column_uncertainty', 'put_back')
    """
    refining, of, base = name.partition(_OF)
    if of and (declared := load(refining)).refine is not None:
        return declared.of(base)
    plain = name.removesuffix(_WITHOUT)
    entries = metadata.entry_points(group=_plugins.REJECTION, name=plain)
    if not entries:
        raise CubeError(
            f"there is no rejection method {name!r}; installed are {', '.join(names())}"
        )
    (entry, *_) = entries
    declared = _declared(entry)
    return declared if plain == name else declared.without_open_water()


def _declared(entry: metadata.EntryPoint) -> Method:
    """Load the declaration of an entry point; CubeError if its package is broken."""
    try:
        declared = entry.load().declared
    except Exception as error:  # the program of another package
        raise CubeError(
            f"the rejection method {entry.name!r} of {entry.value} cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error
    if not isinstance(declared, Method) or declared.name != entry.name:
        raise CubeError(
            f"the entry point {entry.name!r} of the group {_plugins.REJECTION} names "
            f"{entry.value}, which is not declared as @method({entry.name!r})"
        )
    return declared


def reject(
    cube: xr.Dataset,
    *,
    method: str = "auto",
    interval: tuple[float, float] | None = None,
    **options: Any,
) -> xr.Dataset:
    """Remove the water signal from samples by the named rejection method.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.
    method : str
        One of `names`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    **options
        Options of the method.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`.

    Raises
    ------
    AmulorError, ValueError
        As raised by the method. CubeError for an unknown name, ValueError for an option
        that the method lacks.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> cube = samples.cube("ladder").isel(row=[18], shot=slice(0, None, 4))
    >>> target = rejection.reject(cube, method="open-water", interval=(0.5, 3.0))
    >>> print(f"{target.attrs['open_water_turbidity']:.2f} of the stated turbidity")
    0.99 of the stated turbidity
    """
    return load(method)(cube, interval=interval, **options)


def compared_methods() -> tuple[list[Method], dict[str, AmulorError]]:
    """Return the methods that `auto` compares, and the load errors of broken ones."""
    compared: list[Method] = []
    broken: dict[str, AmulorError] = {}
    # Listed once: each listing reads the metadata of all installed packages.
    entries = metadata.entry_points(group=_plugins.REJECTION)
    for name in sorted(entries.names):
        try:
            compared.append(_declared(entries[name]))
        except CubeError as error:
            broken[name] = error
    ranked = [
        candidate
        for candidate in compared
        if candidate.refine is not None or candidate.simplicity is not None
    ]
    ranked.sort(key=lambda candidate: (candidate.simplicity or 0, candidate.name))
    return ranked, broken
