"""Large stated range errors, for which derivatives at the measured ranges fail."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_sites import one_visit
from numpy.testing import assert_allclose
from scipy.stats import chi2

from amulor.site.registration.register import register, surface_of
from amulor.site.registration.surface import range_correction, with_correction

#: Standard deviation of the delay of each instrument, and the delays of two [m].
DELAY, DELAYS = 0.05, {"a2": 0.08, "a3": -0.06}


def test_a_corrected_surface_is_that_of_ranges_without_the_error() -> None:
    drawn = one_visit("amphorae", 1, rows=36)
    (scan, *_) = drawn.site.scan
    image = drawn.images[scan.name]
    other = image.copy(deep=True)
    other["slant_range"] += 0.04
    plain, late = (surface_of(drawn.site, scan, one) for one in (image, other))
    # The delay is one standard deviation of 1 mm times 40.
    (key,) = (key for key in late.shared.keys if key.startswith("delay"))
    found = with_correction(late, range_correction(late, {key: 40.0}))
    for name in ("distance", "patch", "apart"):
        assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-9)
    at = plain.smooth & found.smooth
    assert at.sum() > 200
    assert_allclose(found.normal[at], plain.normal[at], atol=1e-9)
    assert_allclose(found.spacing, plain.spacing, rtol=0.02)


@pytest.mark.slow
def test_stated_delays_of_several_centimeters_are_no_contradiction() -> None:
    # With derivatives at the measured ranges, a test of the angle of incidence fails.
    spoiled = {name: (lambda d, size=size: d + size) for name, size in DELAYS.items()}
    drawn = one_visit(
        "amphorae", 1, rows=48, position=0.02, angle=0.01, spoiled=spoiled
    )
    for image in drawn.images.values():
        for part in ("uncertainty_delay", "uncertainty", "common_uncertainty"):
            value = image[f"slant_range_{part}"]
            value.values = np.hypot(value.values, DELAY)
    scans = tuple(
        scan.model_copy(update={"instrument": scan.name}) for scan in drawn.site.scan
    )
    site = drawn.site.model_copy(update={"scan": scans})
    surfaces = {s.name: surface_of(site, s, drawn.images[s.name]) for s in scans}
    found = register(site, surfaces=surfaces, images=drawn.images)
    assert found.settled
    assert found.contradictions == ()
    for name in ("a2", "a3", "a4"):
        off = found.poses[name].position - drawn.stations[name].place
        spread = found.covariance_of(f"pose {name}")[:3, :3]
        assert off @ np.linalg.solve(spread, off) < chi2.isf(1e-3, 3)
        estimate = DELAY * found.errors[f"delay: {name}, one"]
        assert estimate == pytest.approx(DELAYS.get(name, 0.0), abs=0.02)
