"""A file appears whole under its name, or what was there stays."""

import os
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io.files import atomic_output, read_bytes


def one_line(info):
    text = str(info.value)
    assert "\n" not in text
    return text


def test_the_file_appears_only_when_it_is_whole(tmp_path):
    path = tmp_path / "cube.nc"
    with atomic_output(path) as temporary:
        temporary.write_bytes(b"half")
        assert not path.exists()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".nc"
        assert temporary.name.startswith(".")
    assert path.read_bytes() == b"half"
    assert list(tmp_path.iterdir()) == [path]


def test_an_existing_file_is_refused_with_the_remedy(tmp_path):
    path = tmp_path / "cube.nc"
    path.write_bytes(b"old")
    with (
        pytest.raises(FormatError) as info,
        atomic_output(path, overwrite=False) as temporary,
    ):
        temporary.write_bytes(b"new")
    assert str(path) in one_line(info)
    assert "--overwrite" in one_line(info)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_existing_file_is_replaced_on_request(tmp_path):
    path = tmp_path / "cube.nc"
    path.write_bytes(b"old")
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyError, CubeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("existing", [True, False])
def test_any_exception_leaves_everything_as_it_was(tmp_path, error, existing):
    path = tmp_path / "cube.nc"
    if existing:
        path.write_bytes(b"old")

    def write_half():
        with atomic_output(path, overwrite=True) as temporary:
            temporary.write_bytes(b"half")
            raise error("inside")

    with pytest.raises(error, match="inside"):
        write_half()
    assert [entry.name for entry in tmp_path.iterdir()] == ["cube.nc"] * existing
    assert not existing or path.read_bytes() == b"old"


def test_a_process_killed_while_writing_leaves_the_old_file_whole(tmp_path):
    path = tmp_path / "cube.nc"
    path.write_bytes(b"old")
    program = (
        "import os, signal, sys\n"
        "from amulor.io.files import atomic_output\n"
        "with atomic_output(sys.argv[1], overwrite=True) as temporary:\n"
        "    temporary.write_bytes(b'half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == b"old"


def test_the_content_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    path = tmp_path / "cube.nc"
    events = []

    def synchronise(handle):
        kind = "folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"
        events.append(f"synchronise {kind}")

    def replace(source, target, *, genuine=os.replace):
        events.append("replace")
        genuine(source, target)

    monkeypatch.setattr(os, "fsync", synchronise)
    monkeypatch.setattr(os, "replace", replace)
    with atomic_output(path) as temporary:
        temporary.write_bytes(b"whole")
    assert events == ["synchronise file", "replace", "synchronise folder"]


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path, small_disk):
    path = tmp_path / "cube.nc"
    with (
        small_disk(),
        pytest.raises(FormatError) as info,
        atomic_output(path) as temporary,
    ):
        temporary.write_bytes(bytes(100_000))
    assert str(path) in one_line(info)
    assert "File too large" in one_line(info)
    assert list(tmp_path.iterdir()) == []


def test_permissions_follow_the_mask_of_the_process(tmp_path):
    path = tmp_path / "cube.nc"
    earlier = os.umask(0o027)
    try:
        with atomic_output(path) as temporary:
            temporary.write_bytes(b"whole")
    finally:
        os.umask(earlier)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_replaced_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "cube.nc"
    path.write_bytes(b"old")
    path.chmod(0o600)
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_bytes(b"new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_link_stays_a_link_to_the_new_file(tmp_path):
    target, link = tmp_path / "target.nc", tmp_path / "link.nc"
    target.write_bytes(b"old")
    link.symlink_to(target)
    with atomic_output(link, overwrite=True) as temporary:
        temporary.write_bytes(b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"


def unusable_names(tmp_path):
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere.nc")
    os.mkfifo(tmp_path / "pipe")
    return {
        "missing folder": tmp_path / "missing" / "cube.nc",
        "folder is a file": tmp_path / "file" / "cube.nc",
        "is a folder": tmp_path,
        "is a pipe": tmp_path / "pipe",
        "loop": tmp_path / "loop",
        "dangling link": tmp_path / "dangling",
        "zero byte": tmp_path / "a\0b",
        "too long": tmp_path / ("x" * 300 + ".nc"),
    }


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("missing folder", "there is no folder"),
        ("folder is a file", "there is no folder"),
        ("is a folder", "is a folder"),
        ("is a pipe", "pipe"),
        ("loop", "link to itself"),
        ("dangling link", "nowhere.nc, which does not exist"),
        ("zero byte", "no name for a file"),
        ("too long", "too long"),
    ],
)
def test_a_name_that_cannot_be_written_is_refused_before_any_work(
    tmp_path, case, words
):
    path = unusable_names(tmp_path)[case]
    before = sorted(tmp_path.iterdir())
    with pytest.raises(FormatError, match=words) as info:
        atomic_output(path, overwrite=True).__enter__()
    assert one_line(info).isprintable()
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("missing folder", "does not exist"),
        ("is a folder", "is a folder"),
        ("is a pipe", "pipe"),
        ("loop", "does not exist"),
        ("too long", "too long"),
    ],
)
def test_a_name_that_cannot_be_read_is_refused(tmp_path, case, words):
    with pytest.raises(FormatError, match=words) as info:
        read_bytes(unusable_names(tmp_path)[case])
    one_line(info)


def test_an_empty_file_is_refused(tmp_path):
    path = tmp_path / "cube.nc"
    path.touch()
    with pytest.raises(FormatError, match="is empty"):
        read_bytes(path)


@pytest.fixture
def open_folder():
    """Give a folder that any user can enter, which pytest's own is not."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        yield folder


def test_permissions_that_are_lacking_are_named(open_folder):
    closed, secret = open_folder / "closed", open_folder / "secret.nc"
    closed.mkdir()
    closed.chmod(0o555)
    secret.write_bytes(b"x")
    secret.chmod(0o000)
    user = os.geteuid()
    if user == 0:  # the rules do not hold for root
        os.seteuid(65534)
    try:
        with pytest.raises(AmulorError, match="Permission denied") as written:
            atomic_output(closed / "cube.nc").__enter__()
        with pytest.raises(AmulorError, match="Permission denied") as read:
            read_bytes(secret)
    finally:
        os.seteuid(user)
    assert "cube.nc" in one_line(written)
    assert "secret.nc" in one_line(read)
