"""Names from logs as text in figures, which take some of it for markup."""

from __future__ import annotations

_ENTITIES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_LOOKALIKES = str.maketrans({"<": "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}",
                             ">": "\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}"})  # fmt: skip


def in_words(name: str) -> str:
    """A name where plotly draws text: titles, ticks, legends, what a pointer shows."""
    return name.translate(_ENTITIES)


def in_space(name: str) -> str:
    """A name as a label in 3D, where tags act and entities are not known."""
    return name.translate(_LOOKALIKES)
