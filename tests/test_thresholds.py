"""No constant that decides something without its reason, and none that is another one than told."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from sensitive.constants import PACKAGE, constants

GUIDE = PACKAGE / "guides" / "thresholds.md"
ROOMS = (
    "signals",
    "structure",
    *(f"estimation/{part}" for part in ("problem", "start", "solve", "trajectory", "uncertainty")),
    "hypotheses",
)


def rows() -> Iterator[tuple[str, str, str]]:
    """Module, name and value of the constants in the guide's table."""
    for line in GUIDE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip(" `") for cell in line.split("|")]
        if len(cells) == 7 and "/" in cells[3]:
            names, values = cells[1].split(","), cells[2].split(",")
            if len(values) != len(names):
                values = [""] * len(names)
            yield from (
                (cells[3], n.strip(), v.strip()) for n, v in zip(names, values, strict=True)
            )


def test_every_constant_stands_in_the_guide() -> None:
    found = constants(ROOMS)
    assert len(found) > 300
    told = {(module, name) for module, name, _ in rows()}
    assert {(constant.module, constant.name) for constant in found} - told == set()


def test_values_are_those_of_the_code() -> None:
    values = {(module, name): value for module, name, value in rows()}
    compared = 0
    for constant in constants(ROOMS):
        try:
            told = float(values[constant.module, constant.name])
        except (KeyError, ValueError):
            continue  # With a unit, or in words; or it stands in no row, which is another test's.
        assert told == pytest.approx(constant.value, rel=1e-2), constant
        compared += 1
    assert compared > 150
