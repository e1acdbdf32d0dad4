"""Feeds damaged and edited files to a reader: nothing but one clear refusal, or none.

A case is a seed: the same seed makes the same file. Each reader gets files that are
real, changed in the way of its format (`mutations.py`) or byte by byte.
"""

from __future__ import annotations

import contextlib
import random
import resource
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amulor.errors import AmulorError

#: What one case may take of the processor [s]; a hang takes more.
LONGEST = 10.0
#: What a case may add to the memory of its process, at its highest [bytes].
MOST_MEMORY = 500_000_000
#: What a text of refusal may have; a page of numbers is no message.
_LONGEST_LINE = 1_000

Mutation = Callable[[bytes, random.Random], bytes]


def _nothing(result: Any, case: str) -> None:
    """Accept whatever was read."""


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A function that reads files, and what it is to be fed with."""

    read: Callable[[Path], Any]
    """The reader."""
    files: dict[str, bytes]
    """Names and contents of real files."""
    mutations: tuple[Mutation, ...]
    """What changes a content."""
    judge: Callable[[Any, str], None] = _nothing
    """Raises if what was read holds a number that should have been refused."""
    whole: Callable[[Any, str, bytes], None] | None = None
    """Raises if a file that a digest protects was read as something else: what was
    read, the name of the real file, and the damaged content."""


@dataclass
class Counts:
    """How the cases of a campaign ended."""

    accepted: int = 0
    refused: int = 0
    slowest: float = 0.0
    """Processor time of a case [s]."""
    memory: int = 0
    """Largest memory that a case added to the process [bytes]."""


def fed(
    reader: Reader, folder: Path, name: str, content: bytes, case: str
) -> tuple[bool, float]:
    """Feed a reader with one file.

    Parameters
    ----------
    reader : Reader
        Who is fed.
    folder : pathlib.Path
        Where the file is written.
    name : str
        Name of the real file that it was.
    content : bytes
        Content of the file.
    case : str
        Name of the case in errors.

    Returns
    -------
    accepted : bool
        Whether the file was read and not refused.
    taken : float
        Processor time [s].

    Raises
    ------
    AssertionError
        As for `campaign`.
    """
    path = folder / name
    path.write_bytes(content)
    begun = time.process_time()
    accepted = False
    try:
        with warnings.catch_warnings():
            # What packages warn about in damaged files is no concern of the test.
            warnings.simplefilter("ignore")
            result = reader.read(path)
    except AmulorError as error:
        said = str(error)
        assert said.strip(), case
        for line in said.splitlines():
            assert line.strip(), (case, said)
            assert len(line) < _LONGEST_LINE, (case, said)
    except Exception as error:
        raise AssertionError(f"{case}: {type(error).__name__}: {error}") from error
    else:
        reader.judge(result, case)
        if reader.whole is not None:
            reader.whole(result, name, content)
        accepted = True
    taken = time.process_time() - begun
    assert taken < LONGEST, (case, taken)
    return accepted, taken


def campaign(reader: Reader, folder: Path, seeds: range) -> Counts:
    """Feed a reader with a case for each seed.

    Parameters
    ----------
    reader : Reader
        Who is fed.
    folder : pathlib.Path
        Where the files are written, and where those lie that they name.
    seeds : range
        One for each case.

    Returns
    -------
    Counts
        For the reader of a report.

    Raises
    ------
    AssertionError
        With the seed, if one ends in another error than the program's own, in words
        that are no line, late, or in what `judge` refuses.
    """
    counts = Counts()
    for seed in seeds:
        rng = random.Random(seed)
        name = rng.choice(sorted(reader.files))
        content = reader.files[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numbers that do not fit, on purpose
            for _ in range(rng.choice((1, 1, 1, 2, 5))):
                content = rng.choice(reader.mutations)(content, rng)
        with contextlib.suppress(OSError):  # Linux: the highest memory counts anew
            Path("/proc/self/clear_refs").write_text("5")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        accepted, taken = fed(reader, folder, name, content, f"{name}, seed {seed}")
        more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        counts.accepted += accepted
        counts.refused += not accepted
        counts.slowest = max(counts.slowest, taken)
        # Linux tells kilobytes.
        counts.memory = max(counts.memory, 1024 * more)
    assert counts.memory < MOST_MEMORY, counts
    return counts
