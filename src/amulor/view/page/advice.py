"""What an operator should do about a scan, from a few numbers of how it goes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from amulor.view.page.drift import Drift

#: Water that changed by this part is worth a reference, if chance did not do it [1].
WORTH_A_REFERENCE = 0.02
#: Chance does it if more than this share of scans in steady water show as much [1].
CHANCE = 1e-3
#: Share of samples with a flag that is worth a word [1].
WORTH_A_WORD = 0.01
#: Without a sample for so many times as long as one takes, something may be wrong.
_PATIENCE = 20.0
_SHORTEST = 15.0


@dataclass(frozen=True, kw_only=True)
class Going:
    """How a scan goes."""

    running: bool
    """Whether a part of it has begun and not ended."""
    done: int
    """Samples in the journal [1]."""
    scanned: int
    """Those of them that are of the scan itself [1]."""
    open_water: int
    """Those that are of open water [1]."""
    dark: int
    """Those without light [1]."""
    flagged: dict[str, int] = field(default_factory=dict)
    """How many samples carry each flag [1]."""
    rate: float = math.nan
    """Samples a second [1/s]."""
    silent: float = 0.0
    """Time since the last sample [s]."""
    drift: Drift = field(default_factory=Drift)
    """Of the open water."""
    total: int = 0
    """Samples that a finished scan has [1]."""
    resume: str | None = None
    """Command that goes on with a scan to which no program writes."""
    reason: str = ""
    """How its last part ended."""


_FLAGS = {
    "overload": "overload the lock-in or the detector: less power, or a larger scale",
    "off position": "stand off the commanded direction: check the scanner",
    "off frequency": "are detected at another frequency than commanded",
    "no light": "are without light: check laser and shutter",
    "repeated": "lost the reference and were taken again: check its cable",
}


def advice(going: Going) -> list[str]:
    """Return what is worth doing, the most important first.

    Parameters
    ----------
    going : Going
        How the scan goes.

    Returns
    -------
    list of str
        One sentence each; empty if all is well.
    """
    said = []
    if going.resume is not None:
        said.append(
            f"stopped ({going.reason}) at {going.done:,} of {going.total:,} samples; "
            f"resume with: {going.resume}"
        )
    patience = _SHORTEST
    if going.rate > 0:
        patience = max(_SHORTEST, _PATIENCE / going.rate)
    if going.running and going.silent > patience:
        said.append(
            f"no sample for {going.silent:.0f} s: see whether the instrument still runs"
        )
    for change, words in (
        (going.drift.total, "open water drifted"),
        (going.drift.newest, "the newest shots of open water jumped"),
    ):
        if abs(change.size) >= WORTH_A_REFERENCE and change.chance < CHANCE:
            said.append(
                f"{words} {change.size * 100:+.1f} % (± {change.error * 100:.2g} %): "
                "take a reference"
            )
            break
    for name, words in _FLAGS.items():
        share = going.flagged.get(name, 0) / max(going.done, 1)
        if share >= WORTH_A_WORD:
            said.append(f"{share:.0%} of the samples {words}")
    if going.scanned and not going.open_water:
        said.append("no open-water shots so far: the water cannot be taken out yet")
    if going.scanned and not going.dark:
        said.append("no dark readings: offsets of the instrument stay in the samples")
    return said
