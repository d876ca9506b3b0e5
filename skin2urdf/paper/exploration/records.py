"""What a structural exploration finds, step by step (paper Algorithm 1, Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skin2urdf.arrays import Bool, Int, Record

Group = tuple[int, ...]
"""Indices of the SUs of one segment, or of the DoFs of one joint, ascending."""

ViolationKind = Literal[
    "no static segment",
    "segment without SU",
    "end effector without SU",
    "DoF without motion",
    "SU without readings",
    "closed loop",
    "coupled DoFs",
    "missed reaction",
]
"""How a constraint of the paper (II-A.2, II-B.3) can be violated."""

BREAKS_THE_TREE: frozenset[ViolationKind] = frozenset(
    ("closed loop", "coupled DoFs", "missed reaction")
)
"""Violations after which no kinematic tree can be read from the activity matrix."""


@dataclass(frozen=True)
class Violation:
    """A violated constraint, recognised as what it is.

    Attributes:
        kind: which constraint, and how.
        words: what was found, for the user.
        remedy: what to do about it.
        sus: names of the SUs concerned.
        dofs: names of the DoFs concerned.
    """

    kind: ViolationKind
    words: str
    remedy: str
    sus: tuple[str, ...] = ()
    dofs: tuple[str, ...] = ()


@dataclass(frozen=True)
class TriangularForm:
    """The check of the sorted matrix on which the paper's connectivity rests (II-B.3).

    Attributes:
        dimensions: there is one segment more than there are joints.
        strictly_lower: no entry on or above the diagonal is 1.
        secondary_diagonal: every entry of the secondary diagonal is 1.
    """

    dimensions: bool
    strictly_lower: bool
    secondary_diagonal: bool

    @property
    def holds(self) -> bool:
        """True where the matrix has the form."""
        return self.dimensions and self.strictly_lower and self.secondary_diagonal


@dataclass(frozen=True)
class Limb:
    """A serial sequence of segments connected by joints (paper II-B.4).

    Attributes:
        segments: from the reference segment to the end effector, both included.
        joints: the joints between them; one less than there are segments.
        is_true: True for a "true" end effector (a leaf), False for a "false" one (an inner
            segment that carries sub-limbs).
    """

    segments: tuple[int, ...]
    joints: tuple[int, ...]
    is_true: bool

    @property
    def reference(self) -> int:
        """Index of the segment the limb starts from."""
        return self.segments[0]

    @property
    def end_effector(self) -> int:
        """Index of the segment the limb ends at."""
        return self.segments[-1]


@dataclass(frozen=True, eq=False)
class Exploration(Record):
    """Every result of Algorithm 1. U SUs, D DoFs, N joints, N + 1 segments.

    Segments and joints are in the order of the sorted matrix: segment 0 is the reference segment
    (RS), joint ``n`` carries segment ``n + 1``, and parents come before children. Where the
    activity matrix is none of a tree (`is_tree` is False), their order is only the nearest thing
    to a triangular one, there may be any number of segments, and ``connectivity``, end effectors
    and limbs are empty.

    Attributes:
        su_names: U SU names (line 1).
        dof_names: D DoF names (line 1).
        raw: (U, D) activity matrix (lines 2 and 3).
        merged_sus: SUs of each row of ``merged``, in the order of their first SU (line 4).
        merged_dofs: DoFs of each column of ``merged``, in the order of their first DoF (line 5).
        merged: activity of the detected segments under the detected joints.
        form: whether ``merged`` can be sorted into the paper's form; every tree without
            violations has it, but coupled DoFs can have it too.
        segments: SUs of each segment; empty where a segment must exist but carries no SU.
        joints: DoFs of each joint.
        triangular: (N + 1, N) sorted matrix, with rows for the segments that carry no SU.
        sequences: joints from the RS to each segment, in order (line 6: connection sequences).
        connectivity: (N, 2) the two segments that each joint connects, RS side first (II-B.3).
        true_end_effectors: segments with exactly one joint, without the RS (line 8).
        false_end_effectors: segments with more than two joints, without the RS (line 8).
        limbs: from the RS to every true and false end effector (line 9).
        sub_limbs: from every false end effector to the next end effectors beyond it.
        violations: the violated constraints, the most serious ones first.
    """

    su_names: tuple[str, ...]
    dof_names: tuple[str, ...]
    raw: Bool
    merged_sus: tuple[Group, ...]
    merged_dofs: tuple[Group, ...]
    merged: Bool
    form: TriangularForm
    segments: tuple[Group, ...]
    joints: tuple[Group, ...]
    triangular: Bool
    sequences: tuple[tuple[int, ...], ...]
    connectivity: Int
    true_end_effectors: tuple[int, ...]
    false_end_effectors: tuple[int, ...]
    limbs: tuple[Limb, ...]
    sub_limbs: tuple[Limb, ...]
    violations: tuple[Violation, ...] = ()

    @property
    def n_segments(self) -> int:
        """Number of segments, the RS included."""
        return len(self.segments)

    @property
    def n_joints(self) -> int:
        """Number of joints N."""
        return len(self.joints)

    @property
    def is_tree(self) -> bool:
        """True where the activity matrix is that of a kinematic tree."""
        return not any(v.kind in BREAKS_THE_TREE for v in self.violations)

    def sus_of(self, limb: Limb) -> tuple[str, ...]:
        """Names of the SUs on a limb, from its reference to its end effector."""
        return tuple(self.su_names[u] for s in limb.segments for u in self.segments[s])

    def dofs_of(self, limb: Limb) -> tuple[str, ...]:
        """Names of the DoFs of a limb, from its reference to its end effector."""
        return tuple(self.dof_names[d] for n in limb.joints for d in self.joints[n])
