"""All kinds of hypotheses: a new one is one file, its test, and a line here."""

from __future__ import annotations

from skin2urdf.hypotheses.changes import Changes
from skin2urdf.hypotheses.contact import Contact
from skin2urdf.hypotheses.encoder import Encoders
from skin2urdf.hypotheses.mirrored import Mirrored
from skin2urdf.hypotheses.names import Names
from skin2urdf.hypotheses.search import Kind
from skin2urdf.hypotheses.sense import Senses
from skin2urdf.hypotheses.slip import Slips
from skin2urdf.hypotheses.structure import Structures

KINDS: tuple[Kind, ...] = (
    Encoders(), Contact(), Slips(), Mirrored(), Names(), Senses(), Changes(), Structures(),
)  # fmt: skip
"""In the order in which their findings are told."""
