"""Stokes method: target and water by their Mueller matrices, from all analyzers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincc

from amulor import cube as cubes
from amulor.cube import WaterResidualCause, tiles
from amulor.errors import CubeError
from amulor.optics.polarization import mueller, stokes
from amulor.rejection import channels, quality
from amulor.rejection.build import present_terms, saturated_in_any, target_cube
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.reference.before_target import (
    WaterFit,
    raised_to_shot_amplitude,
)
from amulor.rejection.reference.shots import (
    Noise,
    ShotsFit,
    fit_shots,
    fluctuation_of,
    with_measured_noise,
)
from amulor.survey import water_properties
from amulor.survey.mueller import matrix

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Largest condition number of the analyzer states for a Stokes vector [1].
_WORST_CONDITION = 100.0
#: Target and water differ if their Stokes vectors span an angle of that sine [1].
_SMALLEST_ANGLE = 1e-3
#: Probability of a larger departure by chance, below which a pixel is flagged [1].
_IMPROBABLE = 1e-3
#: Change of an element by which it is found whether a test of it exists [1].
_PROBE = 0.01


@dataclass(frozen=True, kw_only=True)
class StokesFit:
    """Scan-wide parameters of the Stokes method."""

    noise: Noise
    """Corrections of the stated noise."""
    water: WaterFit | None
    """Scan-wide fit of the water in front of the targets; None without shots."""
    shots: ShotsFit | None
    """Fit of the open-water shots; None without shots."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""


@dataclass(frozen=True, kw_only=True)
class _States:
    """Light of target and water behind each analyzer."""

    target: Floats
    """Parts of the target signal of the first analyzer, shape (analyzer,) [1]."""
    water: Floats
    """Parts of the launched power that water would send there, shape (analyzer,)."""

    def solve(self, signal: Complex, errors: Covariance) -> channels.Unmixed:
        """Return the target signal, from samples over (frequency, analyzer, ...)."""
        return channels.unmix(
            list(np.moveaxis(signal, 1, 0)),
            [errors.part((slice(None), c)) for c in range(signal.shape[1])],
            target_weights=list(self.target),
            water_weights=list(self.water),
            water_prior=None,
        )

    def null(self) -> Floats:
        """Return combinations of analyzers without target and water, as rows."""
        vectors = np.stack([self.target, self.water])
        return np.asarray(np.linalg.svd(vectors)[2][2:])

    def water_of(self, signal: Complex, target: Complex) -> Complex:
        """Return the water signal that the samples have beside a target."""
        rest = signal - self.target[:, None, None] * target[:, None]
        along_water = np.einsum("c,fcij->fij", self.water, rest)
        return np.asarray(along_water / (self.water @ self.water))


def _states(matrices: tuple[Floats, Floats], chosen: list[str]) -> _States:
    """Return the light behind the analyzers; CubeError if both are alike."""
    target, water = (
        np.array([float(mueller.detected_fraction(part, pair=c)) for c in chosen])
        for part in matrices
    )
    lengths = np.linalg.norm(target) * np.linalg.norm(water)
    smallest = _SMALLEST_ANGLE**2 / 2 * lengths
    if target[0] <= 0 or lengths - abs(target @ water) < smallest:
        raise CubeError(
            f"target and water pass the analysers {', '.join(chosen)} in the same "
            "proportions, or the first one shows no target; other channels or other "
            "Mueller matrices are needed to tell them apart"
        )
    return _States(target=target / target[0], water=water / target[0])


def _changed(
    matrices: tuple[Floats, Floats], chosen: list[str], size: float
) -> Iterator[_States]:
    """Yield the light with each polarized element changed that the analyzers see."""
    if size == 0:
        return
    plain = _states(matrices, chosen)
    for which in (0, 1):
        for k in (1, 2, 3):
            parts = [part.copy() for part in matrices]
            parts[which][k, k] -= np.copysign(size, parts[which][k, k])
            states = _states((parts[0], parts[1]), chosen)
            if not (
                np.allclose(states.target, plain.target, atol=1e-12)
                and np.allclose(states.water, plain.water, atol=1e-12)
            ):
                yield states


def _matrices(
    scan: Observation, target: ArrayLike | None, water: ArrayLike | None
) -> tuple[Floats, Floats]:
    """Return the stated Mueller matrices, or those of the survey."""
    survey = scan.survey
    if target is None:
        if survey is None or not survey.targets:
            raise CubeError(
                "the survey of the cube has no target with a Mueller matrix; state "
                "target_mueller, or name the paint in [[targets]]"
            )
        target = matrix(survey.targets[0].mueller)
    if water is None:
        if survey is None:
            raise CubeError(
                "the cube has no survey with the Mueller matrix of its water; state "
                "water_mueller"
            )
        water = matrix(water_properties(survey).backscatter_mueller)
    found = []
    for name, part in (("target_mueller", target), ("water_mueller", water)):
        values = np.asarray(part, dtype=float)
        if values.shape == (3,):
            values = np.diag([1.0, *values])
        if values.shape != (4, 4):
            raise ValueError(
                f"{name} must be three elements or have shape (4, 4), got shape "
                f"{values.shape}"
            )
        found.append(values)
    return found[0], found[1]


def _departure(
    signal: Complex,
    states: _States,
    changed: list[_States],
    errors: Covariance,
    target: Complex,
    water: Complex,
) -> Floats:
    """Return the probability of so large a departure from the matrices by chance.

    With two outputs for each analyzer beyond two and each frequency.
    """
    null = states.null()
    rest = np.einsum("nc,fcij->fijn", null, signal)
    variance = (errors.in_phase + errors.quadrature) / 2
    total = np.einsum("nc,mc,fcij->fijnm", null, null, variance).astype(complex)
    for part in changed:
        moved = np.multiply.outer(target, null @ part.target)
        moved = moved + np.multiply.outer(water, null @ part.water)
        total += moved[..., :, None] * moved[..., None, :].conj() / 2
    tiny = np.finfo(float).tiny * np.eye(len(null))
    solved = np.linalg.solve(total + tiny, rest[..., None])[..., 0]
    square = np.einsum("fijn,fijn->fij", rest.conj(), solved).real
    freedom = signal.shape[0] * len(null)
    return np.asarray(gammaincc(freedom, square.sum(axis=0) / 2))


def _unmix(
    cube: xr.Dataset,
    *,
    launched: str | None = None,
    target_mueller: ArrayLike | None = None,
    water_mueller: ArrayLike | None = None,
    mueller_uncertainty: float = 0.02,
    fit: StokesFit | None = None,
    span: tiles.Span | None = None,
) -> tuple[xr.Dataset, StokesFit]:
    """Unmix a scan or, with `fit`, some of its rows; return also the fit."""
    if not 0 <= mueller_uncertainty < 1:
        raise ValueError(
            "mueller_uncertainty must lie from 0 to below 1, got "
            f"{mueller_uncertainty:g}"
        )
    scan = Observation(cube=cubes.checked(cube, "samples"))
    scan, noise = with_measured_noise(scan, None if fit is None else fit.noise)
    cube = scan.cube
    chosen = (
        [name for name in scan.polarizations if name != "none"]
        if launched is None
        else _launched_as(cube, launched)
    )
    if len(chosen) < 2:
        raise CubeError(
            f"the cube has the channels {', '.join(cube.amulor.polarizations)}; "
            "unmixing needs two or more"
            + ("" if launched is None else f" with {launched} launched")
        )
    matrices = _matrices(scan, target_mueller, water_mueller)
    states = _states(matrices, chosen)
    part = Observation(cube=cube.sel(polarization=chosen))
    signal, counting = part.signal, part.covariance
    errors, fluctuation = counting, None
    solved = states.solve(signal, errors)
    before, of_shots = None, None
    if part.shots is not None:
        # Each channel's water follows from its residual.
        water = signal - states.target[:, None, None] * solved.target[:, None]
        size, before = raised_to_shot_amplitude(
            part, water, fit=None if fit is None else fit.water, span=span
        )
        fits, of_shots = fit_shots(
            part, fit=None if fit is None else fit.shots, span=span
        )
        fluctuation = fluctuation_of(fits, size)
        errors = counting + fluctuation
        solved = states.solve(signal, errors)
    target = solved.target
    water = states.water_of(signal, target)
    changed = list(_changed(matrices, chosen, mueller_uncertainty))
    common = along(target, 0.0)
    for other in changed:
        common += along(other.solve(signal, errors).target - target, 1.0)
    everywhere = (slice(None), None)
    parts = [
        ("counting", counting),
        *([] if fluctuation is None else [("fluctuation", fluctuation)]),
    ]
    terms = {
        name: solved.error_of(
            [covariance.part((slice(None), c)) for c in range(len(chosen))]
        ).part(everywhere)
        for name, covariance in parts
    } | {"polarization_optics": common.part(everywhere)}
    present = present_terms(terms, None if fit is None else fit.terms)
    first = saturated_in_any(cube.sel(polarization=[chosen[0]]), part.cube)
    null = states.null()
    tested = any(
        np.abs(null @ np.stack([other.target, other.water], axis=1)).max(initial=0)
        > _SMALLEST_ANGLE * _PROBE
        for other in _changed(matrices, chosen, _PROBE)
    )
    result = target_cube(
        first,
        target[:, None],
        (solved.independent + common).part(everywhere),
        common=common.part(everywhere),
        proportional=common.part(everywhere),
        terms=present,
        water_signal=first.amulor.signal.values - target[:, None],
        step=f"reject, unmix {', '.join(chosen)} by Mueller matrices",
        frequencies_share_errors=np.int32(0),
        mueller_tested=np.int32(tested),
    )
    if len(null):
        probability = _departure(signal, states, changed, errors, target, water)
        cause = np.zeros(signal[:, :1].shape, dtype=np.int8)
        cause[:, 0, probability < _IMPROBABLE] = WaterResidualCause.MODEL_MISFIT
        result = quality.add_water_residual(result, cause)
    return result, StokesFit(
        noise=noise, water=before, shots=of_shots, terms=tuple(present)
    )


def _unsuited(cube: xr.Dataset, interval: tuple[float, float] | None) -> str:
    """Return why the channels do not test the matrices; empty if they do."""
    channels = [name for name in cube.amulor.polarizations if name != "none"]
    if len(channels) > 2 and len({name[0] for name in channels}) > 1:
        return ""
    return (
        "one launched polarization does not test the Mueller matrices; record a "
        "second one, such as RR and RL beside VV and VH"
    )


@method(
    "stokes",
    needs=Needs(),
    simplicity=4,
    unsuited=_unsuited,
    fitter=partial(tiles.fit_on_sample, _unmix),
)
def unmix_stokes(
    cube: xr.Dataset,
    *,
    launched: str | None = None,
    target_mueller: ArrayLike | None = None,
    water_mueller: ArrayLike | None = None,
    mueller_uncertainty: float = 0.02,
) -> xr.Dataset:
    r"""Separate target and water by their Mueller matrices, from all analyzer states.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with two or more channels. Two launched states, such as linear
        and circular, test the matrices: VV, VH, RR and RL.
    launched : str, optional
        Launched state: the first letter of the channels to use. By default all channels
        are used.
    target_mueller, water_mueller : array_like, shape (4, 4) or (3,), optional
        Reduced Mueller matrices straight backwards, or m22, m33 and m44 [1]. By default
        those of the survey.
    mueller_uncertainty : float
        Standard uncertainty of each of these elements [1].

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the first one, in which the target
        signal is given. The error by the matrices is common to all pixels.

        - `WATER_RESIDUAL` with the cause `MODEL_MISFIT`: the samples of three or more
          channels depart from every mixture of target and water by more than their
          errors (1 of 1000 by chance).
        - `mueller_tested` is 0 if no such departure depends on the matrices: with one
          launched state, a wrong matrix gives another mixture.

    Raises
    ------
    CubeError
        If there are fewer than two channels, if both matrices turn the launched
        light into the same state, or if neither survey nor argument states a matrix.
    ValueError
        If a matrix has another shape, or the uncertainty is not from 0 to below 1.

    Notes
    -----
    Generalized least squares of :math:`y_c = t_c T + w_c W`, in which t and w are the
    fractions that the analyzers pass, eqs. (60) and (69) of Ricci et al. 2010. With
    four states this fits the measured Stokes vector by those of target and water. The
    fluctuation of the water is estimated from the open-water shots, if there are any.
    With circular light launched, this uses the memory of circular polarization [1]_:
    water of small spheres reverses the sense of rotation, and paint less so.

    References
    ----------
    .. [1] F. C. MacKintosh et al., Phys. Rev. B 40, 9342 (1989),
       :doi:`10.1103/PhysRevB.40.9342`.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import rejection, samples
    >>> target = rejection.unmix_stokes(
    ...     samples.cube("ladder").isel(row=[18]),
    ...     launched="V",
    ...     target_mueller=np.diag([1, 0.61, -0.61, -0.46]),
    ...     water_mueller=np.diag([1, 0.82, -0.82, -0.64]),
    ... )
    >>> target.amulor.polarizations
    ['VV']
    """
    return _unmix(
        cube,
        launched=launched,
        target_mueller=target_mueller,
        water_mueller=water_mueller,
        mueller_uncertainty=mueller_uncertainty,
    )[0]


def stokes_vectors(cube: xr.Dataset, *, launched: str) -> xr.DataArray:
    r"""Return the Stokes vector of the modulated light of every sample.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` or `target_signal`, with at least four analyzer states that
        determine a Stokes vector, such as V, H, P and R.
    launched : str
        Launched state: the first letter of the channels to use.

    Returns
    -------
    xarray.DataArray
        Complex, dimensions (stokes, modulation_frequency, row, column) [V]. The first
        component is the signal without an analyzer.

    Raises
    ------
    CubeError
        If the analyzer states do not determine a Stokes vector.

    Notes
    -----
    Each Stokes component, eq. (59) of Ricci et al. 2010, is a power, so that it has its
    own modulation amplitude and phase. The vector is fitted by least squares. An ideal
    analyzer with the Stokes vector a passes
    :math:`\\tfrac12 \\mathbf a \\cdot \\mathbf S`.

    Examples
    --------
    Two more analyser states that pass half of the light each: neither diagonal nor
    circular polarization is found.

    >>> import numpy as np
    >>> import xarray as xr
    >>> from amulor import cube as cubes, rejection, samples
    >>> pair = cubes.without_groups(samples.cube("ladder").isel(row=[20]))
    >>> half = pair.mean("polarization", keep_attrs=True)
    >>> half["in_phase_quadrature_covariance"][:] = 0
    >>> more = [half.expand_dims(polarization=[name]) for name in ("VP", "VR")]
    >>> four = xr.concat([pair, *more], "polarization", data_vars="minimal")
    >>> stokes = rejection.stokes_vectors(four, launched="V")
    >>> mean = np.abs(stokes).mean(("modulation_frequency", "row", "column"))
    >>> print((1e3 * mean.values).round(1) + 0.0)  # I, Q, U, V [mV]
    [32.  19.6  0.   0. ]
    """
    cube = cubes.checked(cube)
    chosen = _launched_as(cube, launched)
    matrix = np.array([stokes.state(name[1]) / 2 for name in chosen])
    if len(chosen) < 4 or np.linalg.cond(matrix) > _WORST_CONDITION:
        raise CubeError(
            f"the channels {', '.join(chosen)} do not tell a Stokes vector; needed are "
            f"four analyser states with {launched} launched, such as "
            f"{', '.join(launched + letter for letter in 'VHPR')}"
        )
    signal = cube.sel(polarization=chosen).amulor.signal.values
    vectors = np.einsum("sc,fcij->sfij", np.linalg.pinv(matrix), signal)
    return xr.DataArray(
        vectors,
        dims=("stokes", "modulation_frequency", "row", "column"),
        coords={
            "stokes": list("IQUV"),
            "modulation_frequency": cube["modulation_frequency"].values,
        },
        attrs={"units": "V", "long_name": "Stokes vector of the modulated light"},
    )


def _launched_as(cube: xr.Dataset, launched: str) -> list[str]:
    try:
        stokes.state(launched)
    except ValueError as error:
        raise CubeError(str(error)) from None
    present = cube.amulor.polarizations
    return [name for name in present if name != "none" and name[0] == launched]
