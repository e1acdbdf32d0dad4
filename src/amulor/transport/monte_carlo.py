"""Monte Carlo photon transport from a modulated laser to a narrow receiver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.transport._derivatives import Derivatives, PhaseFunctionChange
from amulor.transport._kernels import batch as _batch_kernels
from amulor.transport._kernels.types import Plan
from amulor.transport._problem import Problem, integrals_of
from amulor.transport._runs import (
    Batch,
    ErrorGoal,
    Limits,
    Progress,
    Record,
    Spread,
    checked_seed,
    conduct,
    frequencies,
    random_state,
)
from amulor.transport.medium import Medium
from amulor.transport.mesh import MeshTarget
from amulor.transport.receiver import PlaneTarget, Receiver, Source
from amulor.transport.tally import Tally

__all__ = ["ErrorGoal", "Progress", "Spread", "Technique", "simulate"]

#: Acceptance up to which the last way to the receiver is a local estimate [rad].
NARROW = 0.35
#: Batches that a run is divided into, and the most histories in one.
_BATCHES, _LARGEST_BATCH = 128, 65536
#: Light of an unseen adjoint path over that of the densest square of reflections, which
#: may reach into a second strip. Runs 4 to 7 standard errors off exceed their errors by
#: 2.0 to 3.6 with it, and runs with all of the light have 0.3 to 0.6 of theirs [1].
_UNSEEN = 2.0
#: Albedo above which paths of more than 16 scatterings end at random, and a number of
#: scatterings that no path has.
_BRIGHT, _ENDLESS = 0.95, 1 << 40
#: Segments of the adjoint paths that are joined with target reflections together.
_BLOCK_SEGMENTS = 200_000

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Technique:
    """Options for sampling and joining paths, without effect on the expected result.

    Raises
    ------
    ValueError
        If a number is below 1.

    Examples
    --------
    >>> from amulor.transport import Technique
    >>> plain = Technique(paths=1, partners=1, stratified=False, balanced=False)
    >>> plain.scattering_orders
    10
    """

    paths: int = 8
    """Number of forward paths in a group."""
    partners: int = 8
    """Number of adjoint paths in a group, joined with each of its forward paths.

    Light of a target is joined over a block of many groups.
    """
    reflections: int = 16
    """Number of target reflections that an adjoint segment is joined with at most.

    Of more in its reach, a random sample is joined.
    """
    roulette: int | None = None
    """Number of scatterings beyond which paths end at random.

    After n scatterings, the light of the remaining paths counts n / `roulette`. By
    default 16 in water with an albedo above 0.95, otherwise unlimited.
    """
    stratified: bool = True
    """Whether first flights and directions in a group are stratified."""
    balanced: bool = True
    """Whether pairs are weighted by the balance heuristic; else equally."""
    batch: int | None = None
    """Number of histories in a batch, a multiple of `paths`; by default a 128th of the
    run, and at most 65,536.

    Light of a target is joined within a batch, so a short run of one batch has the
    smaller variance, and no error.
    """
    direct: bool | None = None
    """Whether the last path to the receiver is a local estimate; by default for
    acceptances up to 0.35 rad.
    """
    scattering_orders: int = 10
    """Number of separate scattering orders; the last includes higher ones."""

    def __post_init__(self) -> None:
        """Raise a ValueError unless numbers are whole and at least 1."""
        names = (
            "paths",
            "partners",
            "reflections",
            "roulette",
            "batch",
            "scattering_orders",
        )
        for name in names:
            value = getattr(self, name)
            if name in ("roulette", "batch") and value is None:
                continue
            if value < 1 or value != int(value):
                raise ValueError(f"{name} must be a whole number from 1, got {value!r}")
        if self.batch is not None and self.batch % self.paths:
            raise ValueError(
                f"batch must be a multiple of the {self.paths} paths of a group, got "
                f"{self.batch!r}"
            )


def simulate(
    medium: Medium,
    source: Source,
    receiver: Receiver,
    modulation_frequency: ArrayLike,
    *,
    histories: int,
    seed: int,
    target: PlaneTarget | MeshTarget | None = None,
    relative_error: float | ErrorGoal | None = None,
    longest_time: float | None = None,
    resume: Tally | None = None,
    technique: Technique | None = None,
    threads: int | None = None,
    keep_record: bool = False,
    progress: Callable[[Progress], None] | None = None,
    spread: Spread | None = None,
    derivatives: Sequence[str | PhaseFunctionChange] = (),
) -> Tally:
    r"""Simulate the received light of a modulated laser beam in water.

    Parameters
    ----------
    medium : Medium
        Water. In bounded or layered water the receiver looks along the forward axis.
    source : Source
        Laser beam that enters the water.
    receiver : DiscReceiver or GaussianReceiver
        Receiver in the water.
    modulation_frequency : array_like
        Frequencies of the modulation, not below zero, shape (n,) [Hz].
    histories : int
        Number of paths from the source, each joined with several from the receiver.
    seed : int
        Seed of the random numbers, not below zero. The same seed gives the same
        result with any number of threads.
    target : PlaneTarget or MeshTarget, optional
        Surface that reflects; light does not pass it.
    relative_error : float or ErrorGoal, optional
        Relative error at which the run stops: that of all light at the first frequency,
        or as an `ErrorGoal` defines it [1]. It is checked at a few fixed numbers of
        batches only, with the error's own uncertainty added, so that stopping does not
        bias the result.
    longest_time : float, optional
        Time after which the run stops [s]. The number of histories then depends on the
        machine.
    resume : Tally, optional
        Earlier run of the same problem and seed to continue; `histories` includes those
        of that run.
    technique : Technique, optional
        Options for sampling and joining paths.
    threads : int, optional
        Number of batches computed at the same time, by default the number of
        processors.
    keep_record : bool
        Whether to keep the record of path lengths.
    progress : callable, optional
        Called with a `Progress` after each batch.
    spread : callable, optional
        Function that distributes batches over a cluster, such as the result of
        `amulor.scale.batches.spread_batches`; by default threads of this process are
        used. It takes a function and two numbers, and yields the function's results for
        the numbers from the first up to the second, in order. It does not change the
        result.
    derivatives : sequence of str or PhaseFunctionChange
        Parameters to which `Tally.derivative` gives the derivatives of the light:
        "absorption" and "scattering" (of all layers at once, at a constant value of
        the other), "reflectance", and changes of the phase function. With a
        `GaussianReceiver`: "receiver_right", "receiver_down", "receiver_radius",
        "receiver_tilt_right" and "receiver_tilt_down", in the axes of the receiver.
        In uniform water with a `PlaneTarget`: "range", along the beam.

    Returns
    -------
    Tally
        Received light relative to launched light, with its errors. If the run is
        interrupted from the keyboard after the first two batches, the result so far is
        returned, marked as interrupted.

    Raises
    ------
    ValueError
        If an argument is out of its range, or they do not fit together.

    Notes
    -----
    Solves the transport equation, eq. (6) of [1]_, with all orders of scattering. Paths
    from the source and from the receiver are joined. As the water is uniform over each
    plane, a path from the receiver may be shifted over the receiver face until it meets
    the path from the source. The range of depths at which they meet is integrated
    exactly. If a mesh may block the path, one of these depths is sampled instead. The
    theory pages describe the method.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor.optics.phase_functions.models import henyey_greenstein_function
    >>> from amulor.transport import DiscReceiver
    >>> water = Medium.homogeneous(
    ...     absorption=0.2,
    ...     scattering=0.8,
    ...     phase_function=henyey_greenstein_function(asymmetry=0.95),
    ...     group_index=1.38,
    ... )
    >>> disc = DiscReceiver(radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0))
    >>> tally = simulate(water, Source(), disc, [0.0, 50e6], histories=20_000, seed=1)
    >>> print(bool(abs(tally.signal[0] - 3.75e-7) < 0.4e-7), tally.heavy_tailed)
    True False
    """
    chosen = technique or Technique()
    limits = Limits(
        histories=histories,
        error=ErrorGoal(relative_error=relative_error)
        if isinstance(relative_error, (int, float))
        else relative_error,
        longest_time=longest_time,
        threads=threads,
        progress=progress,
        spread=spread,
    )
    problem = Problem(medium=medium, source=source, receiver=receiver, target=target)
    size = _batch_size(histories, chosen) if resume is None else resume.batch_size
    if size % chosen.paths:
        raise ValueError(
            f"the run to go on with has batches of {size} histories, which groups of "
            f"{chosen.paths} paths do not fill; use its technique"
        )
    run = _Run(
        problem=problem,
        technique=chosen,
        frequency=frequencies(modulation_frequency),
        seed=checked_seed(seed),
        size=size,
        keep_record=keep_record,
        derivatives=Derivatives.of(derivatives, problem),
    )
    return conduct(run, run.frame(), limits, resume)


def _batch_size(histories: int, technique: Technique) -> int:
    """Return the number of histories in a batch, a multiple of the group size."""
    if technique.batch is not None:
        return technique.batch
    groups = math.ceil(histories / _BATCHES / technique.paths)
    most = max(1, _LARGEST_BATCH // technique.paths)
    return min(groups, most) * technique.paths


@dataclass(frozen=True, kw_only=True)
class _Run:
    """Transport problem in batches, each with its own random numbers."""

    problem: Problem
    technique: Technique
    frequency: Array
    seed: int
    size: int
    keep_record: bool
    derivatives: Derivatives = field(default_factory=Derivatives)

    @property
    def stated(self) -> dict[str, Any]:
        """Settings that determine the results of the batches, by name."""
        return {
            "problem": self.problem.digest + self.derivatives.digest,
            "technique": asdict(self.technique),
            "modulation_frequency": self.frequency.tolist(),
            "seed": self.seed,
            "histories": self.size,
            "record": self.keep_record,
        }

    @property
    def roulette(self) -> int:
        """Number of scatterings beyond which paths end at random."""
        if self.technique.roulette is not None:
            return self.technique.roulette
        return 16 if self.problem.water.albedo.max() > _BRIGHT else _ENDLESS

    @property
    def block(self) -> int:
        """Number of groups whose target reflections are joined together.

        A path gets to n scatterings with the n-th power of the albedo, and beyond the
        first `roulette` with the probability roulette / n.
        """
        if self.problem.target is None:
            return 1
        technique = self.technique
        order = np.arange(_BLOCK_SEGMENTS, dtype=np.float64)
        survival = float(self.problem.water.albedo.max()) ** order
        survival /= np.maximum(order / self.roulette, 1.0)
        segments = max(technique.paths, technique.partners) * survival.sum()
        most = int(_BLOCK_SEGMENTS / segments)
        return min(max(most, 1), self.size // technique.paths)

    def frame(self) -> Tally:
        """Return a tally of the run without batches."""
        orders = self.technique.scattering_orders
        names = [f"water, order {k}" for k in range(1, orders)]
        parts = (
            *names,
            f"water, order {orders} and above",
            "target",
            "target, scattered",
        )
        components = 4 if self.problem.medium.polarized else 1
        return Tally(
            modulation_frequency=self.frequency,
            parts=parts,
            batches=np.empty((0, len(parts), components, self.frequency.size), complex),
            histories_of=np.empty(0, dtype=np.int64),
            groups=0,
            contribution=(0.0, 0.0, 0.0),
            seed=self.seed,
            next_batch=0,
            batch_size=self.size,
            problem=self.problem.digest + self.derivatives.digest,
            seconds=0.0,
            derivatives=self.derivatives.names,
            phase_function_integral=integrals_of(self.problem.medium.layers),
        )

    def __call__(self, number: int) -> Batch:
        """Run one batch of photon histories."""
        frame = self.frame()
        record = Record.empty(
            self.problem.water.attenuation,
            self.problem.medium.group_index,
            self.frequency,
            frame,
            scores=len(self.derivatives.scores),
            lengths=self.derivatives.lengths,
        )
        scene = self.problem.scene
        water = scene.water._replace(score=self.derivatives.score)
        face = scene.face._replace(moved=self.derivatives.moved)
        chosen = self.technique
        direct = chosen.direct
        if direct is None:
            direct = self.problem.face.acceptance <= NARROW
        groups = self.size // chosen.paths
        weight = np.zeros((groups, 2, frame.batches.shape[2]))
        plan = Plan(
            paths=chosen.paths,
            partners=chosen.partners,
            block=self.block,
            reflections=chosen.reflections,
            roulette=self.roulette,
            stratified=chosen.stratified,
            balanced=chosen.balanced,
            direct=direct,
            polarized=frame.polarized,
        )
        reached = _batch_kernels.run_batch(
            random_state(self.seed, number),
            scene._replace(water=water, face=face),
            plan,
            record.arrays(chosen.scattering_orders),
            weight,
        )
        pairs = chosen.paths * chosen.partners * plan.block
        return record.batch(
            number,
            self.size,
            groups,
            weight,
            keep=self.keep_record,
            unseen=_UNSEEN * reached * self.problem.joined_touch / pairs,
            derivatives=self.derivatives,
        )
