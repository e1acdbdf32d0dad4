"""Batches of photons as files: the same bytes on a cluster, kept if they are whole."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from distributed import Client, LocalCluster

from amulor.cli import main
from amulor.errors import FormatError, MissingExtraError
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.scale import parts, tasks
from amulor.scale.batches import spread_batches
from amulor.transport import DiscReceiver, Medium, Source, Tally, simulate
from amulor.transport.monte_carlo import Spread

SIZE = {"threads_per_worker": 1, "dashboard_address": None}


def followed(spread: Spread | None, *, histories: int = 2_560, seed: int = 1) -> Tally:
    water = Medium.homogeneous(
        absorption=0.2,
        scattering=0.8,
        phase_function=henyey_greenstein_function(asymmetry=0.95),
        group_index=1.33,
    )
    disc = DiscReceiver(radius=0.05, acceptance_angle=0.035, position=(0.07, 0, 0))
    return simulate(
        water,
        Source(),
        disc,
        [0.0, 50e6],
        histories=histories,
        seed=seed,
        relative_error=0.5,
        spread=spread,
    )


def bytes_of(tally: Tally) -> tuple[object, ...]:
    """Return all numbers of a run but the time that it took."""
    return (
        tally.batches.tobytes(),
        tally.histories_of.tobytes(),
        None if tally.contributions is None else tally.contributions.tobytes(),
        tally.next_batch,
    )


def files_of(folder: Path) -> dict[str, str]:
    """Return the digests of all batches of a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.npz"))
    }


def test_any_number_of_workers_gives_the_bytes_of_none(tmp_path: Path) -> None:
    here = bytes_of(followed(None))
    files = []
    for count in (1, 2):
        with (
            LocalCluster(n_workers=count, processes=False, **SIZE) as cluster,
            spread_batches(
                tmp_path / str(count), scheduler=cluster.scheduler_address
            ) as spread,
        ):
            assert bytes_of(followed(spread)) == here
        files.append(files_of(tmp_path / str(count)))
    # As many more as were at work when the error was reached may be there.
    shared = files[0].keys() & files[1].keys()
    assert len(shared) >= 16
    assert [name for name in shared if files[0][name] != files[1][name]] == []


def test_what_is_whole_is_kept_and_the_rest_made(tmp_path: Path) -> None:
    with (
        LocalCluster(n_workers=1, processes=False, **SIZE) as cluster,
        spread_batches(tmp_path, scheduler=cluster.scheduler_address) as spread,
    ):
        first = followed(spread, histories=64)
        paths = sorted(tmp_path.rglob("*.npz"))
        assert len(paths) == 8
        before = {path: path.stat().st_mtime_ns for path in paths}
        content = paths[3].read_bytes()
        damaged = bytearray(content)
        damaged[len(damaged) // 2] ^= 1
        paths[3].write_bytes(damaged)
        paths[5].unlink()
        unfinished = paths[5].with_name(".amulor-unfinished")
        unfinished.touch()
        again = followed(spread, histories=64)
        after = {path: path.stat().st_mtime_ns for path in paths}
        assert bytes_of(again) == bytes_of(first)
        assert paths[3].read_bytes() == content
        made = [k for k, path in enumerate(paths) if after[path] != before[path]]
        assert made == [3, 5]
        assert not unfinished.exists()
        # Batches of other random numbers are others.
        other = followed(spread, histories=64, seed=2)
        assert bytes_of(other) == bytes_of(followed(None, histories=64, seed=2))
        assert bytes_of(other) != bytes_of(first)


@pytest.mark.study
def test_a_killed_worker_changes_nothing(tmp_path: Path) -> None:
    with LocalCluster(n_workers=2, processes=True, **SIZE) as cluster:
        killed: list[int] = []

        def kill() -> None:
            with Client(cluster.scheduler_address) as client:
                pids = client.run(os.getpid)
                while not list(tmp_path.rglob("*.npz")):
                    time.sleep(0.005)
                killed.append(next(iter(pids.values())))
                os.kill(killed[0], signal.SIGKILL)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        with spread_batches(tmp_path, scheduler=cluster.scheduler_address) as spread:
            found = followed(spread, histories=256_000)
        killer.join(10)
        assert killed
    assert bytes_of(found) == bytes_of(followed(None, histories=256_000))


def test_a_worker_without_the_disk_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from amulor.scale import tasks as pieces

    monkeypatch.setattr(pieces, "_do", lambda *words: None)
    with (
        LocalCluster(n_workers=1, processes=False, **SIZE) as cluster,
        spread_batches(tmp_path, scheduler=cluster.scheduler_address) as spread,
        pytest.raises(FormatError, match="workers need the disk"),
    ):
        followed(spread)


def test_without_dask_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    folder = tmp_path / "batches"
    with (
        pytest.raises(MissingExtraError, match=r"amulor\[scale\]"),
        spread_batches(folder, scheduler="local"),
    ):
        pass
    assert not folder.exists()


@pytest.mark.slow
def test_nobody_at_the_address_is_told_within_seconds(tmp_path: Path) -> None:
    start = time.monotonic()
    with (
        pytest.raises(FormatError, match="no dask scheduler answers"),
        spread_batches(tmp_path, scheduler="tcp://127.0.0.1:9"),
    ):
        pass
    assert time.monotonic() - start < 15


@pytest.mark.slow
def test_the_command_prints_the_same_with_a_cluster(
    plate_text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = tmp_path / "tank.toml"
    survey.write_text(plate_text)
    words = ["backscatter", str(survey), "--model", "photons", "--error", "1000%"]
    words += ["--frequency", "10MHz", "--json"]
    assert main(words) == 0
    here = json.loads(capsys.readouterr().out)
    with LocalCluster(n_workers=2, processes=False, **SIZE) as cluster:
        address = cluster.scheduler_address
        batches = tmp_path / "batches"
        assert main([*words, "--scheduler", address, "--batches", str(batches)]) == 0
    assert json.loads(capsys.readouterr().out) == here
    assert np.isfinite(here["power_share_unmodulated"])
    assert len(list(batches.rglob("*.npz"))) >= 16


def test_a_record_names_its_arguments_in_any_order() -> None:
    first = tasks._made_of("digest", {"step": "ranges", "rows": [0, 4]})
    assert tasks._made_of("digest", {"rows": [0, 4], "step": "ranges"}) == first
    assert tasks._made_of("digest", {"rows": [0, 5], "step": "ranges"}) != first
    assert tasks._made_of("other", {"rows": [0, 4], "step": "ranges"}) != first


def test_a_fitted_step_is_used_again_for_the_same_file_only() -> None:
    step, source = cast(Any, object()), cast(Any, object())
    key = parts._Known("ranges, a.nc, 1", step, source)
    # Opened again for each range of rows.
    again = parts._Known("ranges, a.nc, 1", cast(Any, object()), cast(Any, object()))
    other = parts._Known("ranges, a.nc, 2", step, source)
    assert key == again
    assert hash(key) == hash(again)
    assert key != other
    assert key != "ranges, a.nc, 1"


@pytest.mark.parametrize("by_file", [True, False])
def test_a_file_is_made_again_when_what_it_was_made_from_has_changed(
    tmp_path: Path, by_file: bool
) -> None:
    source, made = tmp_path / "source.toml", []

    def of(content: str) -> Path | str:
        source.write_text(content)
        return source if by_file else content

    def make(path: Path) -> None:
        made.append(path.name)
        path.write_text("result")

    folder = tmp_path / "scan"
    folder.mkdir()
    for content, how, count in (
        ("one", 1, 1), ("one", 1, 1), ("two", 1, 2), ("two", 2, 3), ("two", 2, 3)
    ):  # fmt: skip
        record = tasks.Record(folder)
        given = of(content)
        assert record.is_made("a.nc", of=given, how={"n": how}) == (count == len(made))
        record.made("a.nc", of=given, how={"n": how}, make=make)
        assert len(made) == count
    # A result that was changed by hand is made again, too.
    (folder / "a.nc").write_text("other")
    assert not tasks.Record(folder).is_made("a.nc", of=of("two"), how={"n": 2})
