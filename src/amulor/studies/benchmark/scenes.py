"""Public scenes of the benchmark: a file of descriptions, and their simulation."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from amulor import cube as cubes
from amulor.errors import SurveyError
from amulor.optics.polarization import mueller
from amulor.simulation import lock_in, simulate
from amulor.simulation.geometry import Setup
from amulor.studies.benchmark import light
from amulor.studies.trust.case import Case, case_of, lateness
from amulor.studies.trust.scenes import instrument, samples
from amulor.studies.trust.scenes.catalogue import BY_NAME
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.scenes.photons import with_samples
from amulor.studies.trust.surveys import plate, survey
from amulor.survey import Survey, water_properties
from amulor.survey.mueller import SURFACES, matrix

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]

FILE = Path(__file__).with_name("scenes.toml")
ROWS, COLUMNS = 12, 20
#: Open-water references, half of them recorded after the scan.
_REPEATS = 60
#: Phase uncertainty that the survey states: of a calibrated instrument, and of the
#: photon noise of the light [rad].
_PHASE = np.radians(0.2)
#: Part of the light of a mixed pixel that meets the nearer surface [1], and parts of
#: three surfaces, the nearest first.
_SHARE, _THREE = 0.4, (0.3, 0.4, 0.3)
#: Places of the treads of stairs, the farthest first [m].
_TREADS = np.array([0.10, 0.06, 0.03, 0.01, 0.0])
#: Reflectance of dark spots, relative to bright ones [1].
_DARK = 1 / 3
#: Growth of the water signal of the disturbance "drift" [1], and the ratio of true to
#: stated noise of "noise" [1].
_DRIFT, _NOISE = 0.03, 2.0

Layout = Literal["plate", "stairs", "edges", "object", "net", "two", "three", "empty"]
Frequencies = Literal["one", "two", "four", "sixteen", "sweep"]


class Scene(BaseModel):
    """Scene of the benchmark as described in a file."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", use_attribute_docstrings=True
    )

    name: Annotated[str, Field(pattern=r"^[a-z0-9-]+$")]
    """Name of the scene."""
    title: str
    """Description of the scene."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of the noise, the spots and the disturbances."""
    quick: bool = False
    """Whether the quick form of the benchmark has the scene."""
    frequencies: Frequencies = "four"
    """Set of modulation frequencies."""
    trust: str | None = None
    """Scene of the trust study; None for light from the table of photon transport."""
    water: str | None = None
    """Water of the table."""
    distance: float | None = None
    """Distance of the plate, of the table [m]."""
    layout: Layout = "plate"
    """Arrangement of the surfaces: a plate, stairs of five treads, an object 12 cm in
    front of a plate, an object in open water, a net 12 cm in front of a plate, two or
    three surfaces 12 cm apart in each beam, or none."""
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.1
    """Reflectance of the surfaces, of bright spots if there are spots [1]."""
    texture: bool = False
    """Whether half of the surface has dark spots with a third of the reflectance."""
    glossy: bool = False
    """Whether half of the surface has glossy spots, which mirror 4 % of the light."""
    instrument: str | None = None
    """Kind of instrument error, in its typical size and without calibration."""
    disturbance: Literal["particles", "spikes", "drift", "noise"] | None = None
    """Disturbance of the samples."""

    @model_validator(mode="after")
    def _light_is_available(self) -> Scene:
        if self.trust is not None:
            if self.trust not in BY_NAME:
                raise ValueError(f"there is no scene {self.trust!r} of the trust study")
            return self
        available = {
            (name, distance)
            for name, water in light.WATERS.items()
            for distance in (water.glossy if self.glossy else water.distances)
        }
        if (self.water, self.distance) not in available:
            listed = ", ".join(light.key(*pair) for pair in sorted(available))
            raise ValueError(
                f"there is no light for water {self.water!r} at {self.distance} m; "
                f"there is {listed}"
            )
        if self.instrument is not None and self.instrument not in instrument.KINDS:
            raise ValueError(f"there is no instrument error {self.instrument!r}")
        return self

    @property
    def digest(self) -> str:
        """First digits of the SHA-256 digest of the description and its light."""
        content = self.model_dump(mode="json", exclude={"title", "quick"})
        text = json.dumps(content, sort_keys=True)
        if self.water is not None and self.distance is not None:
            text += light.digest(self.water, self.distance, glossy=self.glossy)
            text += _survey(self).to_toml()
        return hashlib.sha256(text.encode()).hexdigest()[:8]

    @property
    def lengths(self) -> float:
        """Attenuation lengths to the surface, one way; NaN for the trust study [1]."""
        if self.water is None or self.distance is None:
            return float("nan")
        water = light.WATERS[self.water]
        return (water.absorption + water.scattering) * self.distance

    @property
    def count(self) -> int:
        """Number of modulation frequencies."""
        return len(light.FREQUENCIES[self.frequencies])

    def case(self) -> Case:
        """Simulate the scene."""
        if self.trust is not None:
            return BY_NAME[self.trust].make(self.count, self.seed)
        return _photon_case(self)


def read(path: Path = FILE) -> list[Scene]:
    """Read the scenes of a file; SurveyError if it is wrong."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        scenes = [Scene.model_validate(entry) for entry in content["scenes"]]
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SurveyError(f"{path}: cannot be read as scenes: {error}") from error
    except (KeyError, TypeError) as error:
        raise SurveyError(f"{path}: there is no list [[scenes]]") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise SurveyError(f"{path}: {place or 'scene'}: {first['msg']}") from error
    names = [scene.name for scene in scenes]
    if len(set(names)) < len(names):
        raise SurveyError(f"{path}: two scenes have the same name")
    return scenes


def _photon_case(scene: Scene) -> Case:
    """Simulate samples of a fixed beam whose light is in the table."""
    assert scene.water is not None
    assert scene.distance is not None
    frequency = np.array(light.FREQUENCIES[scene.frequencies])
    table = light.read(scene.water, scene.distance, highest=frequency.max())
    planned = _survey(scene)
    chosen = np.searchsorted(light.ALL, frequency)
    rng = np.random.default_rng(scene.seed + 1)
    share, reflectance = _arranged(scene, rng)
    shine = _spots(rng) if scene.glossy else np.zeros((ROWS, COLUMNS), bool)
    empty = 1 - share.sum(axis=0)
    brightness = share * reflectance / light.REFLECTANCE
    echo = np.tensordot(table.echo, brightness, axes=1)
    water = np.tensordot(table.water, share, axes=1)
    water += table.open_water[:, None, None] * empty
    haze = water_properties(planned).backscatter_mueller
    paint = planned.targets[0].mueller if planned.targets else haze
    frame, setup = simulate(planned, rng=scene.seed), Setup(planned)
    noise = np.random.default_rng(scene.seed)
    of_target = _light(planned, echo, chosen, paint)
    late = [_late(table.echo, scene)] * 2
    if scene.glossy:
        facets = light.read_facets(scene.water, scene.distance)
        mirrored = np.tensordot(facets, share * shine, axes=1)
        metal = _light(planned, mirrored, chosen, SURFACES["smooth-metal"])
        of_target = lock_in.Light(
            of_target.modulated + metal.modulated, of_target.mean + metal.mean
        )
        matte = scene.reflectance / light.REFLECTANCE
        late[1] = _late(matte * table.echo + facets, scene)
    of_water = _light(planned, water, chosen, haze)
    shots = np.repeat(table.open_water[:, None], frame.sizes["shot"], axis=1)
    of_shots = _light(planned, shots, chosen, haze)
    dark = lock_in.Light(
        np.zeros_like(of_shots.modulated), np.zeros_like(of_shots.mean)
    )
    cube = with_samples(
        frame, "", lock_in.sample(setup, of_target, of_water, rng=noise)
    )
    cube = with_samples(
        cube, "open_water_", lock_in.sample(setup, dark, of_shots, rng=noise)
    )
    for which, source in (("target", of_target), ("water", of_water)):
        signal = lock_in.expected_signal(setup, source)
        cube = cube.assign(
            {
                f"truth_{which}_in_phase": frame["in_phase"].copy(data=signal.real),
                f"truth_{which}_quadrature": frame["in_phase"].copy(data=signal.imag),
            }
        )
    cube = cubes.note(_disturbed(scene, cube), "light from photon transport")
    distance = scene.distance + light.OFFSETS
    surfaces = np.where(share > 0, distance[:, None, None], np.nan)
    largest = share.argmax(axis=0)
    return case_of(
        cube.assign_attrs(late_echo="present"),
        interval=around(scene.distance),
        surfaces=surfaces[(share > 0).any(axis=(1, 2))]
        if share.any()
        else surfaces[:1],
        late=np.where(shine, late[1][largest], late[0][largest]),
    )


def _late(echo: Complex, scene: Scene) -> Floats:
    """Return the lateness of echoes by offset, shape (offsets,) [m]."""
    assert scene.distance is not None
    frequency = np.array(light.FREQUENCIES[scene.frequencies])
    distance = scene.distance + light.OFFSETS
    return lateness(
        echo[np.searchsorted(light.ALL, frequency)],
        light.GROUP_INDEX * (distance + np.hypot(distance, light.BASELINE)),
        modulation_frequency=frequency,
        group_index=light.GROUP_INDEX,
    )


def _survey(scene: Scene) -> Survey:
    """Return the survey of a scene, with the water and the geometry of its light."""
    assert scene.water is not None
    assert scene.distance is not None
    water = light.WATERS[scene.water]
    properties = {
        "absorption": water.absorption,
        "scattering": water.scattering,
        # Replaced by what the scene states.
        "asymmetry": 0.9,
    }
    planned = survey(
        scene.count,
        *(
            ()
            if scene.layout == "empty"
            else (plate(scene.distance, reflectance=scene.reflectance),)
        ),
        water=properties,
        frequencies=light.FREQUENCIES[scene.frequencies],
        wide=0,
        tall=0,
        shot_columns=1,
        shot_rows=1,
        repeats=_REPEATS,
        rows=ROWS,
        columns=COLUMNS,
    )
    changes: dict[str, Any] = {"water.asymmetry": None}
    changes |= {f"water.{name}": value for name, value in water.stated.items()}
    changes["instrument.phase_uncertainty"] = _PHASE
    if scene.instrument is not None:
        kind = instrument.KINDS[scene.instrument]
        # Without a calibration the survey states no phase uncertainty.
        changes["instrument.phase_uncertainty"] = None
        changes["instrument.lock_in.demodulator"] = kind.demodulator
    return planned.with_(changes)


def _arranged(scene: Scene, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return shares of the beam by offset, row and column, and reflectances [1]."""
    share = np.zeros((light.OFFSETS.size, ROWS, COLUMNS))
    near, plain, far = (
        int(np.abs(light.OFFSETS - step).argmin()) for step in (-0.12, 0.0, 0.12)
    )
    rows, columns = np.arange(ROWS)[:, None], np.arange(COLUMNS)
    if scene.layout == "stairs":
        place = _TREADS[_TREADS.size * columns // COLUMNS]
        share[np.searchsorted(light.OFFSETS, place), :, columns] = 1.0
    elif scene.layout == "three":
        share[[near, plain, far]] = np.array(_THREE)[:, None, None]
    elif scene.layout == "object":
        share[plain, 3:9, 5:15] = 1.0
    elif scene.layout != "empty":
        part = np.zeros((ROWS, COLUMNS))
        if scene.layout == "two":
            part[:] = _SHARE
        elif scene.layout == "net":
            part[(rows % 5 == 2) | (columns % 5 == 2)] = _SHARE
        elif scene.layout == "edges":
            part[3:9, 5:15] = _SHARE
            part[4:8, 6:14] = 1.0
        share[near], share[plain] = part, 1 - part
    reflectance = np.full((ROWS, COLUMNS), scene.reflectance)
    if scene.texture:
        reflectance[_spots(rng)] *= _DARK
    return share, reflectance


def _spots(rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return spots of two by two pixels on half of the surface."""
    drawn = rng.integers(0, 2, (ROWS // 2, COLUMNS // 2))
    return np.equal(drawn.repeat(2, 0).repeat(2, 1), 1)


def _disturbed(scene: Scene, cube: xr.Dataset) -> xr.Dataset:
    """Return samples with the instrument error and the disturbance of the scene."""
    if scene.instrument is not None:
        recorded = instrument.Recorded(scene.count, scene.seed, cube=cube)
        effect = instrument.KINDS[scene.instrument].of_size(1.0)
        cube = instrument.with_outputs(recorded.cube, *effect(recorded))
    if scene.disturbance is None:
        return cube
    assert scene.distance is not None
    change: dict[str, Callable[[xr.Dataset], xr.Dataset]] = {
        "particles": partial(
            samples.with_particles,
            seed=scene.seed,
            nearest=0.3 * scene.distance,
            farthest=0.9 * scene.distance,
        ),
        "spikes": partial(samples.with_spikes, seed=scene.seed),
        "drift": partial(samples.with_drift, change=_DRIFT, repeats=_REPEATS),
        "noise": partial(samples.with_understated_noise, factor=_NOISE),
    }
    return change[scene.disturbance](cube)


def _light(
    planned: Survey, response: Complex, chosen: NDArray[np.intp], scatterer: object
) -> lock_in.Light:
    """Return light behind the analyzers, shape (frequency, channel, pixels...)."""
    passed = np.array(
        [
            float(mueller.detected_fraction(matrix(scatterer), pair=pair))
            for pair in planned.instrument.polarizations
        ]
    ).reshape(-1, *[1] * (response.ndim - 1))
    modulated = response[chosen][:, None] * passed
    mean = np.maximum(response[:1].real, 0.0)[:, None] * passed
    return lock_in.Light(modulated, np.broadcast_to(mean, modulated.shape).copy())
