"""Recorded quantities: declared once, and read from journals that lack some of them."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.errors import InstrumentError

#: Adds a quantity to the table and to what the simulated laser measures, nothing else.
ADDED = """
import importlib.abc, importlib.util, json, sys
from pathlib import Path

NAME = "amulor.acquisition.journal.record"
LINES = '''
    water_temperature: Annotated[
        float | None,
        Quantity(text="temperature of the water", unit="degC", within=(-5, 60),
                 cube="water_temperature"),
    ] = None
'''


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path, target=None):
        if name == NAME:
            self.file = Path(path[0]) / "record.py"
            return importlib.util.spec_from_loader(name, self)

    def exec_module(self, module):
        before, after = self.file.read_text().split("\\n\\n_HINTS =")
        exec(before + LINES + "\\n_HINTS =" + after, module.__dict__)


sys.meta_path.insert(0, Changed())
from amulor import Survey, acquisition
from amulor.acquisition.journal.documents import documents
from amulor.acquisition.simulated.devices import SimulatedLaser
from amulor.simulation import scene_light

SimulatedLaser.readings = lambda self: {"water_temperature": 12.5}
survey = Survey.preset("amulor-2010").with_({
    "instrument.polarizations": ["VV"], "scan.columns": 3, "scan.rows": 2,
    "scan.open_water": None,
})
folder = Path(sys.argv[1])
acquisition.acquire(survey, folder, scene=scene_light)
with acquisition.Journal.read(folder) as journal:
    cube, damage = acquisition.build(journal), journal.damage()
    told = [*documents(journal)]
    records = [record for _, record in journal.samples("scan")]
(keys,) = [content["data_keys"] for name, content in told
           if name == "descriptor" and content["name"] == "scan"]
print(json.dumps({
    "records": [record.water_temperature for record in records],
    "damage": damage,
    "units": keys["water_temperature"]["units"],
    "events": [content["data"]["water_temperature"] for name, content in told
               if name == "event"],
    "cube": cube["user_water_temperature"].values.ravel().tolist(),
    "attributes": cube["user_water_temperature"].attrs,
}))
"""


def test_a_quantity_added_to_the_table_is_in_journal_documents_and_cube(
    folder,
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ADDED, str(folder)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for where in ("records", "events", "cube"):
        assert found[where]
        assert set(found[where]) == {12.5}
    assert found["damage"] == []
    assert found["units"] == "degC"
    assert found["attributes"] == {
        "long_name": "temperature of the water", "units": "degC",
    }  # fmt: skip
    # The column is checked and named in the file itself.
    connection = sqlite3.connect(folder / FILE_NAME)
    columns = {row[1]: row[2:4] for row in connection.execute(
        "PRAGMA table_info(samples)"
    )}  # fmt: skip
    assert columns["water_temperature"] == ("REAL", 0)
    connection.execute("UPDATE samples SET water_temperature = 1e9 WHERE number = 1")
    connection.commit()
    connection.close()
    # A program without the quantity reads the rest as it was, bit for bit.
    with Journal.read(folder) as journal:
        scan = [record for _, record in journal.samples(SCAN)]
        (line,) = journal.damage()
    assert scan
    assert "row 1: its checksum" in line


def test_a_journal_without_a_newer_quantity_is_read_and_resumed(
    small, folder, Stop
) -> None:
    acquisition.acquire(
        small, folder, scene=scene_light, control=Stop(30, go_on=False)
    )  # fmt: skip
    with Journal.read(folder) as journal:
        before = journal.newer(0)
    connection = sqlite3.connect(folder / FILE_NAME)
    connection.execute("ALTER TABLE samples DROP COLUMN laser_temperature")
    connection.commit()
    connection.close()
    content = (folder / FILE_NAME).read_bytes()
    with Journal.read(folder) as journal:
        assert journal.newer(0) == before
        assert journal.damage() == []
    assert (folder / FILE_NAME).read_bytes() == content
    outcome = acquisition.acquire(small, folder, scene=scene_light, resume=True)
    assert outcome.finished
    with Journal.read(folder) as journal:
        assert journal.newer(0)[: len(before)] == before
        assert journal.damage() == []


def test_where_mounts_and_target_stand_is_in_the_cube(small, folder, cube_of) -> None:
    acquisition.acquire(small, folder, scene=scene_light)
    with Journal.read(folder) as journal:
        out = {record.target for _, record in journal.samples("open_water")}
        within = {record.target for _, record in journal.samples(SCAN)}
    assert out == {0.2}
    assert within == {0.0}
    cube = cube_of(folder)
    assert (cube["user_target_position"] == 0).all()
    angles = cube["user_analyser_angle"].max(("modulation_frequency", "row", "column"))
    assert angles.values.tolist() == [0.0, pytest.approx(np.pi / 2)]
    assert cube["user_launch_angle"].attrs["units"] == "rad"


def test_a_mount_that_stands_elsewhere_ends_the_scan(
    small, folder, monkeypatch
) -> None:
    monkeypatch.setattr(
        "amulor.acquisition.simulated.devices.SimulatedMount.rotate",
        lambda self, angle, *, timeout: angle + 0.01,
    )
    with pytest.raises(InstrumentError, match=r"stands at .* degrees and was sent to"):
        acquisition.acquire(small, folder, scene=scene_light)
