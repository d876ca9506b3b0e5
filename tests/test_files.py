"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from skin2urdf.errors import UnreadableInputError, UsageError
from skin2urdf.files import check_target, read_description, write_atomically


def test_text_is_written_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    write_atomically(path, "é\n<robot/>\n")
    assert path.read_bytes() == "é\n<robot/>\n".encode()
    write_atomically(str(path), "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_logs_are_told_from_descriptions(tmp_path: Path) -> None:
    path, bag = tmp_path / "robot.urdf", tmp_path / "bag"
    path.write_text("<robot/>")
    assert read_description(path) == b"<robot/>"
    bag.mkdir()
    for place, why in ((bag, ""), (tmp_path / "none", "")):
        with pytest.raises(UnreadableInputError) as caught:
            read_description(place)
        assert caught.value.why == why
    (bag / "metadata.yaml").touch()
    path.write_bytes(b"\x89MCAP0\r\n")
    for place in (bag, path):
        with pytest.raises(UnreadableInputError) as caught:
            read_description(place)
        assert caught.value.why == "a log"


def test_a_new_file_obeys_the_umask(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    before = os.umask(0o022)
    try:
        write_atomically(path, "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_a_link_keeps_being_a_link(tmp_path: Path) -> None:
    path, link = tmp_path / "robot.urdf", tmp_path / "link.urdf"
    link.symlink_to(path)
    write_atomically(link, "x")
    assert link.is_symlink()
    assert path.read_text() == "x"


def test_failure_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text("old")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UsageError) as caught:
        write_atomically(path, "new")
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno == errno.ENOSPC
    assert caught.value.exit_status == 2
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_text_that_can_not_be_encoded_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(UnicodeEncodeError):
        write_atomically(tmp_path / "robot.urdf", "\ud800")
    assert list(tmp_path.iterdir()) == []


def test_unusable_targets_are_named_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    targets = (
        tmp_path / "missing" / "robot.urdf",
        tmp_path,
        tmp_path / "file" / "robot.urdf",
        Path("/dev/null"),
    )
    for target in targets:
        with pytest.raises(UsageError, match=re.escape(str(target))) as caught:
            check_target(target)
        assert caught.value.remedy
        assert caught.value.exit_status == 2


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UsageError, match=re.escape(str(tmp_path))):
        check_target(tmp_path / "robot.urdf")


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="no /dev/stdout here")
def test_streams_are_no_files_wherever_they_lead(tmp_path: Path) -> None:
    """Also those that were sent to a file, which keeps its place and its text."""
    (tmp_path / "link").symlink_to("/dev/stdout")
    words = [sys.executable, "-c", _TRY]
    for target in ("/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", str(tmp_path / "link")):
        with (tmp_path / "out").open("w+") as out:
            done = subprocess.run([*words, target], stdout=out, check=False)  # noqa: S603
            assert (done.returncode, (tmp_path / "out").read_text()) == (2, "before")
            assert os.fstat(out.fileno()).st_nlink == 1
        piped = subprocess.run([*words, target], capture_output=True, check=False)  # noqa: S603
        assert (piped.returncode, piped.stdout) == (2, b"before")


_TRY = """
import sys
from skin2urdf.errors import UsageError
from skin2urdf.files import write_atomically

print("before", end="", flush=True)
try:
    write_atomically(sys.argv[1], "after")
except UsageError as error:
    sys.exit(error.exit_status)
"""
