"""`scripts/setup` on machines that lack something: it says what to install, and makes nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("python3", "python3.11", "python3.12", "python3.13")

TOO_OLD = """#!/bin/sh
[ "$1" = --version ] && echo "Python 3.10.12" && exit 0
exit 1
"""
WITHOUT_ENSUREPIP = f"""#!/bin/sh
case "$*" in *ensurepip*) exit 1 ;; esac
exec '{sys.executable}' "$@"
"""


def set_up(
    tmp_path: Path, interpreter: str, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run scripts/setup where every Python on the path is ``interpreter``, a shell script."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in NAMES:
        (folder / name).write_text(interpreter)
        (folder / name).chmod(0o755)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHON"}
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(  # noqa: S603 - a script of this repository
        [ROOT / "scripts" / "setup"],
        cwd=tmp_path,
        env={**kept, "PATH": path, "SKIN2URDF_VENV": str(tmp_path / "venv"), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.parametrize(
    ("interpreter", "environment", "says"),
    [
        (TOO_OLD, {}, ["3.11", "3.10.12", "python3.11"]),
        (TOO_OLD, {"PYTHON": "python3.12"}, ["PYTHON=python3.12", "3.11"]),
        (WITHOUT_ENSUREPIP, {}, [f"python3.{sys.version_info[1]}-venv"]),
    ],
    ids=["old Python", "old Python by name", "no ensurepip"],
)
def test_what_is_missing_is_named(
    tmp_path: Path, interpreter: str, environment: dict[str, str], says: list[str]
) -> None:
    done = set_up(tmp_path, interpreter, **environment)
    assert done.returncode == 1
    for words in says:
        assert words in done.stderr
    assert not (tmp_path / "venv").exists()


def test_a_folder_that_is_no_environment_is_left_alone(tmp_path: Path) -> None:
    kept = tmp_path / "venv" / "thesis.txt"
    kept.parent.mkdir()
    kept.write_text("thesis")
    done = set_up(tmp_path, WITHOUT_ENSUREPIP)
    assert done.returncode == 1
    assert str(kept.parent) in done.stderr
    assert kept.read_text() == "thesis"
