"""A scan of two frequencies and two channels."""

from __future__ import annotations

import pytest
from signal_chains import FREQUENCIES

from amulor.survey import Survey


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "instrument.modulation_frequencies": list(FREQUENCIES),
            "instrument.polarizations": ["VV", "VH"],
            "scan.columns": 6,
            "scan.rows": 4,
            "scan.order": "serpentine",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 5},
        }
    )
