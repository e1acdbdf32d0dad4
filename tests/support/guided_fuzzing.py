"""Feeds a reader with files that a coverage-guided fuzzer makes, for some seconds.

`python guided_fuzzing.py READER SECONDS FOLDER CASES`: the first byte of an input
chooses the real file, the others are its content, or changes of it. Goes on with the
inputs that FOLDER has. Ends with an error after an exception, a case of 20 s, or above
2 GB.
"""

from __future__ import annotations

import functools
import os
import random
import sys
import warnings
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "src" / "amulor"
#: Packages whose lines guide the fuzzer: those that read, and what they check with.
READING = [
    "amulor.io", "amulor._las", "amulor._hdf5", "amulor.cube", "amulor.survey",
    "amulor.acquisition.journal", "amulor.view.page.space", "laspy", "h5netcdf",
    "trimesh.exchange", "tomllib",
]  # fmt: skip
#: Modules of compiled functions, which numba does not compile with counters in them.
COMPILED = [
    ".".join(("amulor", *path.relative_to(PACKAGE).with_suffix("").parts))
    for path in PACKAGE.rglob("*.py")
    if "_kernels" in str(path) or "numba" in path.read_text("utf-8")
]


def main(name: str, seconds: str, place: str, cases: str) -> None:
    """Feed one reader."""
    import atheris

    with atheris.instrument_imports(include=READING, exclude=COMPILED):
        import fuzzed_readers
        from fuzzing import fed

        from amulor.survey import Survey

    folder = Path(place)
    # Each program makes the real files anew.
    own = folder / str(os.getpid())
    own.mkdir()
    text = (folder / "plate.toml").read_text()
    plate = Survey.from_text(text)
    if name == "journal":
        reader = fuzzed_readers.journals(own, plate)
    elif name == "survey":
        reader = fuzzed_readers.texts(own, text)[name]
    elif name in ("ply", "laz", "e57"):
        reader = fuzzed_readers.shown(own, name)
    else:
        reader = fuzzed_readers.arrays(own, plate)[name]
    files = sorted(reader.files)
    # HDF5 itself fails on damaged bytes, which digests of amulor's files find first:
    # the bytes choose changes of variables and attributes instead.
    by_change = name == "cube"
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    for number, file in enumerate(files):
        content = b"" if by_change else reader.files[file]
        (corpus / str(number)).write_bytes(bytes([number]) + content)

    def changed(content: bytes, seed: int) -> bytes:
        rng = random.Random(seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return rng.choice(reader.mutations)(content, rng)

    def test(data: bytes) -> None:
        if not data:
            return
        file, content = files[data[0] % len(files)], data[1:]
        if by_change:
            content = functools.reduce(changed, content[:6], reader.files[file])
        fed(reader, own, file, content, file)

    def mutated(data: bytes, longest: int, seed: int) -> bytes:
        if by_change or len(data) < 2 or seed % 2:
            return bytes(atheris.Mutate(data, longest))
        return (data[:1] + changed(data[1:], seed))[:longest]

    options = [f"-max_total_time={seconds}", f"-runs={cases}", "-timeout=20",
               "-rss_limit_mb=2048", "-max_len=1000000", "-print_final_stats=1",
               f"-artifact_prefix={folder}/"]  # fmt: skip
    atheris.Setup([sys.argv[0], *options, str(corpus)], test, custom_mutator=mutated)
    atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
