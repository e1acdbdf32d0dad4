"""List of all scenes of the trust study, with name and description."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from amulor.simulation.models import DiffusionModel
from amulor.studies.trust.case import Case
from amulor.studies.trust.scenes import (
    acquired,
    knowledge,
    models,
    photons,
    samples,
)

#: Makes a case from the number of frequencies and a seed.
Maker = Callable[[int, int], Case]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Scene of the trust study: name, description, and function that simulates it."""

    name: str
    """Short name, for the table."""
    title: str
    """Description of the scene and of its difficulty."""
    make: Maker
    """Function that simulates the test case."""
    counts: tuple[int, ...] = (1, 2, 4, 16)
    """Numbers of modulation frequencies used for the scene."""


#: Histories for each distance by phase function and reflectance, where 400,000 are too
#: few: the light of the scene is then off by several times the noise of its samples,
#: which the flags say, and rightly.
_HISTORIES = {
    ("two-term", 0.1): 1_600_000,
    ("two-term", 0.02): 9_600_000,
    ("fournier-forand", 0.02): 6_400_000,
}


def _photon_scenes() -> list[Scene]:
    scenes = []
    for name in photons.PHASE_FUNCTIONS:
        for reflectance, word in ((0.1, "grey"), (0.02, "dim")):
            scenes.append(
                Scene(
                    name=f"photons {name} {word}",
                    title=f"photons, {name}, plates of {reflectance:.0%} at 1.6 to "
                    "3.2 m",
                    make=partial(
                        photons.photon_water,
                        function=name,
                        reflectance=reflectance,
                        histories=_HISTORIES.get((name, reflectance), 400_000),
                    ),
                )
            )
    # One to six attenuation lengths to the plate and as many back, in four waters.
    for turbidity, histories in ((0.5, 400_000), (2.0, 1_600_000), (4.0, 6_400_000)):
        scenes.append(
            Scene(
                name=f"photons c {0.5 * turbidity:g} 1/m",
                title=f"photons, petzold, c = {0.5 * turbidity:g} 1/m, plates of 10 % "
                "at 1.6 to 3.2 m",
                make=partial(
                    photons.photon_water,
                    function="petzold",
                    turbidity=turbidity,
                    histories=histories,
                ),
            )
        )
    return scenes


def _scene(
    name: str, title: str, make: Maker, counts: tuple[int, ...] = (1, 2, 4, 16)
) -> Scene:
    return Scene(name=name, title=title, make=make, counts=counts)


SCENES: tuple[Scene, ...] = (
    _scene("flat", "plate at 2.6 m, everything as the model has it", models.flat),
    _scene("slope 60", "plate that leans 60 degrees", partial(models.sloped, lean=60)),
    _scene("slope 75", "plate that leans 75 degrees", partial(models.sloped, lean=75)),
    _scene("dark", "plate of 1 %", models.dark),
    _scene("far", "plate at 3.0 m, 50 MHz repeat after 2.17 m, no interval stated",
           models.far, (1,)),
    _scene("far two", "plate at 6.2 m, 20 and 80 MHz repeat after 5.43 m, no interval",
           models.far_two, (2,)),
    _scene("tall", "scan of 9 x 19 degrees with 9 x 3 shots", models.tall),
    _scene("wide", "scan of 19 x 4 degrees with 9 x 3 shots", models.wide),
    _scene("wide paper's form", "the same by the diffusion form of the paper",
           partial(models.wide, model=DiffusionModel())),
    _scene("wide photons", "the same, light followed photon by photon",
           models.wide_photons, (2, 4)),
    _scene("stairs", "dim treads of 3 %", models.staircase),
    _scene("corner", "inside corner at 2.6 m, walls of 40 % light each other",
           models.inside_corner, (1, 2, 4)),
    _scene("coastal", "plate in coastal water", models.coastal),
    _scene("harbour", "plate in harbour water", models.harbour),
    _scene("circular", "plate seen with circular light", models.circular),
    _scene("moving", "sloping sea bed below a vehicle that rolls", models.moving),
    _scene("empty", "water without a target, right survey", models.empty),
    *_photon_scenes(),
    _scene("acquired", "acquired by the simulated bench with stages that jitter",
           acquired.plate_scanned),
    _scene("acquired twice", "the same, broken off and taken up again",
           partial(acquired.plate_scanned, broken=True)),
    _scene("small-angle 90", "Henyey-Greenstein water, split at 90 degrees",
           partial(models.small_angle, split=90.0)),
    _scene("small-angle 15", "Henyey-Greenstein water, split at 15 degrees",
           partial(models.small_angle, split=15.0)),
    _scene("small-angle empty", "Henyey-Greenstein water without a target",
           models.small_angle_empty),
    _scene("paper's form", "plate by the diffusion form of the paper",
           models.paper_form),
    _scene("paper's form empty", "the diffusion form without a target",
           models.paper_form_empty),
    _scene("spikes", "spikes of 5 to 50 sigma in 3 % of the samples", samples.spikes),
    _scene("particles", "bright particles in 4 % of the samples", samples.particles),
    _scene("mixed 2 cm", "pixels that see two plates 2 cm apart",
           partial(samples.mixed, gap=0.02)),
    _scene("mixed 5 cm", "pixels that see two plates 5 cm apart",
           partial(samples.mixed, gap=0.05)),
    _scene("delay", "instrument 0.1 ns late, unknown", samples.late_instrument),
    _scene("noise", "stated noise too small by two", samples.understated_noise),
    _scene("change 5 %", "water 5 % stronger than the shots", samples.changed_water),
    _scene("drift 3 %", "water drifts by 3 % between the shots",
           partial(samples.drift, change=0.03)),
    _scene("drift 10 %", "water drifts by 10 % between the shots",
           partial(samples.drift, change=0.10)),
    _scene("a, b doubled", "the survey's a and b are twice the true ones",
           partial(knowledge.wrong_turbidity, factor=2.0)),
    _scene("a, b halved", "the survey's a and b are half the true ones",
           partial(knowledge.wrong_turbidity, factor=0.5)),
    _scene("baseline", "receiver 5 mm beside where the survey has it",
           knowledge.wrong_baseline),
    _scene("axis", "receiver points 1 degree beside the survey's axis",
           knowledge.wrong_axis),
    _scene("index", "group index 0.002 too large in the survey", knowledge.wrong_index),
    _scene("delay stated", "the same delay, and a calibration that states 0.1 ns",
           partial(knowledge.calibrated, make=samples.late_instrument)),
    _scene("baseline stated", "the same baseline, and a calibration that states 5 mm",
           partial(knowledge.calibrated, make=knowledge.wrong_baseline)),
    _scene("index stated", "the same index, and a calibration that states 0.002",
           partial(knowledge.calibrated, make=knowledge.wrong_index)),
)  # fmt: skip

BY_NAME = {scene.name: scene for scene in SCENES}
