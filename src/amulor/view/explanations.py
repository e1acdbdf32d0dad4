"""What flags and warnings mean: what is compared, how often by chance, what to do."""

from __future__ import annotations

import difflib
import inspect
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from amulor.cube import DOUBTFUL, ERROR_UNKNOWN, UNUSABLE, QualityFlag
from amulor.cube.schema import TERMS
from amulor.errors import FormatError

Kind = Literal["pixel flag", "sample flag", "warning", "error term"]


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """What a flag, a warning or a term of the error budget means."""

    name: str
    """As files, pages and messages name it, in capitals with underscores."""
    kind: Kind
    """Where it is met."""
    meaning: str
    """What it says."""
    compared: str
    """What is compared with what, and the limit."""
    chance: str
    """How often chance alone does it, where that is known."""
    consequence: str
    """What becomes of the range, or of the sample."""
    remedy: str
    """What to do."""


def explanations() -> dict[str, Explanation]:
    """Return all explanations by their names, pixel flags first."""
    all_of_them = [*_pixel_flags(), *_sample_flags(), *_warnings(), *_terms()]
    return {one.name: one for one in all_of_them}


def find(words: str) -> list[Explanation]:
    """Return the explanations that a name or a message asks for, the best first."""
    known = explanations()
    plain = re.sub(r"[^a-z]+", "_", words.lower()).strip("_")
    if plain.upper() in known:
        return [known[plain.upper()]]
    # Messages first: they name other things on their way.
    found = [known[name] for name, said in _SAID.items() if re.search(said, plain)]
    if not found:
        padded = f"_{plain}_"
        found = [one for name, one in known.items() if f"_{name.lower()}_" in padded]
    if not found:
        close = difflib.get_close_matches(plain, [name.lower() for name in known], 1)
        found = [known[name.upper()] for name in close]
    if not found:
        raise FormatError(
            f"nothing is known of {words[:60]!r}; there are {', '.join(known)}"
        )
    return found


#: Parts of messages and the name of what they say, letters and underscores only.
_SAID = {
    "SCAN_STOPPED": r"resume_with",
    "OPEN_WATER_DRIFTED": r"open_water_drifted|take_a_reference",
    "NO_SAMPLE": r"no_sample_for|instrument_still_runs",
    "NO_OPEN_WATER_SHOTS": r"no_open_water_shots",
    "NO_DARK_READINGS": r"no_dark_readings|offsets_of_the_instrument",
    "UNCERTAINTY_UNKNOWN": r"nobody_knows|uncertainty_unknown|not_in_the_uncertainty",
    "MISSING": r"not_measured",
    "SATURATED": r"detector_overloaded|saturat",
    "NO_TARGET": r"stand_out_of_the_water",
    "AMBIGUOUS": r"distance_not_settled",
    "WATER_RESIDUAL": r"water_left_in_moves",
    "NO_OPEN_WATER": r"water_not_removed|water_signal_not_taken_out",
    "MIXED": r"meets_two_surfaces",
    "OUTLIER": r"disagrees_with_the_rest",
    "RELATIVE": r"off_by_whole_intervals",
}


def _pixel_flags() -> list[Explanation]:
    from amulor.imaging import edges, outliers
    from amulor.optics import ambiguity
    from amulor.rejection import quality
    from amulor.rejection.joint import cube as joint

    seen = quality.DETECTION_THRESHOLD
    mixed = default_of(edges.flag_mixed, "significance")
    alone = default_of(outliers.flag_outliers, "significance")
    words = {
        QualityFlag.MISSING: (
            "The pixel was not measured.",
            "In phase or quadrature is no number at one modulation frequency at "
            "least, or "
            "the pixel was left out on request (--good-only, --largest-uncertainty).",
            "",
            "Let the scan go on (amulor acquire --resume), or scan the place once "
            "more.",
        ),
        QualityFlag.SATURATED: (
            "The detector or the lock-in left its linear range.",
            "The instrument reported an overload while the sample was taken and no "
            "larger scale was left; in a simulation the light was beyond the largest "
            "signal of the detector.",
            "",
            "Less power or gain, or a larger scale of the lock-in, then take the "
            "samples "
            "again (amulor acquire --resume --retake-flagged).",
        ),
        QualityFlag.NO_TARGET: (
            "The signal does not stand out of its uncertainty and of the water left in "
            "it: there is no echo that could be told from none.",
            "Hypothesis: the target signal is zero. It is kept unless the signal "
            "stands "
            f"{seen:g} standard errors off zero (both parts together, their covariance "
            "as metric; water that may be left counts as an error) and its phase is "
            f"known to {quality.LARGEST_PHASE_ERROR:g} rad.",
            f"Noise alone passes for a target in {_share(math.exp(-(seen**2) / 2))} "
            "samples.",
            "Longer dwell, more power, a nearer target, or a channel and a frequency "
            "with less water in them (amulor reject --method combined).",
        ),
        QualityFlag.AMBIGUOUS: (
            "The distance is not settled among the intervals after which the phases "
            "repeat, or the frequencies contradict each other.",
            "Hypothesis: one path explains the phases of all frequencies. Another "
            f"interval that fits worse by less than {ambiguity.MARGIN:g} in "
            "chi-square "
            "leaves the choice open; of the joint estimation, one with a probability "
            f"above {joint.WRONG:g}.",
            "Phases that agree contradict each other by chance in "
            f"{_share(ambiguity.DISAGREEMENT)} pixels.",
            "State the nearest and farthest possible range (--nearest, --farthest), "
            "add a "
            "low modulation frequency, or dwell longer. Where two surfaces meet, "
            "several "
            "frequencies show this flag instead of MIXED.",
        ),
        QualityFlag.WATER_RESIDUAL: (
            "Water signal that is left in moves the range by more than its "
            "uncertainty, "
            "or the samples contradict the model of the water.",
            "Hypothesis: what is left of the water turns the phase by no more than its "
            "standard uncertainty. Of the joint estimation: that the model explains "
            "the "
            "samples of the pixel.",
            "A right model is contradicted by chance in "
            f"{_share(joint.DISAGREEMENT)} pixels.",
            "Take open-water shots nearer in time and direction, or let amulor reject "
            "--method auto choose another method. The stated uncertainty does not "
            "hold "
            "here; slant_range_bias says how far the range may be off.",
        ),
        QualityFlag.NO_OPEN_WATER: (
            "The water signal was not removed. Its share in the range is not known: "
            "expect centimetres, mostly too short.",
            "There are no open-water shots, or the water was left in on request. The "
            "flag "
            "is of the whole scan.",
            "",
            "Record open water ([scan.open_water] in the survey), or use a method that "
            "needs none: amulor reject --method joint with two or more frequencies.",
        ),
        QualityFlag.MIXED: (
            "The beam meets two surfaces at once: the range lies between them, where "
            "nothing is.",
            "Hypothesis: the pixel belongs to one of the surfaces beside it. It is "
            f"rejected where the pixel lies between them and {mixed:g} standard errors "
            "clear of both; noise alone counts, since what neighbours share cancels.",
            f"Noise puts a pixel so far off one surface in {_share(_tail(mixed))} "
            "cases; off two of them at once it is rarer.",
            "Leave these pixels out (amulor export --without-mixed; drawings and "
            "meshes "
            "do). A narrower beam or a finer grid makes fewer of them.",
        ),
        QualityFlag.OUTLIER: (
            "A sample disagrees with the rest of its pixel, or a pixel stands off all "
            "its "
            "neighbours: a particle in the beam, a spike in the electronics.",
            "Hypothesis: the pixel goes on from its neighbours in one direction at "
            f"least. Rejected where it stands off by {alone:g} standard errors in all "
            f"four, and by {outliers._ROUGHER:g} times the roughness around it; by "
            f"less, down to {outliers.LEAST:g}, where more pixels do than chance "
            "makes. Of "
            "several frequencies: that all phases belong to one path.",
            f"Noise does so in at most {_share(_tail(alone))} pixels, and in "
            f"{outliers._BY_CHANCE:.0%} of those that are flagged for being many.",
            "Leave it out, or scan the place again. Many outliers at once speak of "
            "particles or of an instrument that is not calm.",
        ),
        QualityFlag.RELATIVE: (
            "The range may be off by whole intervals after which the phases repeat.",
            "Nothing says which repetition is right: the targets of the survey do not "
            "lie "
            "within one interval, and no limits were stated. The flag is of the whole "
            "scan, whose shape is right.",
            "",
            "State the nearest and farthest possible range (amulor image --nearest "
            "--farthest).",
        ),
    }
    return [
        Explanation(
            name=str(flag.name),
            kind="pixel flag",
            meaning=meaning,
            compared=compared,
            chance=chance,
            consequence=_consequence(flag),
            remedy=remedy,
        )
        for flag, (meaning, compared, chance, remedy) in words.items()
    ]


def _consequence(flag: QualityFlag) -> str:
    if flag & UNUSABLE:
        return "The pixel has no range."
    if flag & ERROR_UNKNOWN:
        return (
            "All pixels keep their ranges, whose error is not known: no uncertainty is "
            "stated anywhere, and they count as doubtful."
        )
    if flag & DOUBTFUL:
        return "The pixel keeps its range, which is doubtful by itself."
    raise AssertionError(flag)


def _sample_flags() -> list[Explanation]:
    from amulor.acquisition.sampler import SPOILED, SampleFlag

    words = {
        SampleFlag.OVERLOAD: (
            "The lock-in or the detector overloaded, and no more room could be made.",
            "What the instrument reports of itself while it integrates.",
            "Less power or gain, or a larger scale.",
        ),
        SampleFlag.REPEATED: (
            "The lock-in lost its reference, and the sample was taken again.",
            "What the instrument reports of itself.",
            "None for a few samples; of many, check the cable of the reference.",
        ),
        SampleFlag.RESCALED: (
            "The lock-in was given a larger scale, and the sample was taken again.",
            "An overload with a larger scale left.",
            "None; a scale that fits from the start saves time.",
        ),
        SampleFlag.OFF_POSITION: (
            "The beam came to stand off the commanded direction.",
            "The read-back angle against the tolerance of the devices file.",
            "Check the scanner, its load and its tolerance.",
        ),
        SampleFlag.OFF_FREQUENCY: (
            "The lock-in detects at another frequency than the commanded one.",
            "The read-back frequency against the commanded one.",
            "Check the reference and the oscillator.",
        ),
        SampleFlag.NO_LIGHT: (
            "The laser was to be on, and the detector saw no more than in the dark.",
            "Its mean output against that of the dark readings.",
            "Check laser, interlock, shutter and what stands in the beam.",
        ),
        SampleFlag.UNSETTLED: (
            "The output of the lock-in still changed when it was read.",
            "Readings a time constant apart against their noise, for as long as the "
            "procedure waits at most.",
            "Allow a longer wait, or see what moves: scanner, water, target.",
        ),
    }
    return [
        Explanation(
            name=str(flag.name),
            kind="sample flag",
            meaning=meaning,
            compared=compared,
            chance="",
            consequence=(
                "The sample is spoiled, and taken again by amulor acquire --resume "
                "--retake-flagged."
                if flag & SPOILED
                else "The sample counts."
            ),
            remedy=remedy,
        )
        for flag, (meaning, compared, remedy) in words.items()
    ]


def _warnings() -> list[Explanation]:
    from amulor.view.page import progress

    worth = progress.WORTH_A_REFERENCE
    words = {
        "OPEN_WATER_DRIFTED": (
            "The water signal changed since the first shots of the scan.",
            "Hypothesis: the water is what it was. Said where a straight line through "
            "all rounds of shots, or the newest round against the mean of all before, "
            f"changes by {worth:.0%} or more and chance does not explain it.",
            f"Noise alone does it in {_share(progress.CHANCE)} scans at most, however "
            "many rounds of shots they have.",
            "Ranges between the shots are interpolated; their uncertainty grows.",
            "Take a reference now, and look for what changes: sediment, lamp, laser.",
        ),
        "SCAN_STOPPED": (
            "The scan is not complete, and no program writes to its journal.",
            "Lock of the folder, which a program has as long as it runs.",
            "",
            "None on what is there: samples that were acknowledged are on the disk.",
            "See why it ended, then go on with the command in the message.",
        ),
        "NO_SAMPLE": (
            "No sample has come for longer than the rate of the scan lets expect.",
            "Time since the last sample against the time that several usually take.",
            "",
            "None on what is there: samples that were acknowledged are on the disk.",
            "See whether the instrument still runs; amulor acquire --resume goes on.",
        ),
        "NO_OPEN_WATER_SHOTS": (
            "The scan has met the target, and has seen no open water so far.",
            "Kinds of the samples in the journal.",
            "",
            "The picture still holds the water.",
            "Wait for the shots of the plan, or plan some ([scan.open_water]).",
        ),
        "NO_DARK_READINGS": (
            "The scan has no readings without light.",
            "Kinds of the samples in the journal.",
            "",
            "Offsets of the instrument stay in the samples.",
            "Set dark_readings in [procedure] of the devices file.",
        ),
        "UNCERTAINTY_UNKNOWN": (
            "Terms of the error budget that nobody stated are not in the uncertainty.",
            "Which of delay, group_index and geometry the survey gives an error for.",
            "",
            "Lengths between points of one scan lose the delay; ranges do not.",
            "Calibrate (amulor devices calibrate), or state them ([calibration]).",
        ),
    }
    return [
        Explanation(
            name=name, kind="warning", meaning=meaning, compared=compared,
            chance=chance, consequence=consequence, remedy=remedy,
        )
        for name, (meaning, compared, chance, consequence, remedy) in words.items()
    ]  # fmt: skip


def _terms() -> list[Explanation]:
    types = {
        "A": "Type A: found from repeated measurements.",
        "B": "Type B: stated, or worked out from what is stated.",
        "A, B": "Type A and B: from repeated measurements and from what is stated.",
    }
    return [
        Explanation(
            name=f"TERM_{name.upper()}",
            kind="error term",
            meaning=f"{term.meaning[0].upper()}{term.meaning[1:]}.",
            compared=types[term.kind],
            chance="",
            consequence="A part of the standard uncertainty of the range.",
            remedy="amulor info FILE and amulor report say how large it is.",
        )
        for name, term in TERMS.items()
    ]


def lines_of(one: Explanation) -> list[str]:
    """Return an explanation as lines of text."""
    parts: Iterable[tuple[str, str]] = (
        ("means", one.meaning),
        ("compared", one.compared),
        ("by chance", one.chance),
        ("so", one.consequence),
        ("what to do", one.remedy),
    )
    return [f"{label:>10}: {text}" for label, text in parts if text]


def hint(names: Iterable[str]) -> str:
    """Return how to ask for the meaning of flags, for a message."""
    first = next(iter(names), "")
    name = first.upper().replace(" ", "_")
    return f"amulor explain {name}" if name else ""


def default_of(function: object, name: str) -> float:
    """Return the default of an argument, which is a limit."""
    value = inspect.signature(function).parameters[name].default  # type: ignore[arg-type]
    return float(value)


def _tail(sigma: float) -> float:
    """Return how often a normal error is larger than so many standard deviations."""
    return 0.5 * math.erfc(sigma / math.sqrt(2))


def _share(share: float) -> str:
    """Return a small share in words that go before what it is a share of."""
    if share >= 1e-3:
        return f"{share * 100:.2g} % of the"
    return f"1 of {float(f'{1 / share:.2g}'):,.0f}"
