"""Write rov.csv: five lines of a vehicle, with a late message and a gap."""

from pathlib import Path

import numpy as np

time = np.arange(0, 120, 0.2)
line, share = np.floor(time / 24), time % 24 / 24
along = np.minimum(share / 0.8, 1.0) * 4
turning = np.maximum(share - 0.8, 0.0) / 0.2
goes_east = line % 2 == 0
columns = {
    "t": time,
    "E": np.where(goes_east, along, 4 - along) + 0.02 * np.sin(0.7 * time),
    "N": 0.5 * (line + turning) + 0.02 * np.cos(0.5 * time),
    "depth": 8 + 0.05 * np.sin(0.3 * time),
    "hdg": np.where(goes_east, 90 + 180 * turning, 270 - 180 * turning),
    "pitch": 1.5 * np.sin(0.9 * time),
    "roll": 2 * np.cos(0.8 * time),
}
rows = [
    ",".join(
        f"{value:.{2 if name == 't' else 4}f}"
        for name, value in zip(columns, row, strict=True)
    )
    for row in zip(*columns.values(), strict=True)
]
del rows[299:329]
rows[39], rows[40] = rows[40], rows[39]
Path(__file__).with_name("rov.csv").write_text(
    "\n".join([",".join(columns), *rows]) + "\n"
)
