"""The register of rejection methods, and a method of another package."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import io, rejection
from amulor.cli import main
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey

#: All that another package has to write.
METHOD = '''
"""Take the mean of the reference measurements off, whatever their direction."""
from amulor import cube as cubes, rejection


def fit(source, *, factor=1.0):
    of = rejection.load("open-water").fit(source)
    return lambda rows, first: _less_mean(rows, of(rows, first), factor)


def _less_mean(cube, whole, factor):
    shots = cube.amulor.open_water
    mean = (shots["in_phase"] + 1j * shots["quadrature"]).mean("shot")
    water = factor * mean.values[:, :, None, None]
    target = cube.amulor.signal.values - water
    return whole.assign(
        in_phase=whole["in_phase"].copy(data=target.real),
        quadrature=whole["quadrature"].copy(data=target.imag),
    )


@rejection.method(
    "mean-water",
    needs=rejection.Needs(open_water=True),
    simplicity={simplicity},
    fitter=fit,
)
def mean_water(cube, *, factor: float = 1.0):
    """Subtract the mean open-water signal of each frequency and channel."""
    cube = cubes.checked(cube, "samples")
    return _less_mean(cube, rejection.open_water(cube), factor)
'''


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    """Return a small scan of a plate at two frequencies."""
    text = plate_text.replace('["39 MHz"]', '["20 MHz", "60 MHz"]')
    return simulate(Survey.from_text(text), rng=3)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with another package that declares a method."""
    folder = tmp_path_factory.mktemp("packages")
    (folder / "other.py").write_text(METHOD.format(simplicity=0))
    (folder / "broken.py").write_text("raise RuntimeError('no licence')\n")
    info = folder / "other-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[amulor.rejection]\nmean-water = other:mean_water\nbroken = broken:method\n"
    )
    return folder


def amulor(package: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command where the other package is installed."""
    paths = [str(package), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.run(
        [sys.executable, "-m", "amulor", *words],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
    )


def test_every_method_is_loaded_by_its_name() -> None:
    for name in rejection.names():
        assert rejection.load(name).name == name
    pinned = {"open-water", "combined", "polarization", "frequency", "joint", "auto"}
    assert pinned <= set(rejection.names())


def test_reject_is_the_function_of_the_method(samples: xr.Dataset) -> None:
    interval = (0.8, 4.0)
    by_name = rejection.reject(samples, method="open-water", interval=interval)
    xr.testing.assert_equal(by_name, rejection.open_water(samples, interval=interval))
    # An interval serves the methods that use one, and disturbs no other.
    kept = rejection.reject(samples, method="none", interval=interval)
    xr.testing.assert_equal(kept, rejection.keep_water(samples))


def test_unknown_methods_and_options_are_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match=r"'magic'; installed are .*open-water"):
        rejection.reject(samples, method="magic")
    with pytest.raises(ValueError, match=r"joint has no option turbidity; it has int"):
        rejection.reject(samples, method="joint", turbidity=2.0)


def test_without_shots_is_the_method_on_a_cube_without_them(
    samples: xr.Dataset,
) -> None:
    blind = rejection.load("polarization").without_open_water()
    options = {"target_ratio": 0.3, "water_ratio": 0.1, "water_fluctuation": 0.05}
    if "VH" not in samples["polarization"]:
        pytest.fail("the plate has no pair of channels")
    shots = [name for name in samples if str(name).startswith("open_water_")]
    bare = rejection.polarization(samples.drop_vars(shots), **options)
    xr.testing.assert_equal(blind(samples, **options), bare)
    of = blind.fit(tiles.InMemory(samples), **options)
    xr.testing.assert_equal(of(samples.isel(row=[2]), 2), bare.isel(row=[2]))


@pytest.mark.slow
def test_the_method_of_another_package_runs_everywhere(
    package: Path, samples: xr.Dataset, tmp_path: Path
) -> None:
    scan, target = tmp_path / "samples.nc", tmp_path / "target.nc"
    io.write_cube(samples, scan)
    words = ["reject", str(scan), "--method", "mean-water", "-o", str(target)]
    done = amulor(package, *words)
    assert done.returncode == 0, done.stderr
    whole = io.read_cube(target)
    shots = samples.amulor.open_water
    mean = (shots["in_phase"] + 1j * shots["quadrature"]).mean("shot").values
    np.testing.assert_allclose(
        whole.amulor.signal.values,
        samples.amulor.signal.values - mean[:, :, None, None],
    )
    # By rows, and with an option of its own.
    rows = [*words, "--tile-rows", "2", "--overwrite"]
    done = amulor(package, *rows)
    assert done.returncode == 0, done.stderr
    xr.testing.assert_equal(io.read_cube(target), whole)
    done = amulor(package, *words, "--overwrite", "--option", "factor=0")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(
        io.read_cube(target).amulor.signal.values, samples.amulor.signal.values
    )
    # In a comparison; the broken neighbor is a line and no end.
    done = amulor(package, "reject", str(scan), "--method", "auto", "-o",
                  str(tmp_path / "auto.nc"))  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "mean-water" in done.stdout
    assert "RuntimeError: no licence" in done.stdout
    # In a site.
    (tmp_path / "site.toml").write_text(
        textwrap.dedent("""\
        name = "Wall"
        [[epoch]]
        name = "spring"
        [[scan]]
        name = "one"
        epoch = "spring"
        file = "samples.nc"
        [scan.processing]
        method = "mean-water"
        polarization = "VV"
        [scan.start]
        position = ["0 m", "0 m", "0 m"]
        heading = "0 deg"
        position_uncertainty = "1 cm"
        heading_uncertainty = "1 deg"
        level_uncertainty = "1 deg"
        """)
    )
    site = str(tmp_path / "site.toml")
    done = amulor(package, "run", site, "-o", str(tmp_path / "results"))
    assert done.returncode == 0, done.stderr
    images = [*(tmp_path / "results").rglob("range_image.nc")]
    assert len(images) == 1
    assert "mean-water" in amulor(package, "reject", "--help").stdout


def test_an_option_that_a_method_does_not_use_is_refused(
    samples: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = tmp_path / "samples.nc"
    io.write_cube(samples, scan)
    words = ["reject", str(scan), "-o", str(tmp_path / "target.nc")]
    words += ["--method", "frequency", "--column-uncertainty", "20 %"]
    assert main(words) == 2
    message = capsys.readouterr().err
    assert "frequency does not use --column-uncertainty" in message
    assert "it uses --frequency, --nearest, --farthest" in message
    assert not (tmp_path / "target.nc").exists()


#: What a method needs (open-water references, a pair of channels), its rank in `auto`,
#: and whether `auto` tries it without references, too; None is optional, or no rank.
DECLARED = {
    "auto": (None, False, None, False),
    "background": (False, False, 2, False),
    "co-polarized": (None, False, None, False),
    "combined": (True, True, 4, False),
    "cross-polarized": (False, False, 0, False),
    "frequency": (True, False, 2, False),
    "joint": (None, False, 5, True),
    "none": (None, False, None, False),
    "open-water": (True, False, 1, False),
    "phasor-lines": (None, False, None, False),
    "polarization": (None, True, 3, False),
    "polarization-difference": (None, True, 4, False),
    "range-profile": (None, False, 7, False),
    "smooth-surface": (True, False, None, False),
    "stokes": (None, False, 4, False),
}


def test_methods_declare_what_they_need_and_their_rank() -> None:
    found = {
        name: (
            method.needs.open_water, method.needs.channel_pair, method.simplicity,
            method.distrusts_open_water,
        )
        for name, method in ((name, rejection.load(name)) for name in DECLARED)
    }  # fmt: skip
    assert found == DECLARED
    one = [name for name in DECLARED if rejection.load(name).keeps_one_frequency]
    assert one == ["frequency"]
    # A profile depends on the samples of its pixel and on the references alone.
    local = [name for name in DECLARED if rejection.load(name).fitter is None]
    assert local == ["range-profile"]
