"""`amulor backscatter`: the water signal against modulation frequency."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from amulor.cli._output import print_json, print_table


def backscatter(
    survey: Path,
    /,
    *,
    frequency: str = "0.5MHz:138MHz:200",
    model: Literal["diffusion", "small-angle"] = "diffusion",
    plot: Path | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compute the water signal against modulation frequency.

    Parameters
    ----------
    survey
        Survey file (TOML); its water and instrument count.
    frequency
        Modulation frequencies, "10MHz,39MHz" or first, last and number.
    model
        Small-angle diffusion, or small-angle with the whole phase function.
    plot
        Picture to draw (PNG or SVG).
    overwrite
        Replace a picture that is there.
    json
        Print the numbers for other programs.
    """
    import numpy as np

    from amulor import units
    from amulor.errors import SurveyError
    from amulor.optics import low_pass
    from amulor.simulation import backscatter as models
    from amulor.survey import Survey

    described = Survey.from_toml(survey)
    response_of = {
        "diffusion": models.diffusion_response,
        "small-angle": models.small_angle_response,
    }[model]
    try:
        frequencies = np.array(units.parse_frequencies(frequency))
        response = response_of(described, frequencies)
        still = float(abs(response_of(described, np.zeros(1))[0]))
        if still == 0:
            raise SurveyError(
                f"{survey}: the receiver gets no light from this water; check "
                "receiver position, axis and acceptance, and phase_function_at_180"
            )
        half_power = low_pass.cut_off(lambda f: response_of(described, f))
        fitted = low_pass.fit(frequencies, abs(response)) if len(response) > 2 else None
    except ValueError as error:
        raise SurveyError(f"{survey}: {error}") from None
    if plot is not None:
        from amulor.view import sweep

        sweep.write(
            plot,
            frequencies,
            {f"{model} model": response / still},
            cut_off=half_power,
            title=described.name,
            overwrite=overwrite,
        )
    found = {
        "model": model,
        "power_share_unmodulated": still,
        "cut_off_hz": half_power,
        "fitted_cut_off_hz": None if fitted is None else fitted.cut_off,
        "fitted_cut_off_uncertainty_hz": (
            None if fitted is None else fitted.cut_off_standard_error
        ),
        "modulation_frequency_hz": frequencies,
        "relative_amplitude": abs(response) / still,
        "phase_rad": np.angle(response),
    }
    if json:
        print_json(found)
        return
    rows = [
        [f"{f / 1e6:.3g}", f"{abs(r) / still:.4f}", f"{np.degrees(np.angle(r)):.2f}"]
        for f, r in list(zip(frequencies, response, strict=True))[
            :: max(1, len(frequencies) // 12)
        ]
    ]
    print_table(
        f"{described.name}: water signal, {model} model",
        ["MHz", "relative amplitude", "phase [deg]"],
        rows,
    )
    print(f"Received of the unmodulated light: {still:.4g}")
    print(f"Cut-off at 1/sqrt 2: {half_power / 1e6:.2f} MHz", end="")
    print("" if fitted is None else f"; free fit: {fitted.cut_off / 1e6:.2f} MHz")
