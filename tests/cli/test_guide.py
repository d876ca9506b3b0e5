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


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["vendor models"], "vendor-models"),
        (["Vendor", "Models"], "vendor-models"),
        (["REAL-ROBOTS"], "real-robots"),
        (["real_robots.md"], "real-robots"),
        (["record.md"], "record"),
        (["gyro"], "gyroscopes"),
    ],
)
def test_a_guide_is_found_as_a_person_writes_it(
    words: list[str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["guide", *words]) == 0
    assert capsys.readouterr().out == guides()[name].read_text(encoding="utf-8")


@pytest.mark.parametrize(("text", "meant"), [("calibarte", " calibrate?"), ("s", "simulate")])
def test_what_may_be_meant_is_told(
    text: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["guide", text]) == 2
    assert meant in capsys.readouterr().err


def test_a_guide_that_is_not_there_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["guide", "no-such"]) == 2
    assert "no-such" in capsys.readouterr().err
