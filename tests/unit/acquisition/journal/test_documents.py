"""A scan as documents that other programs read: each sample once, in their schema."""

from __future__ import annotations

import math

import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition.journal.documents import documents
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings


@pytest.fixture
def scan(small, folder, Stop):
    """Return the journal of a scan that was broken off once."""
    settings = Settings.model_validate({"procedure": {"dark_readings": 2}})
    for resume, control in ((False, Stop(30, go_on=False)), (True, None)):
        acquisition.acquire(
            small, folder, settings=settings, scene=scene_light, resume=resume,
            control=control,
        )  # fmt: skip
    with Journal.read(folder) as journal:
        yield journal


def test_each_sample_is_one_event(scan) -> None:
    found = [*documents(scan)]
    names = [name for name, _ in found]
    assert names[0] == "start"
    assert names[-1] == "stop"
    assert names.count("descriptor") == 3
    assert names.count("event") == scan.count()
    streams = {d["uid"]: d["name"] for name, d in found if name == "descriptor"}
    events = [document for name, document in found if name == "event"]
    for kind in ("dark", "open_water", "scan"):
        own = [event for event in events if streams[event["descriptor"]] == kind]
        assert [event["seq_num"] for event in own] == [*range(1, len(own) + 1)]
        for event, (key, record) in zip(own, scan.samples(kind), strict=True):
            assert event["data"]["in_phase"] == record.in_phase
            assert event["data"]["polarization"] == key.polarization
            assert event["data"]["target"] == record.target or math.isnan(
                event["data"]["target"]
            )
            assert event["timestamps"].keys() == event["data"].keys()
    stop = found[-1][1]
    assert stop["exit_status"] == "success"
    assert sum(stop["num_events"].values()) == scan.count()
    assert len({event["uid"] for event in events}) == len(events)
    # The same scan is the same run, whoever asks.
    assert [d["uid"] for _, d in documents(scan)] == [d["uid"] for _, d in found]
    # Time goes on, also over the break.
    times = sorted(event["time"] for event in events)
    assert found[0][1]["time"] == pytest.approx(times[0], abs=1e-3)
    assert plan.SCAN in stop["num_events"]


def test_the_documents_are_those_of_the_event_model(scan) -> None:
    model = pytest.importorskip("event_model", reason="pip install --group clients")
    checked = 0
    for name, document in documents(scan):
        validator = model.schema_validators[model.DocumentNames[name]]
        validator.validate(document)
        checked += 1
    assert checked == scan.count() + 5


def test_a_callback_of_others_takes_them(scan) -> None:
    model = pytest.importorskip("event_model", reason="pip install --group clients")

    class Counting(model.SingleRunDocumentRouter):
        events = 0

        def event(self, doc: dict) -> dict:
            self.events += 1
            assert self.get_stream_name(doc) in ("dark", "open_water", "scan")
            return doc

    router = Counting()
    for name, document in documents(scan):
        router(name, document)
    assert router.events == scan.count()
