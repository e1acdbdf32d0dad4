"""`amulor backscatter`: the water signal against modulation frequency."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from amulor.cli._arguments import (
    SEED,
    UsageError,
    check_ending,
    check_inputs,
    frequencies_of,
    quantity_of,
)
from amulor.cli._output import (
    print_json,
    print_table,
    progress_bar,
    warnings_as_notes,
)

if TYPE_CHECKING:
    from amulor.survey import Survey
    from amulor.transport.monte_carlo import Spread


def backscatter(
    survey: Path,
    /,
    *,
    frequency: str = "0.5MHz:138MHz:200",
    model: Literal[
        "small-angle", "closure", "diffusion", "photons", "montecarlo"
    ] = "small-angle",
    error: str = "1%",
    seed: Annotated[int, Parameter(validator=SEED)] = 1,
    scheduler: str | None = None,
    batches: Path | None = None,
    plot: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compute the water signal against modulation frequency.

    Parameters
    ----------
    survey
        Survey file (TOML), of which water and instrument are used.
    frequency
        Modulation frequencies: a list such as "10MHz,39MHz", or first, last and number.
    model
        Forward model. "small-angle" uses the whole phase function, "closure" is its
        fast approximation, "diffusion" is the form in the paper. "photons" (or
        "montecarlo") simulates all orders of scattering.
    error
        Relative error of the unmodulated light at which the photon simulation stops.
    seed
        Seed of the photon simulation.
    scheduler
        Simulate the photons on a cluster: address of a dask scheduler, such as
        tcp://node1:8786, or "local" for processes on this computer. Needs --batches.
    batches
        Folder for the photon batches of --scheduler, on a disk that all workers share.
        Batches of earlier runs are used again.
    plot
        Figure to write (PNG or SVG).
    overwrite
        Replace an existing figure.
    json
        Print the result as JSON.
    """
    from amulor.errors import SurveyError

    listed = frequencies_of("--frequency", frequency)
    goal = quantity_of("--error", error, "fraction")
    if not goal > 0:
        raise UsageError(f"--error: needed is a relative error above 0, found {error}")
    followed = model in ("photons", "montecarlo")
    if scheduler is not None and not followed:
        raise UsageError("--scheduler goes with --model photons")
    if (scheduler is None) != (batches is None):
        raise UsageError("--scheduler and --batches go together")
    if plot is not None:
        check_ending("--plot", plot, [".png", ".svg"])
    check_inputs(survey)

    import numpy as np

    from amulor import io
    from amulor.survey import Survey

    frequencies = np.array(listed)
    if plot is not None:
        io.check_output(plot, overwrite=overwrite, inputs=[survey])
    described = Survey.from_toml(survey)
    try:
        if followed:
            with _spread(scheduler, batches) as spread:
                response = _followed(
                    described,
                    frequencies,
                    error=goal,
                    seed=seed,
                    quiet=json,
                    spread=spread,
                )
        else:
            with warnings_as_notes(), progress_bar(quiet=json) as advance:
                advance("light of the water", 0.0)
                response = _formula(described, frequencies, model=model)
        if response["power_share_unmodulated"] == 0:
            raise ValueError(
                "the receiver gets no light from this water; check receiver position, "
                "axis and acceptance, and phase_function_at_180"
            )
    except ValueError as problem:
        raise SurveyError(f"{survey}: {problem}") from None
    if plot is not None:
        from amulor.view import figures

        name = f"{model} model"
        relative = response["relative_amplitude"] * np.exp(1j * response["phase_rad"])
        errors = response.get("relative_amplitude_uncertainty")
        half_power = response["cut_off_hz"]
        figures.write_response_curves(
            plot,
            frequencies,
            {name: relative},
            cut_off=None if math.isnan(half_power) else half_power,
            errors=None if errors is None else {name: errors},
            title=described.name,
            overwrite=overwrite,
        )
    if json:
        print_json(response)
    else:
        _print(described.name, response)
    if response.get("interrupted"):
        raise KeyboardInterrupt


def _formula(survey: Survey, frequencies: Any, *, model: str) -> dict[str, Any]:
    """Compute the water signal by an analytical model."""
    import numpy as np

    from amulor.optics import low_pass
    from amulor.simulation import backscatter as models

    response_of = {
        "diffusion": models.diffusion_response,
        "small-angle": models.small_angle_response,
        "closure": models.closure_response,
    }[model]
    response = response_of(survey, frequencies)
    still = float(abs(response_of(survey, np.zeros(1))[0]))
    result = {
        "model": model,
        "power_share_unmodulated": still,
        "cut_off_hz": math.nan,
        "fitted_cut_off_hz": None,
        "fitted_cut_off_uncertainty_hz": None,
        "modulation_frequency_hz": frequencies,
        "relative_amplitude": abs(response) / still if still else abs(response),
        "phase_rad": np.angle(response),
    }
    if still:
        result["cut_off_hz"] = low_pass.cut_off(lambda f: response_of(survey, f))
        if len(response) > 2:
            fitted = low_pass.fit(frequencies, abs(response))
            result["fitted_cut_off_hz"] = fitted.cut_off
            result["fitted_cut_off_uncertainty_hz"] = fitted.cut_off_standard_error
    return result


def _spread(
    scheduler: str | None, batches: Path | None
) -> AbstractContextManager[Spread | None]:
    """Connect photon transport to a cluster; yield None without a scheduler."""
    if scheduler is None or batches is None:
        return nullcontext()
    from amulor.scale.batches import spread_batches

    return spread_batches(batches, scheduler=scheduler)


def _followed(
    survey: Survey,
    frequencies: Any,
    *,
    error: float,
    seed: int,
    quiet: bool,
    spread: Spread | None,
) -> dict[str, Any]:
    """Compute the water signal by photon transport, with standard errors."""
    import numpy as np

    from amulor.optics import low_pass
    from amulor.simulation import transport

    rising = np.unique(np.concatenate([[0.0], frequencies]))
    with progress_bar(quiet=quiet) as advance:
        advance("first photons", 0.0)
        tally = transport.monte_carlo_response(
            survey,
            rising,
            relative_error=error,
            seed=seed,
            spread=spread,
            progress=lambda state: advance(
                f"error {100 * state.relative_error:.2g} %, "
                f"{_time_left(state, error)}{state.histories:,} photons",
                min(1.0, (error / state.relative_error) ** 2),
            ),
        )
    still = float(abs(tally.signal[0]))
    chosen = np.searchsorted(rising, frequencies)
    cut_off, cut_off_error = transport.half_power(tally)
    relative = np.abs(tally.signal[chosen]) / still
    fitted = low_pass.fit(frequencies, relative) if len(frequencies) > 2 else None
    ratio_error = transport.relative_amplitude_uncertainty(tally)[chosen]
    return {
        "model": "montecarlo",
        "power_share_unmodulated": still,
        "power_share_unmodulated_uncertainty": float(tally.amplitude_uncertainty[0]),
        "cut_off_hz": cut_off,
        "cut_off_uncertainty_hz": cut_off_error,
        "fitted_cut_off_hz": None if fitted is None else fitted.cut_off,
        "fitted_cut_off_uncertainty_hz": (
            None if fitted is None else fitted.cut_off_standard_error
        ),
        "modulation_frequency_hz": frequencies,
        "relative_amplitude": relative,
        "relative_amplitude_uncertainty": ratio_error,
        "phase_rad": np.angle(tally.signal[chosen]),
        "phase_uncertainty_rad": tally.phase_uncertainty[chosen],
        "share_by_scattering_order": [
            float(abs(light[0]) / still)
            for name, light in tally.by_part.items()
            if name.startswith("water")
        ],
        "histories": tally.histories,
        "seed": seed,
        "interrupted": tally.interrupted,
        "heavy_tailed": tally.heavy_tailed,
    }


def _time_left(state: Any, error: float) -> str:
    """Return the remaining time until the requested relative error, as text."""
    if math.isinf(state.relative_error):
        return ""
    remaining = state.seconds * max((state.relative_error / error) ** 2 - 1, 0.0)
    return f"{remaining:.0f} s left, "


def _print(name: str, response: dict[str, Any]) -> None:
    """Print the frequency response at about a dozen frequencies, and its summary."""
    import numpy as np

    frequencies, amplitude = (
        response["modulation_frequency_hz"],
        response["relative_amplitude"],
    )
    errors = response.get("relative_amplitude_uncertainty")
    phase, phase_errors = response["phase_rad"], response.get("phase_uncertainty_rad")
    rows = []
    for k in range(0, len(frequencies), max(1, len(frequencies) // 12)):
        row = [f"{frequencies[k] / 1e6:.3g}", f"{amplitude[k]:.4f}"]
        degrees = f"{np.degrees(phase[k]):.2f}"
        if errors is not None and phase_errors is not None:
            row[-1] += f" +- {errors[k]:.4f}"
            degrees += f" +- {np.degrees(phase_errors[k]):.2f}"
        rows.append([*row, degrees])
    print_table(
        f"{name}: water signal, {response['model']} model",
        ["MHz", "relative amplitude", "phase [deg]"],
        rows,
    )
    still = f"{response['power_share_unmodulated']:.4g}"
    if "power_share_unmodulated_uncertainty" in response:
        still += f" +- {response['power_share_unmodulated_uncertainty']:.1g}"
    print(f"Received of the unmodulated light: {still}")
    if math.isnan(response["cut_off_hz"]):
        print("Cut-off at 1/sqrt 2: beyond these frequencies", end="")
    else:
        print(f"Cut-off at 1/sqrt 2: {response['cut_off_hz'] / 1e6:.2f}", end="")
        if "cut_off_uncertainty_hz" in response:
            print(f" +- {response['cut_off_uncertainty_hz'] / 1e6:.2f}", end="")
        print(" MHz", end="")
    fitted = response["fitted_cut_off_hz"]
    print("" if fitted is None else f"; free fit: {fitted / 1e6:.2f} MHz")
    if "histories" in response:
        print(
            f"{response['histories']:,} photons; orders of scattering 1, 2, 3, ...: "
            + ", ".join(
                f"{share:.2f}" for share in response["share_by_scattering_order"]
            )
        )
    if response.get("interrupted"):
        print("Interrupted before the error was reached.")
    if response.get("heavy_tailed"):
        print("Single photons outweigh the error stated: treat it as too small.")
