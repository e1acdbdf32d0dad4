"""Water that several tests of the photon transport share."""

from __future__ import annotations

import pytest

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import Medium


@pytest.fixture(scope="session")
def peaked_water():
    """Attenuation 1 1/m, albedo 0.8, Henyey-Greenstein g = 0.95, without bounds."""
    return Medium.homogeneous(
        absorption=0.2,
        scattering=0.8,
        phase_function=henyey_greenstein_function(asymmetry=0.95),
        group_index=1.33,
    )
