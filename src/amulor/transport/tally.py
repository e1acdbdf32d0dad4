"""Result of a transport run: received light, standard errors, group contributions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics.polarization import stokes as _stokes

__all__ = [
    "ANALYSERS",
    "LIGHT",
    "PathRecord",
    "Tally",
    "analyser_vector",
    "outweighs",
    "sums_of",
    "together",
]


Array = NDArray[np.float64]

#: Kinds of light, in the order of the rows of the sums.
LIGHT = ("all", "water", "target")
#: Analysers, in the order of the columns; without Stokes vectors there is the first.
ANALYSERS = ("none", "H", "V", "P", "M", "R", "L")
#: Sum, sum of squares and largest of the contributions of the groups.
SUM, SQUARE, LARGEST = range(3)
#: Equal contributions that would scatter as much, fewest from which an error is known:
#: of fewer the large ones are likely to be missing yet, from sum and error alike.
_FEWEST = 30


def analyser_vector(name: str) -> Array:
    """Return the row vector that maps Stokes vectors to power behind an analyzer."""
    vector = _stokes.state(name)
    result: Array = vector if name == "none" else 0.5 * vector
    return result


def sums_of(weight: Array) -> Array:
    """Return sum, sum of squares and maximum over groups, by light and analyzer."""
    light = np.stack([weight.sum(axis=1), weight[:, 0], weight[:, 1]])
    if weight.shape[2] == 4:
        vectors = np.stack([analyser_vector(name) for name in ANALYSERS], axis=-1)
        passed = light @ vectors
    else:
        passed = light
    return np.stack(
        [
            passed.sum(axis=1),
            (passed**2).sum(axis=1),
            passed.max(axis=1, initial=0.0),
        ],
        axis=-1,
    )


def together(first: Array, second: Array) -> Array:
    """Add the sums of two sets of group contributions, and take the larger maxima."""
    result = first + second
    result[..., LARGEST] = np.maximum(first[..., LARGEST], second[..., LARGEST])
    return result


def outweighs(sums: Array, *, groups: int, unseen: float = 0.0) -> bool:
    """Return whether a single group of histories dominates the standard error."""
    if groups < 2:
        return False
    total, square, largest = (float(value) for value in sums)
    if (square - total**2 / groups) * _FEWEST > total**2:
        return True
    remaining_groups = groups - 1
    mean = (total - largest) / remaining_groups
    spread = max(square - largest**2 - remaining_groups * mean**2, 0.0)
    # Rounding differences of equal contributions are no tail.
    if largest - mean > math.sqrt(spread) + 1e-6 * largest:
        return True
    return unseen > math.sqrt(max(square - total**2 / groups, 0.0))


Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class PathRecord:
    """Received light by path length, for evaluation at other modulation frequencies.

    All light in a bin is assigned to the middle of the bin. A phasor summed over the
    bins is wrong by at most an eighth of the squared phase across a bin, relative to
    the unmodulated light: 3e-4 at the highest frequency of the run.

    Examples
    --------
    Light on a path of 3 m, half a wavelength at 50 MHz with a group index of 1: its
    phase is half a turn.

    >>> import numpy as np
    >>> from scipy.constants import speed_of_light
    >>> from amulor.transport import PathRecord
    >>> record = PathRecord(
    ...     length=np.array([speed_of_light / 100e6]), water=np.array([[1e-7]]),
    ...     target=np.array([[0.0]]), beyond=0.0,
    ... )
    >>> light = record.stokes([50e6], group_index=1.0)
    >>> print(f"{abs(np.angle(light[0, 0])) / np.pi:.3f} pi")
    1.000 pi
    """

    length: Array
    """Path length at the middle of each bin, shape (bins,) [m]."""
    water: Array
    """Mean light scattered by water only, shape (bins, components) [1]."""
    target: Array
    """Mean light reflected by the target, shape (bins, components) [1]."""
    beyond: float
    """Fraction of unmodulated light with path lengths beyond the record [1]."""

    def stokes(
        self,
        modulation_frequency: ArrayLike,
        *,
        group_index: float,
        more_absorption: float = 0.0,
    ) -> Complex:
        r"""Return received Stokes vectors at other frequencies or with more absorption.

        Parameters
        ----------
        modulation_frequency : array_like
            Frequencies, not above those of the run, shape (n,) [Hz].
        group_index : float
            Group index of the run [1].
        more_absorption : float
            Increase of the absorption coefficient in all layers, not below 0 [1/m].
            Less absorption would need paths that the run has not traced.

        Returns
        -------
        ndarray
            Light of water and target together, shape (n, components) [1]. Its errors
            are those of the run.

        Raises
        ------
        ValueError
            If the added absorption is below zero.

        Notes
        -----
        Eq. (9) of Ricci et al. 2010 (:doi:`10.1155/2010/958360`): a path of length L
        contributes :math:`e^{(i \omega / v - a) L}`.
        """
        if not more_absorption >= 0:
            raise ValueError(
                f"more_absorption must be at least 0 1/m, got {more_absorption!r} 1/m"
            )
        frequency = np.atleast_1d(np.asarray(modulation_frequency, dtype=np.float64))
        wave = (2j * np.pi * group_index / speed_of_light) * frequency - more_absorption
        phasor: Complex = np.exp(np.outer(wave, self.length).astype(np.complex128))
        result: Complex = phasor @ (self.water + self.target)
        return result


#: Parts of a run whose derivatives are independent.
_FOLDS = 16
#: Smallest eigenvalue of the information on scaled parameters that determines them.
_LEAST_INFORMATION = 1e-9
#: Batches are merged in pairs when there are that many, so memory stays flat.
MOST_BATCHES = 256


@dataclass(frozen=True, eq=False, kw_only=True)
class Tally:
    r"""Received light of a transport run, relative to the launched light.

    The signal is complex, in_phase + 1j quadrature, with a later echo at a larger
    phase. Errors come from the scatter of batches of histories that are
    independent of each other.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> from amulor.transport import DiscReceiver, Layer, Medium, Source, simulate
    >>> water = Layer(
    ...     absorption=0.2, scattering=0.8,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.9),
    ... )
    >>> tally = simulate(
    ...     Medium(layers=[water], group_index=1.38), Source(),
    ...     DiscReceiver(radius=0.05, acceptance_angle=0.1), [0.0],
    ...     histories=2000, seed=1,
    ... )
    >>> int(tally.histories_of.sum()), tally.interrupted
    (2000, False)
    """

    modulation_frequency: Array
    """Modulation frequencies, shape (n,) [Hz]."""
    parts: tuple[str, ...]
    """Names of the parts of the light.

    Water by number of scatterings, target without and with scattering in the water.
    """
    batches: Complex
    """Mean light of each batch, shape (batches, parts, components, n); the components
    are I, or I, Q, U and V [1].
    """
    histories_of: NDArray[np.int64]
    """Number of histories in each batch."""
    groups: int
    """Number of groups of histories with shared paths; each is one contribution."""
    contribution: tuple[float, float, float]
    """Sum, sum of squares and maximum of the contributions at zero frequency."""
    seed: int
    """Seed of the random number generator."""
    next_batch: int
    """Number of the next batch, for resumption of the run."""
    batch_size: int
    """Number of histories in a full batch."""
    problem: str
    """Digest of the transport problem; only runs of one problem can be merged."""
    seconds: float
    """Run time [s]."""
    interrupted: bool = False
    """Whether the run was stopped early."""
    record: PathRecord | None = None
    """Path-length record, if requested."""
    merged_seeds: tuple[int, ...] = ()
    """Seeds of other runs merged into this tally."""
    contributions: Array | None = None
    """Sums of the group contributions at zero frequency, shape (3, 1 or 7, 3) [1].

    For all light, water and target, and for each analyzer: sum, sum of squares and
    maximum.
    """
    phase_function_integral: tuple[float, ...] = ()
    """Sphere integral of each layer's phase function before normalization; 1
    within 0.2 % [1].
    """
    unseen: float = 0.0
    """Light of an adjoint path joined with all reflections in its reach [1]."""
    derivatives: tuple[str, ...] = ()
    """Names of the parameters of the derivatives, if requested."""
    derivative_batches: Complex | None = None
    """Mean derivatives of each batch, of water and target in turn for each parameter,
    shape (batches, 2 x parameters, components, n).
    """

    @property
    def histories(self) -> int:
        """Number of photon histories."""
        return int(self.histories_of.sum())

    @property
    def polarized(self) -> bool:
        """Whether Stokes vectors were computed."""
        return bool(self.batches.shape[2] == 4)

    @property
    def rows(self) -> Complex:
        """Mean light and derivatives of each batch, parts and derivatives together."""
        if self.derivative_batches is None:
            return self.batches
        return np.concatenate([self.batches, self.derivative_batches], axis=1)

    def with_rows(self, rows: Complex) -> Tally:
        """Return the tally with the light and derivatives of other batches."""
        parts = len(self.parts)
        return replace(
            self,
            batches=rows[:, :parts],
            derivative_batches=rows[:, parts:] if self.derivatives else None,
        )

    def _select(self, which: str) -> Complex:
        """Return batch means of a kind of light, (batch, component, frequency)."""
        if which not in LIGHT:
            return self.batches[:, self.parts.index(which)]
        target = np.array([name.startswith("target") for name in self.parts])
        chosen = dict(zip(LIGHT, (np.ones_like(target), ~target, target), strict=True))
        summed: Complex = self.batches[:, chosen[which]].sum(axis=1)
        return summed

    def _mean(self, values: Complex) -> Complex:
        """Return the mean over batches, weighted by numbers of histories."""
        weight = self.histories_of / self.histories
        mean: Complex = np.tensordot(weight, values, axes=1)
        return mean

    @property
    def stokes(self) -> Complex:
        """Received Stokes vector at each frequency, shape (n, components) [1]."""
        stokes: Complex = self._mean(self._select("all")).T
        return stokes

    @property
    def signal(self) -> Complex:
        """Complex received intensity at each modulation frequency, shape (n,) [1]."""
        signal: Complex = self._mean(self._select("all"))[0]
        return signal

    @property
    def water_signal(self) -> Complex:
        """Complex received light scattered by water only, shape (n,) [1]."""
        signal: Complex = self._mean(self._select("water"))[0]
        return signal

    @property
    def target_signal(self) -> Complex:
        """Complex received light reflected by the target, shape (n,) [1]."""
        signal: Complex = self._mean(self._select("target"))[0]
        return signal

    def part(self, name: str) -> tuple[Complex, Array]:
        """Return the Stokes vector of a part of the light, and the part's covariance.

        Parameters
        ----------
        name : str
            One of `parts`.

        Returns
        -------
        stokes : ndarray
            I, or I, Q, U and V, shape (components, n) [1].
        covariance : ndarray
            Of real and imaginary part, shape (components, n, 2, 2) [1].

        Raises
        ------
        ValueError
            If there is no such part.
        """
        if name not in self.parts:
            names = ", ".join(repr(part) for part in self.parts)
            raise ValueError(f"the parts are {names}; got {name!r}")
        values = self.batches[:, self.parts.index(name)]
        return self._mean(values), self.covariance_of(values)

    @property
    def by_part(self) -> dict[str, Complex]:
        """Complex received light of each part, shape (n,), by name of the part [1]."""
        mean = self._mean(self.batches)
        return {name: mean[k, 0] for k, name in enumerate(self.parts)}

    @property
    def covariance(self) -> Array:
        """Covariance of real and imaginary part of `signal`, shape (n, 2, 2) [1]."""
        return self.covariance_of(self._select("all")[:, 0])

    @property
    def water_covariance(self) -> Array:
        """Covariance of real and imaginary part of `water_signal`, (n, 2, 2) [1]."""
        return self.covariance_of(self._select("water")[:, 0])

    @property
    def target_covariance(self) -> Array:
        """Covariance of real and imaginary part of `target_signal`, (n, 2, 2) [1]."""
        return self.covariance_of(self._select("target")[:, 0])

    @property
    def frequency_covariance(self) -> Array:
        """Covariance of `signal` between frequencies, real and imaginary parts.

        Shape (2 n, 2 n), all real parts first [1]. All frequencies share the same
        paths, so their errors are correlated.
        """
        values = self._select("all")[:, 0]
        return self._scatter(np.concatenate([values.real, values.imag], axis=1))

    def covariance_of(self, values: ArrayLike) -> Array:
        """Return the covariance of real and imaginary part of a mean over batches.

        Parameters
        ----------
        values : array_like
            Complex values, shape (batches, ...).

        Returns
        -------
        ndarray
            Covariance of real and imaginary part, shape (..., 2, 2).

        Raises
        ------
        ValueError
            If there are fewer than two batches.
        """
        batches = np.asarray(values, dtype=np.complex128)
        pair = np.stack([batches.real, batches.imag], axis=-1)
        weight = self._weight()
        centred = pair - np.tensordot(self.histories_of / self.histories, pair, axes=1)
        result: Array = np.einsum("b,b...i,b...j->...ij", weight, centred, centred)
        return result

    def _weight(self) -> Array:
        """Weight of each batch's squared deviation in the variance of the mean."""
        if self.histories_of.size < 2:
            raise ValueError("an error needs at least two batches, got one")
        return variance_weight(self.histories_of)

    def _scatter(self, values: Array) -> Array:
        """Return the covariance matrix of the mean over batches of real vectors."""
        weight = self.histories_of / self.histories
        centred = values - weight @ values
        result: Array = (centred * self._weight()[:, np.newaxis]).T @ centred
        return result

    def detected(self, analyser: str) -> tuple[Complex, Array]:
        """Return the light behind an ideal analyzer, and its covariance.

        Parameters
        ----------
        analyser : str
            Name of a state of `amulor.optics.polarization.stokes.state`. Its parallel
            axis points to the right of the receiver.

        Returns
        -------
        signal : ndarray
            Light behind the analyzer, shape (n,) [1].
        covariance : ndarray
            Of its real and imaginary part, shape (n, 2, 2) [1].

        Raises
        ------
        ValueError
            If the run carried no Stokes vectors, or there is no such state.
        """
        values = self.passed(analyser=analyser)
        return self._mean(values), self.covariance_of(values)

    def passed(self, light: str = "all", *, analyser: str = "none") -> Complex:
        """Return the light behind an ideal analyzer, batch by batch.

        Parameters
        ----------
        light : str
            "all", "water", "target", or one of `parts`.
        analyser : str
            Name of a state, as for `detected`.

        Returns
        -------
        ndarray
            Mean of each batch, shape (batches, n) [1].

        Raises
        ------
        ValueError
            If there is no such light or state, or the run carried no Stokes vectors.
        """
        _refuse_other_light(light, (*LIGHT, *self.parts))
        values = self._select(light)
        return self._analysed(values, analyser)

    def _analysed(self, values: Complex, analyser: str) -> Complex:
        """Return Stokes vectors of batches behind an ideal analyzer."""
        if analyser == "none":
            return values[:, 0]
        if not self.polarized:
            raise ValueError(
                "an analyser needs Stokes vectors; give the medium a ScatteringMatrix"
            )
        passed: Complex = np.einsum("k,bkn->bn", analyser_vector(analyser), values)
        return passed

    def derivative(
        self, name: str, light: str = "all", *, analyser: str = "none"
    ) -> tuple[Complex, Array]:
        r"""Return the derivative of the light to a parameter, and its covariance.

        Parameters
        ----------
        name : str
            One of `derivatives`.
        light : str
            "all", "water" or "target".
        analyser : str
            Name of a state, as for `detected`.

        Returns
        -------
        derivative : ndarray
            Derivative of the complex light, per unit of the parameter, shape (n,).
        covariance : ndarray
            Of its real and imaginary part, shape (n, 2, 2).

        Raises
        ------
        ValueError
            If the run has no such derivative, or there is no such light or state.

        Notes
        -----
        A path x contributes the light f(x), and to the derivative
        :math:`f \, \partial \ln f / \partial q`. With N scatterings, the path length L
        and K reflections this factor is -L for the absorption, :math:`N / b - L` for
        the scattering and K over reflectance for the reflectance. For a parameter of
        the phase function it is the sum of :math:`\partial \ln p / \partial q` over
        the scatterings. The theory page has those of the receiver and the range.

        Examples
        --------
        >>> from amulor.optics.phase_functions.models import isotropic
        >>> from amulor.transport import DiscReceiver, Medium, Source, simulate
        >>> water = Medium.homogeneous(
        ...     absorption=0.9, scattering=0.1, phase_function=isotropic(),
        ...     group_index=1.33,
        ... )
        >>> tally = simulate(
        ...     water, Source(), DiscReceiver(radius=0.05, acceptance_angle=0.1), [0.0],
        ...     histories=20_000, seed=1, derivatives=("absorption",),
        ... )
        >>> slope, covariance = tally.derivative("absorption")
        >>> mean_path = -slope[0].real / tally.signal[0].real
        >>> print(f"{mean_path:.1f} m")
        0.6 m
        """
        if self.derivative_batches is None or name not in self.derivatives:
            names = ", ".join(repr(known) for known in self.derivatives) or "none"
            raise ValueError(f"the derivatives are {names}; got {name!r}")
        _refuse_other_light(light)
        first = 2 * self.derivatives.index(name)
        both = self.derivative_batches[:, first : first + 2]
        values = both.sum(axis=1) if light == "all" else both[:, LIGHT.index(light) - 1]
        values = self._analysed(values, analyser)
        return self._mean(values), self.covariance_of(values)

    def bounds(
        self, noise: ArrayLike, names: Sequence[str] = ()
    ) -> tuple[Array, Array]:
        r"""Return Cramér-Rao bounds of parameters from one measurement of the signal.

        Parameters
        ----------
        noise : array_like
            Covariance of the noise of real and imaginary part at each frequency, shape
            (n, 2, 2), relative to the launched power [1].
        names : sequence of str
            Parameters that are estimated together, by default all `derivatives`. The
            other parameters count as known.

        Returns
        -------
        bound : ndarray
            Smallest standard uncertainty of each parameter without bias, shape (k,).
        error : ndarray
            Standard error of the bound, by the jackknife, shape (k,).

        Raises
        ------
        ValueError
            If the run has no such derivative or fewer than 16 batches, or if the signal
            does not determine the parameters.

        Notes
        -----
        The bound is the root of the diagonal of the inverse of the Fisher information
        :math:`J^T C^{-1} J`, with the derivatives J of the signal and the covariance C.
        The jackknife over 16 parts of the run removes the bias by the errors of the
        derivatives, and gives the error.

        Examples
        --------
        >>> from amulor.optics.phase_functions.models import isotropic
        >>> from amulor.transport import (
        ...     GaussianReceiver, Medium, PlaneTarget, Source, simulate,
        ... )
        >>> clear = Medium.homogeneous(
        ...     absorption=0.1, scattering=0.0, phase_function=isotropic(),
        ...     group_index=1.33,
        ... )
        >>> tally = simulate(
        ...     clear, Source(), GaussianReceiver(radius=0.05, acceptance_angle=0.1),
        ...     [50e6], histories=20_000, seed=1,
        ...     target=PlaneTarget(position=(0, 0, 2.0), reflectance=0.2),
        ...     derivatives=("range", "reflectance"),
        ... )
        >>> tenth = (0.1 * abs(tally.signal[0])) ** 2 / 2 * np.eye(2)
        >>> bound, _ = tally.bounds(tenth[np.newaxis])
        >>> print(f"{1e3 * bound[0]:.0f} mm")
        25 mm
        """
        chosen = tuple(names) or self.derivatives
        folds = np.arange(self.histories_of.size) % _FOLDS
        if self.derivative_batches is None or not set(chosen) <= set(self.derivatives):
            raise ValueError(
                f"the derivatives are {', '.join(self.derivatives) or 'none'}; got "
                f"{', '.join(chosen) or 'none'}"
            )
        if self.histories_of.size < _FOLDS:
            raise ValueError(
                f"bounds need a run of at least {_FOLDS} batches, got "
                f"{self.histories_of.size}"
            )
        slopes = self.derivative_batches[:, :, 0]
        slopes = slopes.reshape(len(slopes), -1, 2, slopes.shape[-1]).sum(axis=2)
        slopes = slopes[:, [self.derivatives.index(name) for name in chosen]]
        weighted = slopes * (self.histories_of / self.histories)[:, None, None]
        sums = np.stack([weighted[folds == k].sum(axis=0) for k in range(_FOLDS)])
        share = np.bincount(folds, self.histories_of) / self.histories
        inverse = np.linalg.inv(np.asarray(noise, dtype=np.float64))

        def bound(slope: Complex) -> Array:
            pair = np.stack([slope.real, slope.imag], axis=-1)
            information = np.einsum("kfi,fij,lfj->kl", pair, inverse, pair)
            size = np.sqrt(np.diagonal(information))
            _refuse_undetermined(bool(np.all(size > 0)))
            scaled = information / np.outer(size, size)
            least = float(np.linalg.eigvalsh(scaled)[0])
            _refuse_undetermined(least > _LEAST_INFORMATION)
            inverted: Array = np.sqrt(np.diagonal(np.linalg.inv(scaled))) / size
            return inverted

        whole = sums.sum(axis=0)
        without = np.stack(
            [bound((whole - sums[k]) / (1 - share[k])) for k in range(_FOLDS)]
        )
        error = np.std(without, axis=0) * math.sqrt(_FOLDS - 1)
        corrected = _FOLDS * bound(whole) - (_FOLDS - 1) * without.mean(axis=0)
        _refuse_undetermined(bool(np.all(corrected > 2 * error)))
        return corrected, error

    def relative_error_of(self, light: str = "all", *, analyser: str = "none") -> Array:
        """Return the relative standard error of a kind of light, by frequency.

        Parameters
        ----------
        light : str
            "all", "water", "target", or one of `parts`.
        analyser : str
            Name of a state, as for `detected`.

        Returns
        -------
        ndarray
            Relative error at each frequency, shape (n,): root of the sum of the
            variances of real and imaginary part, infinite without such light [1].

        Raises
        ------
        ValueError
            If there is no such light or state, or the run carried no Stokes vectors.
        """
        values = self.passed(light, analyser=analyser)
        error = np.sqrt(np.trace(self.covariance_of(values), axis1=-2, axis2=-1))
        return _over(error, np.abs(self._mean(values)))

    @property
    def relative_error(self) -> Array:
        """Relative standard error of `signal` at each frequency, shape (n,) [1].

        Root of the sum of the variances of real and imaginary part; infinite without
        light.
        """
        return self.relative_error_of()

    @property
    def amplitude_uncertainty(self) -> Array:
        """Standard error of the modulus of `signal`, shape (n,) [1]."""
        return _along(self.signal, self.covariance, turn=1.0)

    @property
    def phase_uncertainty(self) -> Array:
        """Standard error of the phase of `signal`, shape (n,) [rad]."""
        modulus = np.abs(self.signal)
        across = _along(self.signal, self.covariance, turn=1.0j)
        return _over(across, modulus)

    @property
    def effective_contributions(self) -> float:
        """Effective number of equal contributions: sum^2 / sum of squares [1]."""
        total, square, _ = self.contribution
        return total**2 / square if square > 0 else 0.0

    @property
    def largest_fraction(self) -> float:
        """Largest fraction of the received light from one group of histories [1]."""
        total, _, largest = self.contribution
        return largest / total if total > 0 else 0.0

    @property
    def heavy_tailed(self) -> bool:
        """Whether one group of histories dominates the standard error of any light.

        If so, the stated error of at least one of them is likely too small;
        `heavy_tail_of` determines which.
        """
        kinds = LIGHT if self.contributions is not None else LIGHT[:1]
        return any(self.heavy_tail_of(light) for light in kinds)

    def heavy_tail_of(self, light: str = "all", *, analyser: str = "none") -> bool:
        """Return whether one group of histories dominates a standard error.

        Parameters
        ----------
        light : str
            "all", "water" or "target".
        analyser : str
            Name of a state, as for `detected`.

        Returns
        -------
        bool
            True if one group shifts the mean by more than the standard error of all
            other groups. The stated errors are then likely too small at all
            frequencies, since a group contributes the same modulus to each. It is also
            true for an error above 18 %, that of 30 equal contributions. For target
            light it is true as well if a target reflection joined with an adjoint path
            would exceed the error, even if none has occurred. It is always true for a
            single batch, which has no errors. It is never true for plane layers, whose
            contributions are not recorded.

        Raises
        ------
        ValueError
            If there is no such light or state, or the run did not record it.
        """
        _refuse_other_light(light)
        if self.histories_of.size < 2:
            return True
        sums = self.contributions
        if sums is None:
            if (light, analyser) != ("all", "none"):
                raise ValueError(
                    "contributions by light and analyser were not kept: this is an "
                    "older run, or one of plane layers; run it again"
                )
            return outweighs(np.array(self.contribution), groups=self.groups)
        names = ANALYSERS[: sums.shape[1]]
        if analyser not in names:
            raise ValueError(
                f"analyser must be one of {', '.join(names)}; got {analyser!r}"
            )
        return outweighs(
            sums[LIGHT.index(light), names.index(analyser)],
            groups=self.groups,
            unseen=0.0 if light == "water" else self.unseen,
        )

    def delayed(self, path: float, *, group_index: float) -> Tally:
        """Return the tally of the light after an additional path length.

        Parameters
        ----------
        path : float
            Additional path length, negative for a shorter path [m].
        group_index : float
            Group index along this path [1].

        Returns
        -------
        Tally
            Tally with shifted phases. It cannot be resumed.
        """
        wave = 2j * np.pi * self.modulation_frequency * group_index / speed_of_light
        return replace(
            self.with_rows(self.rows * np.exp(wave * path)),
            problem=f"{self.problem} delayed by {path!r} m of index {group_index!r}",
            next_batch=-1,
            record=None,
        )

    def merged(self, other: Tally) -> Tally:
        """Merge the tallies of two independent runs of one transport problem.

        Parameters
        ----------
        other : Tally
            A run of the same problem at the same frequencies with another seed.

        Returns
        -------
        Tally
            Tally with the batches of both runs, merged in pairs if there are many. It
            cannot be resumed and has no record of path lengths.

        Raises
        ------
        ValueError
            If the problems, frequencies or parts differ, or both runs used the same
            seed.
        """
        if self.problem != other.problem or self.parts != other.parts:
            raise ValueError("only runs of the same problem can be merged")
        if not np.array_equal(self.modulation_frequency, other.modulation_frequency):
            raise ValueError("only runs at the same frequencies can be merged")
        seeds = (other.seed, *other.merged_seeds)
        common = {self.seed, *self.merged_seeds}.intersection(seeds)
        if common:
            raise ValueError(
                f"both runs have the seed {min(common)}, so they are not independent"
            )
        mine, theirs = self.contribution, other.contribution
        rows = np.concatenate([self.rows, other.rows])
        histories_of = np.concatenate([self.histories_of, other.histories_of])
        while histories_of.size > MOST_BATCHES:
            rows, histories_of = paired(rows, histories_of)
        return replace(
            self.with_rows(rows),
            histories_of=histories_of,
            groups=self.groups + other.groups,
            contribution=(
                mine[0] + theirs[0],
                mine[1] + theirs[1],
                max(mine[2], theirs[2]),
            ),
            seconds=self.seconds + other.seconds,
            unseen=max(self.unseen, other.unseen),
            interrupted=self.interrupted or other.interrupted,
            merged_seeds=(*self.merged_seeds, *seeds),
            contributions=None
            if self.contributions is None or other.contributions is None
            else together(self.contributions, other.contributions),
            next_batch=-1,
            record=None,
        )


def _refuse_undetermined(determined: bool) -> None:
    """Raise a ValueError if parameters are not determined."""
    if not determined:
        raise ValueError(
            "the signal does not determine the parameters within the errors of its "
            "derivatives; use more frequencies, more histories or fewer parameters"
        )


def _refuse_other_light(light: str, names: tuple[str, ...] = LIGHT) -> None:
    """Raise a ValueError unless the kind of light is one of the names."""
    if light not in names:
        listed = ", ".join(repr(name) for name in names)
        raise ValueError(f"light must be one of {listed}; got {light!r}")


def paired(
    batches: Complex, histories_of: NDArray[np.int64]
) -> tuple[Complex, NDArray[np.int64]]:
    """Merge neighboring batches in pairs; an odd last batch is kept."""
    starts = np.arange(0, histories_of.size, 2)
    joined: NDArray[np.int64] = np.add.reduceat(histories_of, starts)
    fraction = histories_of / np.repeat(joined, 2)[: histories_of.size]
    weighted = batches * fraction.reshape(-1, *(1,) * (batches.ndim - 1))
    return np.add.reduceat(weighted, starts, axis=0), joined


def variance_weight(histories_of: NDArray[np.int64]) -> Array:
    """Return the weight of each batch's squared deviation in the mean's variance.

    Free of bias for batches of any sizes; fraction / (batches - 1) for equal ones.
    """
    fraction = histories_of / histories_of.sum()
    weight: Array = fraction**2 / (1 - fraction)
    return weight


def _over(error: Array, modulus: Array) -> Array:
    """Return the ratio of standard error to modulus; infinite for a modulus of 0."""
    lit = modulus > 0
    result: Array = np.full(error.shape, math.inf)
    np.divide(error, modulus, out=result, where=lit)
    return result


def _along(signal: Complex, covariance: Array, *, turn: complex) -> Array:
    """Return the standard error of a complex signal in the direction signal * turn."""
    modulus = np.abs(signal)
    unit = (
        np.divide(signal, modulus, out=np.ones_like(signal), where=modulus > 0) * turn
    )
    vector = np.stack([unit.real, unit.imag], axis=-1)
    variance = np.einsum("...i,...ij,...j->...", vector, covariance, vector)
    result: Array = np.sqrt(np.maximum(variance, 0.0))
    return result
