"""Processor time of the first use of photon transport, by step of the compiler.

    python benchmarks/measure_first_use.py

Compiles into an empty folder, runs a short problem once and prints the functions that
took the longest, with the times of their steps in seconds of the wall clock. The type
inference of a function includes the compilation of the functions that it calls.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import tempfile
import time

SHOWN = 12


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder
        start = time.process_time()
        # numba reads the folder when it is imported.
        from time_transport import NARROW, run_of

        from amulor.transport import PlaneTarget, _kernels

        target = PlaneTarget(position=(0, 0, 2.0), reflectance=0.3)
        run_of(NARROW, 8_000, 1, [0.0, 50e6], target=target, threads=1)
        seconds = time.process_time() - start
    from numba.core.dispatcher import Dispatcher

    rows = []
    for part in pkgutil.iter_modules(_kernels.__path__):
        module = importlib.import_module(f"amulor.transport._kernels.{part.name}")
        for name, loop in vars(module).items():
            if not isinstance(loop, Dispatcher) or loop.__module__ != module.__name__:
                continue
            for signature in loop.signatures:
                steps = loop.get_metadata(signature)["pipeline_times"]["nopython"]
                times = {key: step.run for key, step in steps.items()}
                inference = sum(v for k, v in times.items() if "inference" in k)
                lowering = sum(v for k, v in times.items() if "native_lowering" in k)
                rows.append((name, sum(times.values()), inference, lowering))
    whole = max(row[1] for row in rows)
    print(f"{seconds:.1f} s of processor time, {len(rows)} loops")
    print("| loop | total | type inference | lowering | lowering of all |")
    print("| --- | --- | --- | --- | --- |")
    for name, total, inference, lowering in sorted(rows, key=lambda r: -r[1])[:SHOWN]:
        print(
            f"| `{name}` | {total:.2f} | {inference:.2f} | {lowering:.2f} "
            f"| {lowering / whole:.0%} |"
        )
    print(f"lowering of all loops: {sum(row[3] for row in rows) / whole:.0%}")


if __name__ == "__main__":
    main()
