"""A scan as event-model documents, as bluesky and databroker use them."""

from __future__ import annotations

import datetime
import json
import uuid
from collections.abc import Iterator
from typing import Any

from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import QUANTITIES, Record
from amulor.acquisition.plan import DARK, OPEN_WATER, REFERENCE, SCAN, SHUTTER, Key

#: Streams, in the order of their descriptors.
_STREAMS = (DARK, SHUTTER, REFERENCE, OPEN_WATER, SCAN)
#: Name space of the identifiers of documents.
_SPACE = uuid.UUID("5f0c1f7e-6f0a-4f6f-9d0e-2f1c7a2d9b13")
_UNITS = {
    "frequency": "Hz",
    **{
        name: quantity.unit
        for name, quantity in QUANTITIES.items()
        if quantity.unit != "1"
    },
}


def documents(journal: Journal) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the documents of a scan: start, descriptors, events for samples, and stop.

    The time of an event is the start of its segment plus the time since then by the
    clock of the scan.
    """
    meta, parts = journal.meta(), journal.segments()
    start = str(uuid.uuid5(_SPACE, meta["survey_digest"] + parts[0]["started"]))
    began = {part["number"]: _moment(part["started"]) for part in parts}
    identities = json.loads(meta["identities"])
    yield (
        "start",
        {
            "uid": start,
            "time": began[parts[0]["number"]],
            "plan_name": "amulor_scan",
            "detectors": ["lock_in"],
            "motors": ["azimuth", "elevation"],
            "survey": meta["survey"],
            "identities": identities,
        },
    )
    counted: dict[str, int] = {}
    first: dict[int, float] = {}
    for kind in _STREAMS:
        for _, record in journal.samples(kind):
            if record.segment not in first or record.elapsed < first[record.segment]:
                first[record.segment] = record.elapsed
    latest = max(began.values())
    for kind in _STREAMS:
        descriptor = str(uuid.uuid5(uuid.UUID(start), kind))
        for number, (key, record) in enumerate(journal.samples(kind), start=1):
            moment = began[record.segment] + record.elapsed - first[record.segment]
            if number == 1:
                yield "descriptor", _descriptor(descriptor, start, kind, moment)
            data = data_of(key, record)
            latest = max(latest, moment)
            counted[kind] = number
            yield (
                "event",
                {
                    "uid": str(uuid.uuid5(uuid.UUID(descriptor), repr(tuple(key)))),
                    "descriptor": descriptor,
                    "seq_num": number,
                    "time": moment,
                    "data": data,
                    "timestamps": dict.fromkeys(data, moment),
                },
            )
    finished = parts[-1]["reason"] == "finished"
    yield (
        "stop",
        {
            "uid": str(uuid.uuid5(uuid.UUID(start), "stop")),
            "run_start": start,
            "time": latest,
            "exit_status": "success" if finished else "abort",
            "reason": str(parts[-1]["reason"] or "broken off without notice"),
            "num_events": counted,
        },
    )


def _descriptor(uid: str, start: str, kind: str, moment: float) -> dict[str, Any]:
    keys = data_keys()
    return {
        "uid": uid,
        "run_start": start,
        "name": kind,
        "time": moment,
        "data_keys": keys,
        "configuration": {},
        "hints": {},
        "object_keys": {"amulor": [*keys]},
    }


def data_keys() -> dict[str, dict[str, Any]]:
    """Return the event-model description of each quantity of a sample."""
    names = [*Key._fields[1:], *QUANTITIES]
    return {
        name: {
            "source": f"amulor:{name}",
            "dtype": "string" if name == "polarization" else "number",
            "shape": [],
            **({"units": _UNITS[name]} if name in _UNITS else {}),
        }
        for name in names
    }


def data_of(key: Key, record: Record) -> dict[str, Any]:
    """Return the quantities of a sample by name, without the kind of sample."""
    content = {**key._asdict(), **vars(record)}
    del content["kind"]
    return {
        name: float("nan") if value is None else value
        for name, value in content.items()
    }


def _moment(text: str) -> float:
    """Convert a time stamp of the journal to Unix time [s]."""
    return datetime.datetime.fromisoformat(text).timestamp()
