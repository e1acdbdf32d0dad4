"""Wrong combinations of options are named before a file is read or written."""

from __future__ import annotations

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from amulor.cli import main
from amulor.cli._arguments import UsageError
from amulor.cli.site import epochs_of

#: Words of a command, and what is said of them. Files `there` exist, others do not.
WRONG = [
    (
        "acquire none.toml -o run --retake-flagged",
        "--retake-flagged needs a scan to go",
    ),
    (
        "acquire none.toml -o run --shutter-closed --calibration none.toml",
        "--shutter-closed measures the leakage; leave --calibration out",
    ),
    ("archive none.toml -o out --check out", "--check looks at an archive; give no"),
    ("archive none.toml --check out", "--check looks at an archive; give no"),
    ("archive none.toml", "name a project file and the folder to make"),
    ("archive -o out", "name a project file and the folder to make"),
    (
        "backscatter none.toml --scheduler local",
        "--scheduler goes with --model photons",
    ),
    (
        "backscatter none.toml --model photons --scheduler local",
        "--scheduler and --batches go together",
    ),
    (
        "backscatter none.toml --model photons --batches out",
        "--scheduler and --batches go together",
    ),
    ("backscatter none.toml --plot b.txt", "--plot b.txt: the ending says the format"),
    ("calibrate polarizer none.nc -o c.toml", "--angles is missing"),
    (
        "calibrate polarizer none.nc --angles 0,30,x -o c.toml",
        "needed are numbers with",
    ),
    (
        "calibrate polarizer none.nc --angles 0,inf -o c.toml",
        "needed are finite numbers",
    ),
    ("calibrate plate none.nc -o c.toml", "--distance is missing"),
    ("calibrate plate none.nc --distance 1m", "--output is missing"),
    ("calibrate plate none.nc --distance 1m -o c.txt", "c.txt: the ending says"),
    ("design none.toml", "needed is --output survey.toml, or --interactive"),
    (
        "design none.toml --interactive --runner-up r.toml",
        "--runner-up goes with --out",
    ),
    ("design none.toml -o s.toml --runner-up s.toml", "name the same file"),
    ("design none.toml -o s.txt", "--output s.txt: the ending says the format"),
    ("export none.nc -o c.xyz --product mesh", "c.xyz: the ending says the format"),
    ("export there.nc -o c.ply --slim", "--slim and --line-number need a .laz or .las"),
    (
        "export there.nc -o c.ply --line-number 3",
        "--slim and --line-number need a .laz",
    ),
    ("export there.nc -o c.laz --line-number 3", "--line-number needs --trajectory"),
    ("export there.nc -o c.laz --mounting there.toml", "--mounting needs --trajectory"),
    (
        "export there.nc -o c.laz --trajectory there.csv --pose there.toml",
        "--trajectory excludes --pose and --tile-rows",
    ),
    (
        "export there.nc -o c.laz --trajectory there.csv --tile-rows 5",
        "--trajectory excludes --pose and --tile-rows",
    ),
    ("export none.nc -o d.tif --tile-rows 5", "--tile-rows 5: state 1 row or more"),
    ("export there.nc -o c.ply --tile-rows 0", "--tile-rows 0: state 1 row or more"),
    ("export none.nc -o d.tif --cell 0m", "--cell 0m: must be above 0 m"),
    ("export none.nc -o d.tif --scale 20", "--scale '20': write a scale such as 1:20"),
    ("export none.nc -o d.csv --product section", "a product section needs --line"),
    (
        "export none.nc -o d.csv --product deviation",
        "product deviation needs --against",
    ),
    ("export none.nc -o s.csv --line=0m,0m,1m", "state four lengths, right and up"),
    ("export none.nc -o s.csv --line=1m,2m,1m,2m", "both ends are the same"),
    ("calibrate platform none.nc --mounting none.toml", "--trajectory is missing"),
    ("profile none.nc --pixel 1,2 -o p.txt", "p.txt: the ending says the format"),
    ("profile none.nc --pixel 1", "'1' is no row and column"),
    ("profile none.nc --pixel 1,2 --nearest 1m", "must be given together"),
    ("profile none.nc --pixel 1,2 --nearest 2m --farthest 1m", "from at least 0 m"),
    ("profile none.nc --pixel 1,2 --nearest=-1m --farthest 1m", "from at least 0 m"),
    ("report none.nc -o r.txt", "--output r.txt: the ending says the format"),
    ('report none.nc -o r.html --check "1,2 3,4"', 'write "ROW,COLUMN ROW,COLUMN LEN'),
    ('report none.nc -o r.html --check "1,2 3,4 1m 1mm x"', "too many words, or a neg"),
    ('report none.nc -o r.html --check "1,2 3,4 1m 0mm"', "a tolerance above 0 m"),
    ("reproduce ricci2010 -o out --figure 2", "--figure 2: figures 1 and 3 to 15 are"),
    ("reproduce ricci2010 -o out --quick --scheduler local", "--scheduler varies num"),
    ("run none.toml -o out --workers 2", "--workers is a number from 1 on, with"),
    ("site register none.toml -o p.txt", "--output p.txt: the ending says the format"),
    (
        "import trajectory there.csv -o t.txt",
        "--output t.txt: the ending says the format",
    ),
    (
        "import trajectory there.csv -o t.csv",
        "--columns is missing: a table needs a map",
    ),
    (
        "import trajectory there.nmea -o t.csv",
        "--crs is missing: there.nmea has geographic",
    ),
    (
        "import trajectory there.csv -o t.csv --crs EPSG:1",
        "--crs belongs to a log, but there",
    ),
    (
        "import trajectory there.csv -o t.csv --topic x",
        "--topic belongs to a bag, but there",
    ),
    (
        "import trajectory there.xtf -o t.csv --crs EPSG:1 --crs-offset 1m,2m",
        "--crs-offset '1m,2m': state three values, lengths to the east",
    ),
    (
        "import trajectory there.xtf -o t.csv --crs EPSG:1 --uncertainty 1m,2deg",
        "--uncertainty '1m,2deg': state three values, a length and two angles",
    ),
    ("view none.ply --samples none.nc", "go with a range image or a cube, not with"),
    ("view none.nc --poses none.json", "--poses goes with a site file"),
    ("view none.nc --unit mm", "--unit goes with a mesh or a cloud; scans are in"),
    ("view none.toml --unit mm", "--unit goes with a mesh or a cloud; sites are in"),
    ("view none.nc --save v.txt", "--save v.txt: the ending says the format"),
    (
        "water --wavelength 399nm --temperature 15 --salinity 35",
        "the constants are known from 400 nm to 700 nm",
    ),
    (
        "water --wavelength 701nm --temperature 15 --salinity 35",
        "the constants are known from 400 nm to 700 nm",
    ),
]


@pytest.mark.parametrize(
    ("words", "expected"), WRONG, ids=[words for words, _ in WRONG]
)
def test_wrong_use_is_named_in_a_line_and_leaves_nothing(
    words: str,
    expected: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    there = [word for word in shlex.split(words) if word.startswith("there.")]
    for name in there:
        Path(name).touch()
    assert main(shlex.split(words)) == 2
    said = capsys.readouterr()
    assert expected in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(set(there))


@pytest.mark.parametrize("wavelength", ["400 nm", "700 nm"])
def test_constants_of_water_are_known_at_both_ends(wavelength: str) -> None:
    assert (
        main(["water", "--wavelength", wavelength, "--temperature=15", "--salinity=35"])
        == 0
    )


def test_the_first_and_the_last_visit_are_compared_or_those_that_are_named() -> None:
    names = ("spring", "summer", "autumn")
    site: Any = SimpleNamespace(epoch=[SimpleNamespace(name=name) for name in names])
    assert epochs_of(site, None, None) == ("spring", "autumn")
    assert epochs_of(site, "autumn", "summer") == ("autumn", "summer")
    with pytest.raises(UsageError, match="'winter' is no epoch of the site; there are"):
        epochs_of(site, "spring", "winter")
    with pytest.raises(UsageError, match="must be given together"):
        epochs_of(site, None, "winter")
