"""Every command that the README and the guides show exists, with the options they show."""

from __future__ import annotations

import io
import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import pytest

from skin2urdf.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^```sh\s*\n(.*?)^```\s*$", re.MULTILINE | re.DOTALL)
OPTION = re.compile(r"--?[A-Za-z][\w-]*")


def shell_commands(markdown: str) -> Iterator[list[str]]:
    """Words of every command in the fenced ``sh`` blocks, continuation lines joined."""
    for block in FENCE.findall(markdown):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line.strip().removeprefix("$ "), comments=True)
            if words:
                yield words


PAGES = [ROOT / "README.md", *sorted((ROOT / "skin2urdf" / "guides").glob("*.md"))]


def readme_commands(*starts: str) -> list[list[str]]:
    """Commands of the README and the guides whose program starts with one of ``starts``."""
    found = [words for page in PAGES for words in shell_commands(page.read_text(encoding="utf-8"))]
    unique = {tuple(words): words for words in found}
    return [words for words in unique.values() if words[0].startswith(starts)]


def options_of(words: list[str]) -> set[str]:
    return {match[0] for word in words if (match := OPTION.match(word))}


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - commands of this repository alone
        command,
        cwd=ROOT,
        env={**os.environ, "COLUMNS": "120"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@cache
def help_of_script(script: str) -> str:
    done = run(str(ROOT / script), "--help")
    assert done.returncode == 0, f"{script}: {done.stderr}"
    return done.stdout


@cache
def options_in_help(*subcommand: str) -> frozenset[str]:
    """Options that the command line names in its help."""
    with redirect_stdout(io.StringIO()) as shown, pytest.raises(SystemExit) as stopped:
        main([*subcommand, "--help"])
    assert stopped.value.code == 0
    return frozenset(OPTION.findall(shown.getvalue()))


def test_the_finder_reads_shell_blocks() -> None:
    text = (
        "a\n```sh\n$ skin2urdf x -o a.b \\\n   --long-one=3  # why\n```\n```py\nskin2urdf y\n```\n"
    )
    (words,) = shell_commands(text)
    assert words[:2] == ["skin2urdf", "x"]
    assert options_of(words) == {"-o", "--long-one"}


def test_the_readme_shows_the_two_commands_and_the_calibration() -> None:
    programs = [words[0] for words in readme_commands("")]
    assert {"scripts/demo", "scripts/test"} <= set(programs)
    assert any(words[1:2] == ["calibrate"] for words in readme_commands("skin2urdf"))


@pytest.mark.parametrize("words", readme_commands("scripts/", "./scripts/"), ids=" ".join)
def test_scripts_know_what_the_readme_shows(words: list[str]) -> None:
    script = ROOT / words[0]
    assert os.access(script, os.X_OK), f"{words[0]} is no executable file"
    if options_of(words[1:]):
        assert options_of(words[1:]) <= set(OPTION.findall(help_of_script(words[0])))


@pytest.mark.parametrize("script", ["scripts/setup", "scripts/test", "scripts/demo"])
def test_scripts_explain_themselves_and_refuse_what_they_do_not_know(script: str) -> None:
    text = help_of_script(script)
    assert text.startswith(("Make", "Check", "Record"))
    assert f"usage: {script}" in text
    assert "set -euo" not in text


@pytest.mark.parametrize("script", ["scripts/setup", "scripts/demo"])
def test_scripts_refuse_an_unknown_argument(script: str) -> None:
    done = run(str(ROOT / script), "--no-such-option")
    assert done.returncode == 2
    assert "--no-such-option" in done.stderr


def test_the_readme_is_read_in_two_minutes() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 1300


def test_the_readme_lists_every_guide() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [page.name for page in PAGES[1:] if f"guides/{page.name}" not in text] == []
