"""Tells light from darkness by the mean output of the detector."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Sequence

#: Newest dark readings that are kept for each polarization: the room changes.
_KEPT = 100
#: How far above the dark level light must be, in standard errors [1].
_SIGNIFICANT = 5.0


class DarkLevel:
    """The mean output without light, by polarization, from dark readings of this run.

    What leaks in from the room passes the analyser, so each polarization has a level of
    its own. Of one that was not measured nothing is said.
    """

    def __init__(self) -> None:
        self._readings: dict[str, deque[float]] = {}

    def add(self, polarization: str, means: Sequence[float]) -> None:
        """Take note of dark readings.

        Parameters
        ----------
        polarization : str
            Launched and analysed state, or "none".
        means : sequence of float
            Mean output of each reading [V].
        """
        kept = self._readings.setdefault(polarization, deque(maxlen=_KEPT))
        kept.extend(means)

    def is_dark(self, polarization: str, means: Sequence[float]) -> bool:
        r"""Return whether readings with the laser on show no light.

        Parameters
        ----------
        polarization : str
            Launched and analysed state, or "none".
        means : sequence of float
            Mean output of each reading [V].

        Returns
        -------
        bool
            True if their mean is not above the dark level d by more than five standard
            errors; False if there is no reading, or no dark level.

        Notes
        -----
        With the standard deviation :math:`s` of one dark reading, n readings and m dark
        ones, dark is a mean of at most :math:`d + 5 s \sqrt{1 / n + 1 / m}`.
        """
        dark = self._readings.get(polarization)
        if not dark or len(means) == 0:
            return False
        spread = statistics.stdev(dark) if len(dark) > 1 else 0.0
        error = spread * math.sqrt(1 / len(means) + 1 / len(dark))
        limit = statistics.fmean(dark) + _SIGNIFICANT * error
        return statistics.fmean(means) <= limit
