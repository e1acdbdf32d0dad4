"""Predicted range errors for any instrument, water, target and distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.design import _kernels as kernel
from amulor.design.axes import Arranged, arranged
from amulor.design.candidates import first_choice, survey_of
from amulor.design.goal import Goal
from amulor.design.light import Case, case_of
from amulor.design.numbers import MOST_BENT, Assessed, assessed
from amulor.errors import SurveyError
from amulor.survey import Survey, water_properties
from amulor.survey.reach import target_reach

__all__ = ["TERMS", "WATERS", "Reach", "evaluate", "reach", "scheme_of"]


Floats = NDArray[np.float64]

#: Names of the terms that may bind, in the order of their codes in `binding_term`.
TERMS = (
    "shot",
    "dark",
    "daylight",
    "phase_floor",
    "water_left_in",
    "ambiguity",
    "footprint",
    "saturation",
    "fluctuation",
    "reference",
)
_MEANINGS = {
    "total_error": ("root of squared standard uncertainty and residual bias", "m"),
    "standard_uncertainty": ("random error of one pixel's range", "m"),
    "residual_bias": ("systematic error that is left in the range", "m"),
    "wrong_interval_probability": ("probability of another ambiguity interval", "1"),
    "signal": ("target signal, largest of the frequencies", "V"),
    "binding_term": ("largest term, or what makes the range unusable", "1"),
    "shot": ("counting noise of the laser's light", "m"),
    "dark": ("counting noise of dark counts", "m"),
    "daylight": ("counting noise of daylight", "m"),
    "phase_floor": ("phase error that no light removes", "m"),
    "water_left_in": ("water signal and late light that stay in the range", "m"),
    "ambiguity": ("root mean square error by wrong intervals", "m"),
    "footprint": ("uneven light of the beam's spot on a slope", "m"),
    "saturation": ("mean output over the largest linear one", "1"),
    "fluctuation": ("random change of the water signal", "m"),
    "reference": ("noise of the open-water shots, and of what they tell", "m"),
    "late_light": ("part of water_left_in by late light", "m"),
    "ambiguous": ("1 where the phases do not settle the interval", "1"),
    "saturated": ("1 where the detector leaves its linear range", "1"),
    "model_not_valid": ("1 where model or first-order errors do not hold", "1"),
    "ambiguity_interval": ("range after which all phases repeat", "m"),
}
#: Largest inclination of a surface for the echo models [rad].
_STEEPEST = 0.5


def evaluate(
    described: Survey | Goal,
    *,
    frequencies: Sequence[Sequence[float]] | None = None,
    polarization: str | Sequence[str] | None = None,
    method: str | Sequence[str] | None = None,
    interval: tuple[float, float] | None = None,
    wrong_interval: float = 0.01,
    late_light: bool = True,
    **axes: Any,
) -> xr.Dataset:
    r"""Predict the range errors for all combinations of parameter values.

    Parameters
    ----------
    described : Survey or Goal
        Instrument, water and target, as a survey, or as a goal. Axes replace values of
        it. Of a goal, the first value of each choice and the middle of each range are
        used.
    frequencies : sequence of sequences of float, optional
        Sets of modulation frequencies, along the dimension `frequency_set` [Hz]. By
        default the frequencies of the survey, as one set. For instruments with one
        frequency each, use the axis `frequency` instead.
    polarization : str or sequence of str, optional
        Recorded channels, joined by a plus sign: "VH", "VV+VH"; several along the
        dimension `polarization`. By default those of the survey.
    method : str or sequence of str, optional
        Rejection method by its name in `amulor reject`: "none", "frequency",
        "open-water", "polarization", "combined", "joint"; several along the dimension
        `method`. By default "open-water".
    interval : tuple of float, optional
        Nearest and farthest possible slant range [m]; by default from 0 to the distance
        at which the phases repeat.
    wrong_interval : float
        Probability of a wrong interval above which a range is flagged `ambiguous` [1].
    late_light : bool
        Whether light delayed by scattering is included, as in real water. Simulations
        do not include it by default.
    **axes : array_like
        Values by the names in `amulor.design.AXES`, in SI units: a number, an array
        that becomes a dimension of that name, or an `xarray.DataArray` with its own
        dimensions. `distance` is needed unless the survey has targets.

    Returns
    -------
    xarray.Dataset
        Over every axis: `total_error`, `standard_uncertainty`, `residual_bias` [m],
        `wrong_interval_probability` [1], `signal` [V], `binding_term` (a code, its
        meaning in the attribute `flag_meanings`), each term of `TERMS` [m] but
        `saturation`, which is output over limit [1], and the flags `ambiguous`,
        `saturated`, `model_not_valid`.

    Raises
    ------
    SurveyError
        If an axis is not known, a value is outside of its range, channels do not fit
        a method, or the water cannot be used.

    Notes
    -----
    The standard uncertainty is the inverse root of the Fisher information on the range
    of one pixel. A Schur complement eliminates the amplitudes, and for "joint" the
    parameters of the water. Its square is the sum of the squared random terms. Noise is
    that of `amulor.simulate`. The residual bias is the root of the summed squares of
    `water_left_in` and `footprint`. Echo and water signal follow from the small-angle
    model with the whole phase function, the default of simulations.

    Examples
    --------
    >>> survey = amulor.Survey.from_toml("plate.toml")  # doctest: +SKIP
    >>> found = evaluate(
    ...     survey, distance=[1.0, 2.0], frequency=[39e6, 138e6]
    ... )  # doctest: +SKIP
    """
    survey = (
        described
        if isinstance(described, Survey)
        else survey_of(described, first_choice(described))
    )
    case = case_of(survey, water_properties(survey))
    if "distance" not in axes:
        axes["distance"] = _distance_of(survey)
    arrays = arranged(axes, frequencies)
    sets = _frequency_sets(survey, arrays)
    numeric = {name: v for name, v in arrays.values.items() if name != "frequency"}
    schemes, several_schemes = _several(
        polarization, "+".join(survey.instrument.polarizations)
    )
    methods, several_methods = _several(method, "open-water")
    parts = [
        [
            assessed(
                case,
                numeric,
                frequencies=sets,
                method=name_of_method,
                pairs=scheme_of(scheme),
                interval=interval,
                late=late_light,
            )
            for scheme in schemes
        ]
        for name_of_method in methods
    ]
    dims, shape = list(arrays.sizes), arrays.shape
    coordinates = dict(arrays.coordinates)
    if several_schemes:
        coordinates["polarization"] = ("polarization", schemes)
    if several_methods:
        coordinates["method"] = ("method", methods)
    lead = ["method"] * several_methods + ["polarization"] * several_schemes
    variables = {}
    tables = [
        [_variables(errors, shape, arrays, case, wrong_interval) for errors in row]
        for row in parts
    ]
    for name in tables[0][0]:
        stacked = np.stack(
            [
                np.stack([name_of_method[name] for name_of_method in row])
                for row in tables
            ]
        )
        if not several_schemes:
            stacked = stacked[:, 0]
        if not several_methods:
            stacked = stacked[0]
        meaning, unit = _MEANINGS[name]
        attributes: dict[str, Any] = {"long_name": meaning, "units": unit}
        if name == "binding_term":
            attributes["flag_values"] = np.arange(len(TERMS), dtype=np.int8)
            attributes["flag_meanings"] = " ".join(TERMS)
        variables[name] = ([*lead, *dims], stacked, attributes)
    return xr.Dataset(
        variables,
        coords=coordinates,
        attrs={"title": survey.name, "source": "amulor.design.evaluate"},
    )


def scheme_of(text: str) -> tuple[str, ...]:
    """Return the channels of a polarization scheme such as "VV+VH".

    Examples
    --------
    >>> scheme_of("VV+VH")
    ('VV', 'VH')
    """
    from amulor.optics.polarization.stokes import pair_states

    pairs = tuple(part.strip() for part in text.split("+"))
    for pair in pairs:
        try:
            if pair != "none":
                pair_states(pair)
        except ValueError as error:
            raise SurveyError(f"polarization: {error}") from None
    return pairs


def _several(names: str | Sequence[str] | None, default: str) -> tuple[list[str], bool]:
    """Return names as a list, and whether the argument is a sequence of names."""
    if names is None:
        return [default], False
    if isinstance(names, str):
        return [names], False
    if not names:
        raise SurveyError("polarization and method: at least one is needed")
    return list(names), True


def _distance_of(survey: Survey) -> float:
    """Midpoint of nearest and farthest target distance in a survey [m]."""
    reach = target_reach(survey)
    if reach is None:
        raise SurveyError(
            "distance: is missing, and the survey does not say how far its targets "
            "are; state it, in meters"
        )
    return (reach[0] + reach[1]) / 2


def _frequency_sets(survey: Survey, arrays: Arranged) -> Floats:
    """Return the sets of modulation frequencies, K per set, shape (K, ...) [Hz]."""
    if arrays.frequencies is not None:
        return arrays.frequencies
    if "frequency" in arrays.values:
        return arrays.values["frequency"][None]
    frequencies = np.array(survey.instrument.modulation_frequencies)
    return frequencies.reshape(-1, *[1] * len(arrays.shape))


def _variables(
    errors: Assessed,
    shape: tuple[int, ...],
    arrays: Arranged,
    case: Case,
    wrong_interval: float,
) -> dict[str, NDArray[Any]]:
    """Compute the variables of the resulting Dataset from the errors."""
    column = {name: errors.result[..., k] for k, name in enumerate(kernel.RESULTS)}
    variance = sum(column[name] for name in kernel.RANDOM)
    water_bias_square = sum(column[name] ** 2 for name in kernel.SYSTEMATIC)
    water = np.sqrt(water_bias_square + errors.late**2)
    bias = np.hypot(water, errors.footprint)
    distance = np.broadcast_to(arrays.values["distance"], shape)
    wrong = column["wrong"]
    limit = (
        np.minimum(errors.far, errors.repetition)
        if np.isinf(errors.far).all()
        else errors.far
    )
    slope = np.broadcast_to(arrays.values.get("slope", np.zeros(())), shape)
    flags = {
        "ambiguous": (wrong > wrong_interval)
        | (distance >= limit)
        | (distance < errors.near),
        "saturated": column["output"] > 1,
        "model_not_valid": (column["unseen"] > 0.5)
        | (errors.bent > MOST_BENT)
        | (slope > _STEEPEST),
    }
    variables: dict[str, NDArray[Any]] = {
        "total_error": np.sqrt(variance + bias**2),
        "standard_uncertainty": np.sqrt(variance),
        "residual_bias": bias,
        "wrong_interval_probability": wrong,
        "signal": column["signal"] * errors.volt,
        **{name: np.sqrt(column[name]) for name in kernel.RANDOM},
        "water_left_in": water,
        "late_light": errors.late,
        "ambiguity": np.sqrt(column["astray"]),
        "footprint": errors.footprint,
        "saturation": column["output"],
        "ambiguity_interval": errors.repetition,
        **{name: value.astype(np.int8) for name, value in flags.items()},
    }
    sizes = np.stack(
        [
            np.zeros(shape) if name in ("ambiguity", "saturation") else variables[name]
            for name in TERMS
        ]
    )
    binding = np.argmax(sizes, axis=0)
    binding = np.where(flags["ambiguous"], TERMS.index("ambiguity"), binding)
    binding = np.where(flags["saturated"], TERMS.index("saturation"), binding)
    return {"binding_term": binding.astype(np.int8), **variables}


_JERLOV = {
    "kind": "jerlov",
    "source": "williamson-hollins-2022",
    "salinity": 35.0,
}
#: Named waters, with description and survey text.
WATERS: dict[str, tuple[str, dict[str, Any]]] = {
    "pure": ("pure sea water", {"kind": "pure", "salinity": 35.0}),
    **{
        kind: (
            f"Jerlov {kind}, {'coast' if kind.endswith('C') else 'open ocean'}",
            {**_JERLOV, "type": kind},
        )
        for kind in ("IB", "II", "III", "1C", "3C", "5C")
    },
}
#: Distances evaluated, evenly in their logarithm [m].
_NEAREST, _FARTHEST, _STEPS = 0.3, 60.0, 160


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Interval of distances at which an instrument is accurate enough in one water."""

    water: str
    """Name of the water."""
    attenuation: float
    """Attenuation coefficient at the instrument's wavelength [1/m]."""
    nearest: float | None
    """Nearest slant range of the longest accurate interval; None without one [m]."""
    farthest: float | None
    """Farthest slant range of the interval; infinite if accurate up to 60 m [m]."""
    binding: str
    """Largest error term at the farthest range, or "model" at the model's limit."""
    repetition: float
    """Unambiguous range: slant range after which the phases repeat [m]."""


def reach(
    survey: Survey,
    *,
    accuracy: float,
    water: str,
    reflectance: float | None = None,
    method: str = "open-water",
) -> Reach:
    """Return the longest interval of distances that meets a required accuracy."""
    title, properties = WATERS[water]
    # A survey's own far wall is not part of another water.
    moved = survey.with_({"water": properties})
    distance = np.geomspace(_NEAREST, _FARTHEST, _STEPS)
    axes: dict[str, Any] = {} if reflectance is None else {"reflectance": reflectance}
    errors = evaluate(moved, distance=distance, method=method, **axes)
    outside = errors["model_not_valid"].values.astype(bool)
    bad = outside | errors["saturated"].values.astype(bool)
    bad |= ~(errors["total_error"].values <= accuracy)
    begin, end = _longest(~bad)
    if begin == end:
        binding = (
            "model" if outside.all() else _largest(errors, int(np.argmin(outside)))
        )
    elif end == _STEPS:
        binding = ""
    else:
        binding = "model" if outside[end] else _largest(errors, end)
    return Reach(
        water=title,
        attenuation=float(water_properties(moved).attenuation),
        nearest=float(distance[begin]) if end > begin else None,
        farthest=None
        if begin == end
        else float("inf")
        if end == _STEPS
        else float(distance[end - 1]),
        binding=binding,
        repetition=float(errors["ambiguity_interval"].values.flat[0]),
    )


def _longest(good: NDArray[np.bool_]) -> tuple[int, int]:
    """Start and end (exclusive) of the longest run of True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    at = int(np.argmax(ends - begins))
    return int(begins[at]), int(ends[at])


def _largest(errors: Any, number: int) -> str:
    """Name of the largest error source at one distance, except range ambiguity."""
    if errors["saturated"].values[number]:
        return "saturation"
    sizes = {
        name: float(errors[name].values[number])
        for name in TERMS
        if name not in ("ambiguity", "saturation")
    }
    return max(sizes, key=lambda name: sizes[name]).replace("_", " ")
