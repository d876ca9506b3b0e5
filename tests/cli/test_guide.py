"""``skin2urdf guide``: every guide is listed and shown as it is."""

import pytest

from skin2urdf.cli.commands.guide import guides
from skin2urdf.cli.main import main


def test_all_guides_are_listed_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["guide"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert {"record", "calibrate", "judge", "use", "how-it-works", "measured"} <= set(listed)
    for name in listed:
        assert main(["guide", name]) == 0
        assert capsys.readouterr().out == guides()[name].read_text(encoding="utf-8")


def test_a_guide_that_is_not_there_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["guide", "no-such"]) == 2
    assert "no-such" in capsys.readouterr().err
