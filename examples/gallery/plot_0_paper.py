"""
Figures of the paper, redrawn
=============================

Where the water signal comes from, and the water as a low-pass: figures 1 and 3 of
Ricci et al. 2010 (:doi:`10.1155/2010/958360`), by the functions that redraw all of
them. The :doc:`whole study </gallery/ricci2010>` checks what the paper says of each.
"""

from io import BytesIO

import matplotlib.pyplot as plt

from amulor.studies.ricci2010 import reproduce
from amulor.view.report import png

# %%
# ``quick`` takes fewer points and photons. What is drawn as measured is synthetic: the
# data of the paper survive in its pictures only.
results = reproduce.run((1, 3), quick=True, depend=False)
for figure in results.figures:
    held = sum(check.passed for check in figure.checks)
    print(f"figure {figure.number}: {held} of {len(figure.checks)} statements hold")
    picture = plt.imread(BytesIO(png(figure.drawn)))
    height, width, _ = picture.shape
    plt.figure(figsize=(8, 8 * height / width)).add_axes((0, 0, 1, 1)).imshow(picture)
    plt.axis("off")
plt.show()
