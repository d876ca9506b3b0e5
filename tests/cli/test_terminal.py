"""What a person at a terminal gets: lines that fit, colour, guesses, completion, a manual page."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from calibrated import calibration
from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.cli import terminal
from skin2urdf.cli.arguments import did_you_mean
from skin2urdf.cli.commands.export import FORMATS
from skin2urdf.cli.main import main
from skin2urdf.cli.parser import COMMANDS
from skin2urdf.geometry.units import JOINT_UNITS
from skin2urdf.report.summary import as_text
from skin2urdf.report.tables import fitting, table
from skin2urdf.simulation import robot_names

WORD = st.text("abcdefgh_/- ", max_size=30)
TABLES = st.integers(1, 9).flatmap(
    lambda n: st.tuples(
        st.lists(WORD, min_size=n, max_size=n),
        st.lists(st.lists(WORD, min_size=n, max_size=n), max_size=6),
        st.text("<", min_size=n, max_size=n),
    )
)


def on_a_screen(monkeypatch: pytest.MonkeyPatch, columns: int, colour: bool = True) -> None:
    """Let the outputs be those of a terminal."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm-256color")
    if colour:
        monkeypatch.delenv("NO_COLOR", raising=False)
    else:
        monkeypatch.setenv("NO_COLOR", "1")


@pytest.mark.parametrize("columns", [60, 80, 100])
def test_a_result_fits_the_screen(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    on_a_screen(monkeypatch, columns)
    terminal.show(lambda: as_text(calibration()))
    shown = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert max(len(line) for line in shown.splitlines()) <= columns
    for name in (*calibration().model.tree.joint_names, *calibration().model.tree.su_names):
        assert name[:8] in shown
    plain = as_text(calibration())
    figures = re.compile(r"\d+\.\d+")
    assert sorted(figures.findall(shown)) == sorted(figures.findall(plain))


def test_what_is_piped_is_plain_and_as_wide_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.show(lambda: as_text(calibration()))
    assert capsys.readouterr().out == as_text(calibration())


def test_colour_marks_what_needs_attention_and_can_be_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "fair: 2 joints\n\nFaults:\n  - su_1 is dead\nj1  not observable\nj2  determined\n"
    on_a_screen(monkeypatch, 80)
    terminal.show(lambda: text)
    lines = capsys.readouterr().out.splitlines()
    coloured = ["\x1b[" in line for line in lines]
    assert coloured == [True, False, True, False, True, False]
    assert re.sub(r"\x1b\[[0-9;]*m", "", "\n".join(lines)) == text.strip()
    on_a_screen(monkeypatch, 80, colour=False)
    terminal.show(lambda: text)
    # Bold is no colour.
    assert set(re.findall(r"\x1b\[([0-9;]*)m", capsys.readouterr().out)) <= {"0", "1"}


@given(given=TABLES, width=st.integers(20, 90))
def test_tables_fit_and_lose_nothing(
    given: tuple[list[str], list[list[str]], str], width: int
) -> None:
    head, rows, align = given
    with fitting(width):
        lines = table(head, rows, align)
    assert max(len(line) for line in lines) <= width
    shown = "".join(lines)
    for cell in (*head, *(cell for row in rows for cell in row)):
        letters = re.sub(r"[\s]", "", cell)
        assert all(shown.count(c) >= letters.count(c) for c in set(letters) - {"-"})


def test_a_table_that_fits_stays_as_it_is() -> None:
    plain = table(("a", "b"), [("x", "1.0")], "<>")
    with fitting(80):
        assert table(("a", "b"), [("x", "1.0")], "<>") == plain


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["calibrat", "log.mcap"], "calibrate"),
        (["calibrate", "log.mcap", "-o", "a.urdf", "--repotr", "a.html"], "--report"),
        (["explore", "log.mcap", "--plt=a.svg"], "--plot"),
        (["calibrate", "log.mcap", "-o", "a.urdf", "--motion", "patern"], "patterns"),
    ],
)
def test_a_typo_is_guessed(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert capsys.readouterr().err.splitlines()[0].endswith(f"{meant}?")


def test_an_option_of_another_command_is_not_what_was_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "ur5", "--force"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.count("--force") == 1


def test_a_robot_that_is_misspelt_is_guessed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "pandda", "-o", "log.mcap"]) == 2
    assert " panda?" in capsys.readouterr().err
    assert did_you_mean("zzzz", robot_names()) == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_of_its_shell(
    shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "skin2urdf" in script
    if executable := shutil.which(shell):
        file = tmp_path / f"skin2urdf.{shell}"
        file.write_text(script)
        done = subprocess.run([executable, "-n", str(file)], capture_output=True, check=False)  # noqa: S603
        assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("words", "expected"),
    [("simulate pan", {"panda"}), ("cal", {"calibrate"}), ("calibrate --mod", {"--model"})],
)
def test_a_shell_is_told_what_may_follow(words: str, expected: set[str], tmp_path: Path) -> None:
    line, answer = f"skin2urdf {words}", tmp_path / "answer"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([sys.executable, "-m", "skin2urdf"], env={**os.environ, **asked}, check=False)
    assert {word.strip() for word in answer.read_text().split()} == expected


def test_the_manual_page_holds_the_help_of_every_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["man"]) == 0
    page = capsys.readouterr().out
    assert page.startswith(".TH SKIN2URDF 1 ")
    for name, command in COMMANDS.items():
        assert f"\n.SS {name}\n" in page
        first = command.EPILOG.splitlines()[1].strip()
        assert first.replace("-", "\\-") in page.replace("\\&", "")
    for line in page.splitlines():
        assert not line.startswith((".", "'")) or re.match(r"\.(TH|SH|SS|B|I|nf|fi)\b", line)


@pytest.mark.parametrize("words", [["export", "--help"], ["man"]])
def test_each_format_of_an_export_has_a_line_of_its_own(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with contextlib.suppress(SystemExit):
        main(words)
    lines = capsys.readouterr().out.splitlines()
    for name in FORMATS:
        assert sum(line.startswith(f"  {name}  ") for line in lines) == 1


def test_all_units_of_joints_are_in_the_help(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main(["convert", "--help"])
    help_ = capsys.readouterr().out
    assert set(JOINT_UNITS) <= set(re.findall(r"[^\s,;()]+", help_[help_.rindex("[JOINT=]UNIT") :]))
