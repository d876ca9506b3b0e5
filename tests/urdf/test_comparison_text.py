"""The comparison as text shows every SU and joint, the overall and what was left out."""

from __future__ import annotations

import numpy as np

from skin2urdf.report.comparison import as_text
from skin2urdf.urdf.records import (
    Alignment,
    Comparison,
    Difference,
    JointError,
    Spread,
    SuError,
)

NOTHING = Spread.of(np.zeros(0))
ALIGNMENT = Alignment("shoulder", ("su_7f3a",), ("su_7f3a",), np.eye(4))


def example(**changes: object) -> Comparison:
    fields: dict[str, object] = {
        "sus": (
            SuError("su_7f3a", Spread(0.0004567, 0.0009), Spread(np.deg2rad(0.05), 0.002)),
            SuError("base_su", None, Spread(0.001, 0.002), 4),
        ),
        "joints": (
            JointError("shoulder", "revolute", Spread(0.001, 0.002), Spread(0.0012, 0.0024)),
            JointError("slide", "prismatic", Spread(0.001, 0.002), None),
        ),
        "position": Spread(0.0003, 0.0009),
        "orientation": Spread(0.001, 0.002),
        "axis_angle": Spread(0.001, 0.002),
        "axis_distance": Spread(0.0012, 0.0024),
        "alignments": (ALIGNMENT,),
        "tree_equal": True,
        "tree_differences": (),
        "not_observable": (),
        "n_open": 0,
        "joints_left_out": (),
        "unmatched": (),
        "held_joints": (),
        "n_configurations": 200,
    }
    return Comparison(**{**fields, **changes})  # type: ignore[arg-type]


def test_rows_carry_their_figures() -> None:
    text = as_text(example())
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    assert rows["Tree:"] == ["Tree:", "right"]
    assert rows["su_7f3a"] == ["su_7f3a", "0.457", "0.900", "0.050", "0.115"]
    assert rows["base_su"][1:5] == ["-", "-", "0.057", "0.115"]
    assert rows["base_su"][5:8] == ["4", "of", "6"]
    assert rows["shoulder"] == ["shoulder", "1.200", "2.400", "0.057", "0.115"]
    assert rows["slide"][-1] == "prismatic"
    assert " 200 " in text
    assert not any(line != line.rstrip() for line in text.splitlines())


def test_columns_line_up() -> None:
    lines = as_text(example()).splitlines()
    head, row = lines[3], next(line for line in lines if line.startswith("su_7f3a"))
    for figure, heading in (("0.457", head.index("rms")), ("0.115", head.rindex("max"))):
        assert row.index(figure) + len(figure) == heading + 3


def test_what_is_wrong_or_left_out_is_said() -> None:
    text = as_text(
        example(
            tree_equal=False,
            tree_differences=(Difference("chain", "a", "a: b, c", ("b",), ("c",)),),
            not_observable=("x", "y"),
            n_open=2,
            joints_left_out=("toe",),
            unmatched=("ghost",),
            held_joints=("finger",),
        )
    )
    lines = text.splitlines()
    assert lines[0] != as_text(example()).splitlines()[0]
    assert lines[1].endswith(" a: b, c")
    ends = ("x, y.", "toe.", "ghost.", "finger.")
    assert all(any(line.endswith(f": {end}") for line in lines) for end in ends)
    assert any("2" in line.split() for line in lines)
    assert not any("2" in line.split() for line in as_text(example()).splitlines())


def test_a_robot_of_nothing_comparable_is_shown_with_dashes() -> None:
    text = as_text(example(joints=(), axis_angle=NOTHING, axis_distance=NOTHING))
    assert "nan" not in text


def test_the_alignment_is_said_in_one_line() -> None:
    turned = np.eye(4)
    turned[1:3, 1:3] = [[np.cos(1e-3), -np.sin(1e-3)], [np.sin(1e-3), np.cos(1e-3)]]
    other = Alignment("hip", ("su_1",), ("su_1",), turned)
    text = as_text(example(alignments=(ALIGNMENT, other)))
    line = next(line for line in text.splitlines() if " 200 " in line)
    assert line not in as_text(example())
    assert all(part in line for part in ("shoulder", "hip", " 0.057 deg"))
