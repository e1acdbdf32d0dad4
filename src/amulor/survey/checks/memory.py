"""How large a scan may be where all of it is in memory at once."""

from __future__ import annotations

from amulor.errors import SurveyError
from amulor.survey.survey import Survey

__all__ = ["BY_ROWS", "MOST_SAMPLES", "refuse_scans_beyond_memory", "samples_of"]

#: Samples of one cube: 6 GB at the widest step of processing.
MOST_SAMPLES = 10_000_000
#: Samples above which commands work by rows without being asked, as on files.
BY_ROWS = 2**21


def samples_of(survey: Survey) -> int:
    """Return how many samples a scan has [1].

    Parameters
    ----------
    survey : Survey
        Its scan, frequencies and analysers count.

    Returns
    -------
    int
        Pixels times frequencies times analysers.
    """
    instrument = survey.instrument
    channels = len(instrument.modulation_frequencies) * len(instrument.polarizations)
    return survey.scan.rows * survey.scan.columns * channels


def refuse_scans_beyond_memory(survey: Survey) -> None:
    """Refuse a scan that is too large for what needs all of it at once.

    Parameters
    ----------
    survey : Survey
        Its scan counts.

    Raises
    ------
    SurveyError
        If it has more than `MOST_SAMPLES` samples.
    """
    samples = samples_of(survey)
    if samples > MOST_SAMPLES:
        scan = survey.scan
        raise SurveyError(
            f"the scan has {samples:.3g} samples ({scan.columns} x {scan.rows} pixels, "
            f"{samples // (scan.columns * scan.rows)} samples each), at most "
            f"{MOST_SAMPLES:.0e} fit into memory here (600 bytes each); `amulor "
            "simulate` works by rows; elsewhere split it into several surveys"
        )
