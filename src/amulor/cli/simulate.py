"""`amulor simulate`: simulated measurement cube of a survey."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from amulor.cli._arguments import (
    SEED,
    UsageError,
    check_cube_output,
    check_tile_rows,
    quantity_of,
)
from amulor.cli._output import print_next, progress_bar, warnings_as_notes


def simulate(
    survey: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    model: Literal["small-angle", "closure", "diffusion", "photons"] = "small-angle",
    error: str = "0.5%",
    seed: Annotated[int, Parameter(validator=SEED)] = 1,
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate a survey; write its measurement cube.

    If the survey has a section [platform], the trajectory that the vehicle measures is
    written beside it: samples.nc and samples.trajectory.csv.

    Parameters
    ----------
    survey
        Survey file (TOML).
    output
        File to write (netCDF).
    model
        Forward model. "small-angle" uses the whole phase function, "closure" is its
        fast and rougher approximation, "diffusion" is the form in the paper. "photons"
        simulates all orders of scattering and takes minutes.
    error
        Relative error of the unmodulated light at which the photon simulation stops. It
        is added to the uncertainty of the samples.
    seed
        Seed of the simulated noise and of the photon simulation.
    tile_rows
        Simulate this many rows at a time, with bounded memory. Scans of more than 2.1
        million samples are always simulated by rows. The photon model needs the whole
        scan at once.
    overwrite
        Replace an existing file.
    """
    goal = quantity_of("--error", error, "fraction")
    if not 0 < goal < 1:
        raise UsageError(
            f"--error: needed is a relative error above 0 and below 1, found {error}"
        )
    check_tile_rows(tile_rows)
    check_cube_output(output, overwrite=overwrite, inputs=[survey])
    track = output.with_suffix(".trajectory.csv")

    from amulor import _progress, io
    from amulor.cube.tiles import is_large
    from amulor.errors import SurveyError
    from amulor.io.trajectories import write_trajectory
    from amulor.simulation import (
        ClosureModel,
        DiffusionModel,
        SignalModel,
        SmallAngleModel,
        measured_trajectory,
    )
    from amulor.simulation import simulate as simulate_survey
    from amulor.survey import Survey
    from amulor.survey.directions import MOST_SAMPLES, samples_of
    from amulor.survey.reach import unsettled_interval

    described = Survey.from_toml(survey)
    if described.platform is not None:
        io.check_output(track, overwrite=overwrite, inputs=[survey])
    samples = samples_of(described)
    large = samples > MOST_SAMPLES if model == "photons" else is_large(8 * samples)
    by_rows = tile_rows is not None or large
    try:
        with warnings_as_notes(), progress_bar() as advance, _progress.part(0.0, 0.9):
            chosen: SignalModel
            match model:
                case "small-angle":
                    chosen = SmallAngleModel()
                case "closure":
                    chosen = ClosureModel()
                case "diffusion":
                    chosen = DiffusionModel()
                case "photons":
                    # Imported here, because other simulations need no photon transport.
                    from amulor.simulation import PhotonModel

                    chosen = PhotonModel(relative_error=goal, seed=seed)
            if by_rows:
                # Imported here, because other simulations need no processing by rows.
                from amulor.scale.simulated import simulate_file

                summary = simulate_file(
                    described, output, rng=seed, model=chosen, rows=tile_rows,
                    overwrite=overwrite,
                )  # fmt: skip
                sizes, hit, overload = summary.sizes, summary.hit, summary.saturated
            else:
                cube = simulate_survey(described, rng=seed, model=chosen)
                advance(f"writing {output}", 0.9)
                io.write_cube(cube, output, overwrite=overwrite)
                sizes = {str(name): size for name, size in cube.sizes.items()}
                hit = float((cube.amulor.truth["target"] >= 0).mean())
                overload = float((cube["saturated"] != 0).mean())
            if described.platform is not None:
                write_trajectory(
                    measured_trajectory(described, rng=seed), track, overwrite=overwrite
                )
    except SurveyError as problem:
        raise SurveyError(f"{survey}: {problem}") from None
    print(f"{output}: {', '.join(f'{name} {count}' for name, count in sizes.items())}")
    if described.platform is not None:
        print(f"{track}: trajectory, for amulor export --trajectory")
    if described.targets:
        print(
            f"{hit:.1%} of the beams meet a target, {overload:.1%} of the samples "
            "overload the detector"
        )
    reason = unsettled_interval(
        described, modulation_frequency=described.instrument.modulation_frequencies
    )
    if reason and described.targets:
        print(f"note: {reason}; amulor image will need --nearest and --farthest")
    print_next(f"amulor reject {output} --method auto -o target.nc")
