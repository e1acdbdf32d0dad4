"""
Two visits to a site
====================

This example tests whether an amphora has moved or whether the difference is an error of
measurement. In the simulation, a sea bed with an amphora is scanned in two years, from
two positions each. Between the two visits the amphora is moved by 4 cm. The scans are
registered, merged and compared, with the uncertainty of each step.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path("../wreck").resolve()))

import make_site

from amulor.site import Site
from amulor.site.change.distances import change
from amulor.site.merging.cloud import merge
from amulor.site.registration.register import register, surfaces_of

# %%
# The example uses two scans of each visit in ``examples/wreck``, with coarse pixels.
make_site.STATIONS = {
    year: stations[:2] for year, stations in make_site.STATIONS.items()
}
make_site.MOVED = np.array([0.030, 0.026, 0.0])
site = Site.from_toml(make_site.make(Path(tempfile.mkdtemp()), rows=60))
surfaces, images = surfaces_of(site)
poses = register(site, surfaces=surfaces, images=images)
cloud = merge(site, poses, surfaces, images)
changed = change(site, poses, surfaces, cloud)
print(f"{int(changed.significant.sum())} points changed, of {changed.value.size}")

# %%
# Blue points are higher in the second year, and red points are lower. The amphora has
# left the red place and lies in the blue place. The upper panel shows the change, and
# the lower panel shows the change divided by its uncertainty. Rings mark significant
# changes. The limit of significance accounts for the number of points.
finite = np.isfinite(changed.value)
x, y = changed.position[finite, :2].T
value, stated = 1e3 * changed.value[finite], 1e3 * changed.uncertainty[finite]
figure, axes = plt.subplots(2, 1, figsize=(7, 7), layout="constrained")
for axis, shown, limit, title in (
    (axes[0], value, 12, "change [mm]"),
    (axes[1], value / stated, 6, "change over its uncertainty"),
):
    points = axis.scatter(x, y, c=shown, s=9, cmap="RdBu", vmin=-limit, vmax=limit)
    figure.colorbar(points, ax=axis, shrink=0.8)
    axis.set(title=title, xlabel="east [m]", ylabel="north [m]", aspect="equal")
far = changed.significant[finite]
axes[1].scatter(x[far], y[far], s=14, facecolors="none", edgecolors="k", linewidths=0.6)
plt.show()
