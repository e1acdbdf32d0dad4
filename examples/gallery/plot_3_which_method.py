"""
Which method wins when
======================

No rejection method is best for all measurements. Four scenes of the benchmark show what
decides: the references, the modulation frequencies, and the surfaces. The command
``amulor benchmark`` computes this comparison for all scenes and methods.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from amulor import cube as cubes
from amulor.studies.benchmark import scenes, table

described = {scene.name: scene for scene in scenes.read()}


def errors(name, methods, *, rows=12, columns=20, shots=True):
    """Print and return the errors of some methods in a part of a scene."""
    scene = described[name]
    case = scene.case()
    part = (slice(12 - rows, 12), slice(columns))
    samples = case.samples.isel(row=part[0], column=part[1])
    if not shots:
        samples = cubes.without_groups(samples, "open_water")
    case = replace(
        case,
        samples=samples,
        surfaces=case.surfaces[:, *part],
        late=case.late[part],
        judged=case.judged[part],
    )
    found = {}
    for method in methods:
        row = table.row_of(scene, method, case)
        found[method] = row.error if row.compared else np.nan
        text = f"trusted {row.trusted:4.0%}"
        if row.trusted > 0:
            text += (
                f"   error {row.error:5.2f} mm   stated {row.stated:5.2f} mm"
                f"   inside 95 % interval {row.inside_95:4.0%}"
            )
        print(f"{method:24s} {text}")
    return found


# %%
# *One surface, four frequencies, open-water references.* Subtraction of the reference
# is enough. The second channel reduces the noise, and neighbors of a smooth surface
# reduce it more. The stated error stays that of single pixels.
methods = ["open-water", "combined", "smooth-surface", "polarization"]
plate = errors("coastal-plate", methods, rows=6)

# %%
# *Two surfaces in each beam, a sweep to 1 GHz.* Subtraction of the reference leaves the
# sum of two echoes, which it flags. A range profile separates them.
methods = ["open-water", "range-profile"]
two = errors("coastal-two-surfaces-sweep", methods, rows=3, columns=6)

# %%
# *An object in open water, no references.* The pixels around the object show the water.
# The depolarization ratios of the survey are a weaker statement.
methods = ["background", "polarization", "phasor-lines"]
around = errors("coastal-object", methods, shots=False)

# %%
# *Bright and dark spots, no references.* Neighbors of different reflectance show the
# water, by two channels or by one.
methods = ["polarization-difference", "phasor-lines", "background"]
spots = errors("harbour-texture-3-lengths", methods, shots=False)

# %%
# Without a bar, the method refuses the scene or trusts less than half of the pixels.
panels = {
    "one surface, shots": plate,
    "two surfaces, sweep": two,
    "object, no shots": around,
    "spots, no shots": spots,
}
figure, axes = plt.subplots(2, 2, figsize=(8, 4.2), layout="constrained")
for axis, (title, found) in zip(axes.flat, panels.items(), strict=True):
    axis.barh(np.arange(len(found)), list(found.values()))
    axis.set_yticks(np.arange(len(found)), list(found))
    axis.set(title=title, xlabel="error [mm]", ylim=(len(found) - 0.5, -0.5))
plt.show()
