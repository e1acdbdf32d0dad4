"""What cannot be is refused, with what was found and what is needed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amulor.optics.phase_functions.models import isotropic
from amulor.optics.phase_functions.phase_function import PhaseFunction
from amulor.transport import (
    DiscReceiver,
    GaussianReceiver,
    Layer,
    Medium,
    PlaneTarget,
    ScatteringMatrix,
    Source,
    Technique,
    reflection_and_transmission,
    simulate,
)

DISC = DiscReceiver(radius=0.05, acceptance_angle=0.04, position=(0.07, 0.0, 0.0))


def layer(absorption=0.2, scattering=0.8, thickness=math.inf, function=None):
    return Layer(
        absorption=absorption,
        scattering=scattering,
        thickness=thickness,
        phase_function=function or isotropic(),
    )


def layered(*layers, **others):
    return Medium.layered(layers, group_index=1.33, **others)


def homogeneous(function=None, **others):
    values = {"absorption": 0.2, "scattering": 0.8} | others
    return Medium.homogeneous(
        phase_function=function or isotropic(), group_index=1.33, **values
    )


def run(medium=None, source=None, receiver=DISC, frequency=(0.0,), **others):
    values = {"histories": 64, "seed": 1} | others
    return simulate(
        medium or homogeneous(), source or Source(), receiver, frequency, **values
    )


def matrix(*diagonal, angle=(0.0, 1.0, np.pi)):
    full = np.tile(np.diag([1.0, *diagonal]), (len(angle), 1, 1))
    return ScatteringMatrix.tabulated(angle, mueller=full, phase_function=isotropic())


def with_element(row, column, value):
    full = np.tile(np.eye(4), (2, 1, 1))
    full[:, row, column] = value
    return ScatteringMatrix.tabulated(
        [0.0, np.pi], mueller=full, phase_function=isotropic()
    )


class Scaled(PhaseFunction):
    """A phase function with a tenth too much everywhere."""

    factor = 1.1

    def __call__(self, angle):
        return self.factor * super().__call__(angle)

    def cumulative(self, angle):
        return self.factor * super().cumulative(angle)


class Negative(Scaled):
    """One below zero."""

    factor = -1.0


def bare(kind):
    return kind(name="what was measured", panels=isotropic().panels)


REFUSED = {
    "absorption below zero": (
        lambda: layer(absorption=-0.1),
        r"absorption must be at least 0 1/m, got -0\.1 1/m.*albedo.*from 0 to 1",
    ),
    "scattering below zero": (lambda: layer(scattering=-2), r"scattering .*got -2 1/m"),
    "scattering not finite": (lambda: layer(scattering=math.inf), "got inf 1/m"),
    "absorption not a number": (lambda: layer(absorption=math.nan), "got nan 1/m"),
    "thickness of zero": (lambda: layer(thickness=0), "above 0 m, got 0 m"),
    "group index below 1": (
        lambda: Medium.layered([layer()], group_index=0.9),
        r"at least 1, got 0\.9",
    ),
    "no layers": (layered, "at least one layer, got none"),
    "an endless layer within": (
        lambda: layered(layer(), layer(thickness=1.0)),
        "only the last layer may be without a thickness",
    ),
    "no end and no absorption": (
        lambda: homogeneous(absorption=0.0),
        r"without end needs an absorption above 0 1/m",
    ),
    "an endless gap": (
        lambda: layer(absorption=0.0, scattering=0.0),
        "must not both be 0 1/m in a layer without end",
    ),
    "nothing but gaps": (
        lambda: layered(layer(0.0, 0.0, 1.0), layer(0.0, 0.0, 2.0)),
        "only layers with an attenuation of 0 1/m",
    ),
    "some matrices": (
        lambda: layered(layer(thickness=1.0), layer(function=matrix(1, 1, 1))),
        "all layers have a ScatteringMatrix or none",
    ),
    "layers without a top": (
        lambda: layered(layer(thickness=1.0), top=-math.inf),
        "top must be a finite place",
    ),
    "top not a number": (lambda: layered(layer(), top=math.nan), "got nan m"),
    "a phase function of 1.1": (
        lambda: run(homogeneous(bare(Scaled))),
        r"what was measured must have an integral of 1 over the sphere, got 1\.1;",
    ),
    "a phase function below zero": (
        lambda: run(homogeneous(bare(Negative))),
        "what was measured must be finite and not below zero",
    ),
    "an unrealizable matrix": (
        lambda: matrix(1, 1, -1),
        r"cannot exist: at 0 deg .* eigenvalue of -0\.5 of its trace.*-0\.002",
    ),
    "an unrealizable angle": (
        lambda: ScatteringMatrix(
            isotropic(), np.array([0.0, 1.0, np.pi]),
            np.array([[0, 1, 1, 0, 1], [0.9, 1, 0.8, 0, 0.8], [0, 1, -1, 0, -1]]),
        ),
        r"cannot exist: at 57\.3 deg",
    ),
    "a matrix of another form": (
        lambda: with_element(0, 2, 0.25),
        r"element that is off by 0\.25",
    ),
    "a matrix with a hole": (lambda: with_element(0, 3, np.nan), "off by nan"),
    "angles that end early": (
        lambda: matrix(1, 1, 1, angle=(0.0, 1.0, 3.0)),
        "rise from 0 to pi rad, got values from 0 to 3 rad",
    ),
    "angles that fall": (
        lambda: matrix(1, 1, 1, angle=(0.0, 2.0, 1.0, np.pi)),
        "rise from 0 to pi rad",
    ),
    "matrices of another number": (
        lambda: ScatteringMatrix.tabulated(
            [0.0, 1.0, np.pi], mueller=np.eye(4), phase_function=isotropic()
        ),
        r"shape \(3, 4, 4\), got \(4, 4\)",
    ),
    "elements not finite": (
        lambda: ScatteringMatrix(
            isotropic(), np.array([0.0, np.pi]), np.full((2, 5), np.nan)
        ),
        "finite numbers",
    ),
    "too few elements": (
        lambda: ScatteringMatrix(isotropic(), np.array([0.0, np.pi]), np.ones((2, 4))),
        r"got \(2, 4\) and \(2,\)",
    ),
    "polarized light without a matrix": (
        lambda: run(source=Source(polarization="H")),
        "polarized light needs a medium with a ScatteringMatrix",
    ),
    "too much polarization": (
        lambda: Source(polarization=(1, 0.8, 0.8, 0)),
        r"degree above 1, got 1\.13137",
    ),
    "an intensity of 2": (
        lambda: Source(polarization=(2, 0, 0, 0)),
        r"intensity of 1, got \(2, 0, 0, 0\)",
    ),
    "a state unheard of": (lambda: Source(polarization="X"), "got 'X'"),
    "a wide divergence": (
        lambda: Source(divergence=0.6), r"not exceed 0\.5 rad, got 0\.6 rad"
    ),
    "a beam of radius -1": (lambda: Source(radius=-1.0), r"at least 0 m, got -1\.0"),
    "a beam without direction": (
        lambda: Source(direction=(0, 0, 0)), "length above zero"
    ),
    "a beam to the right": (
        lambda: Source(direction=(2.0, 0, 0)), "not lie along the axis to the right"
    ),
    "a place in two numbers": (
        lambda: Source(position=(0, 1)), r"three finite numbers .*got \(0, 1\)"
    ),
    "a receiver without a face": (
        lambda: DiscReceiver(radius=0.0, acceptance_angle=0.1),
        r"radius must be above 0 m, got 0\.0",
    ),
    "an acceptance beyond the plane": (
        lambda: GaussianReceiver(radius=0.1, acceptance_angle=1.6),
        r"acceptance_angle must not exceed 1\.5708 rad, got 1\.6",
    ),
    "a reflectance of 1.2": (
        lambda: PlaneTarget(position=(0, 0, 1), reflectance=1.2),
        r"from 0 to 1, got 1\.2",
    ),
    "a gloss beside a bright surface": (
        lambda: PlaneTarget(
            position=(0, 0, 1), reflectance=0.8, gloss=0.3, rms_slope=0.1
        ),
        r"gloss must be from 0 to 1, .*not above 1, got 0\.3 and 0\.8",
    ),
    "a gloss without facets": (
        lambda: PlaneTarget(position=(0, 0, 1), reflectance=0.2, gloss=0.3),
        r"rms_slope of a glossy target must be from 0\.02 to 0\.5, got 0\.0",
    ),
    "an unrealizable target": (
        lambda: PlaneTarget(
            position=(0, 0, 1), reflectance=1, mueller=np.diag([1, 1, 1, -1.0])
        ),
        r"mueller cannot exist: .*eigenvalue of -0\.5 of its trace",
    ),
    "a target of unlike numbers": (
        lambda: PlaneTarget(
            position=(0, 0, 1), reflectance=1, mueller=np.diag([1, np.nan, 0, 0])
        ),
        "mueller must hold finite numbers",
    ),
    "a target matrix of 0.5": (
        lambda: PlaneTarget(position=(0, 0, 1), reflectance=1, mueller=np.eye(4) / 2),
        "first element of 1",
    ),
    "a source behind the target": (
        lambda: run(target=PlaneTarget(position=(0, 0, -0.5), reflectance=0.5)),
        r"source must be in front of the target.*got -0\.5 m",
    ),
    "a receiver that faces the source": (
        lambda: run(receiver=facing()),
        r"must not see the source: the beam's axis falls 0 m from the middle",
    ),
    "a wide beam that reaches the receiver": (
        lambda: run(source=Source(divergence=0.05), receiver=facing(off=0.4)),
        r"must not see the source: .* 0\.4 m from the middle",
    ),
    "a receiver behind the target": (
        lambda: run(
            receiver=DiscReceiver(
                radius=0.05, acceptance_angle=0.1, position=(0, 0, 1.25)
            ),
            target=PlaneTarget(position=(0, 0, 1), reflectance=0.5),
        ),
        r"centre of the receiver must be in front of the target.*got -0\.25 m",
    ),
    "a receiver's edge in the target": (
        lambda: run(
            target=PlaneTarget(
                position=(0.08, 0, 0), normal=(-1, 0, 0), reflectance=0.5
            )
        ),
        r"must not reach into the target: its centre is 0\.01 m in front, .* 0\.05 m",
    ),
    "zero histories": (lambda: run(histories=0), "histories .*at least 1, got 0"),
    "half a history": (lambda: run(histories=2.5), r"whole number.*got 2\.5"),
    "no number of histories": (lambda: run(histories=math.nan), "got nan"),
    "endless histories": (lambda: run(histories=math.inf), "got inf"),
    "a seed below zero": (lambda: run(seed=-1), "seed .*at least 0, got -1"),
    "half a seed": (lambda: run(seed=1.5), r"seed .*whole number.*got 1\.5"),
    "no threads": (lambda: run(threads=0), "threads .*at least 1, got 0"),
    "an error of zero": (
        lambda: run(relative_error=0.0), r"relative_error must be above 0, got 0\.0"
    ),
    "a time of zero": (
        lambda: run(longest_time=0.0), r"longest_time must be above 0 s, got 0\.0"
    ),
    "a frequency below zero": (
        lambda: run(frequency=[1e6, -2e6]),
        r"not below 0 Hz, got -2e\+06 Hz",
    ),
    "an infinite frequency": (
        lambda: run(frequency=[0.0, np.inf]), "must be finite .*got inf Hz"
    ),
    "a single frequency": (lambda: run(frequency=5e6), r"got the shape \(\)"),
    "no frequencies": (lambda: run(frequency=[]), r"got the shape \(0,\)"),
    "a group of no paths": (lambda: Technique(paths=0), "paths .*number from 1, got 0"),
    "a batch of parts of groups": (
        lambda: Technique(batch=100),
        "batch must be a multiple of the 8 paths of a group, got 100",
    ),
    "no orders": (
        lambda: Technique(scattering_orders=0),
        "scattering_orders .*number from 1, got 0",
    ),
    "layers and a tilted receiver": (
        lambda: run(
            layered(layer(thickness=1.0), layer()),
            receiver=DiscReceiver(
                radius=0.05, acceptance_angle=0.1, direction=(0, 0.1, 1.0)
            ),
        ),
        r"look along the forward axis, .*got a tilt of 5\.711 deg",
    ),
    "a source out of the water": (
        lambda: run(layered(layer(), top=0.5)),
        r"source must be in the water, from 0\.5 to inf m forward, got 0 m",
    ),
    "a receiver out of the water": (
        lambda: run(
            layered(layer(thickness=2.0)),
            receiver=DiscReceiver(
                radius=0.05, acceptance_angle=0.1, position=(0, 0, 2.5)
            ),
        ),
        r"receiver must be in the water, from 0 to 2 m forward, got 2\.5 m",
    ),
    "a slab without a top": (
        lambda: reflection_and_transmission(
            homogeneous(), [0.0], histories=10, seed=1
        ),
        "medium must have a finite top",
    ),
    "light along a slab": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, incidence=np.pi / 2
        ),
        r"incidence .*got 1\.570",
    ),
    "polarized light on a scalar slab": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, polarization="R"
        ),
        "polarized light needs a medium with a ScatteringMatrix",
    ),
    "a way along a slab": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, outward=[(np.pi / 2, 0)]
        ),
        "polar angles must be from 0 to pi rad, pi / 2 left out",
    ),
    "a way in one number": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, outward=[1.0, 2.0]
        ),
        r"shape \(m, 2\), got the shape \(2,\)",
    ),
    "a slab thinner than its surroundings": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, index_ratio=0.9
        ),
        "index_ratio must be one or two numbers from 1, got 0.9",
    ),
    "a slope of a cliff": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, index_ratio=1.3,
            rms_slope=1.5,
        ),
        "rms_slope must be from 0 to below 1, got 1.5",
    ),
    "a rough face that does not refract": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, index_ratio=(1.0, 1.3),
            rms_slope=0.1,
        ),
        "a rough face needs an index_ratio above 1, got 1",
    ),
    "radiant intensity through waves": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, index_ratio=1.3,
            rms_slope=0.1, outward=[(0.2, 0)],
        ),
        "a rough face needs no outward directions; set rms_slope to 0, got 0.1",
    ),
    "a disc without a size": (
        lambda: reflection_and_transmission(
            layered(layer()), [0.0], histories=10, seed=1, discs=[0.1, 0.0]
        ),
        r"discs must be a list of radii above 0 m, got \[0.1, 0.0\]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_is_refused_with_its_number(what):
    make, words = REFUSED[what]
    with pytest.raises(ValueError, match=words) as info:
        make()
    assert str(info.value).isprintable()


def test_a_printed_table_may_be_off_by_its_last_digit():
    # An integral of 1.001, as three digits give it, is taken as 1.
    nearly = bare(Scaled)
    object.__setattr__(nearly, "factor", 1.001)
    exact = run(histories=256)
    divided = run(homogeneous(nearly), histories=256)
    np.testing.assert_allclose(divided.signal, exact.signal)
    # The tally tells what it was divided by.
    assert divided.phase_function_integral == pytest.approx((1.001,), rel=1e-9)
    assert exact.phase_function_integral == pytest.approx((1.0,), rel=1e-12)
    both = layered(layer(thickness=1.0), layer(function=nearly))
    assert run(both).phase_function_integral == pytest.approx((1.0, 1.001), rel=1e-9)


def facing(off=0.0, **others):
    """Return a receiver 3 m ahead that looks back at the source."""
    return DiscReceiver(
        radius=0.05, position=(off, 0, 3), direction=(0, 0, -1),
        **({"acceptance_angle": 0.1} | others),
    )  # fmt: skip


def test_a_receiver_beside_the_beam_that_looks_back_gets_scattered_light():
    for receiver in (facing(off=0.06), facing(off=-0.5, acceptance_angle=1.5)):
        assert run(receiver=receiver, histories=4096).signal[0].real > 0
    # Beyond its acceptance, or with the beam on its back, it sees no source.
    slanted = Source(position=(-0.6, 0, 0), direction=(0.2, 0, 1))
    assert run(source=slanted, receiver=facing()).histories == 64
    behind = DiscReceiver(radius=0.05, acceptance_angle=0.1, position=(0, 0, 3))
    assert run(receiver=behind).histories == 64


def test_at_the_limits_of_what_can_be_a_run_is_made():
    target = PlaneTarget(position=(0.13, 0, 0), normal=(-1, 0, 0), reflectance=1.0)
    assert np.isfinite(run(target=target).signal).all()
    plane = DiscReceiver(radius=0.05, acceptance_angle=np.pi / 2)
    assert np.isfinite(run(receiver=plane).signal).all()
    dark = homogeneous(scattering=0.0)
    assert run(dark).signal[0] == 0


def test_half_a_path_in_a_group_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"paths must be a whole number from 1, got 2.5"
    ):
        Technique(paths=2.5)  # type: ignore[arg-type]


def test_a_run_goes_on_with_its_own_groups_only(peaked_water) -> None:
    receiver = DiscReceiver(radius=0.05, acceptance_angle=0.05)
    first = simulate(
        peaked_water, Source(), receiver, [0.0], histories=16, seed=1,
        technique=Technique(paths=4),
    )  # fmt: skip
    with pytest.raises(ValueError, match="groups of 16 paths do not fill"):
        simulate(
            peaked_water, Source(), receiver, [0.0], histories=64, seed=1,
            technique=Technique(paths=16), resume=first,
        )  # fmt: skip
