"""Algorithm 1 of the paper, line by line: from an activity matrix to limbs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skin2urdf.arrays import Bool, Int
from skin2urdf.errors import StructureError, UsageError
from skin2urdf.paper.exploration import violations as say
from skin2urdf.paper.exploration.crossings import explain_crossings
from skin2urdf.paper.exploration.limbs import connection_sequences, end_effectors, limbs
from skin2urdf.paper.exploration.merging import merge_dofs, merge_sus
from skin2urdf.paper.exploration.records import (
    BREAKS_THE_TREE,
    Exploration,
    Group,
    Violation,
)
from skin2urdf.paper.exploration.sorting import (
    joint_segment_connectivity,
    reference_segment,
    sorted_order,
    triangular_form,
)


def explore(
    activity: Bool,
    su_names: Sequence[str],
    dof_names: Sequence[str],
    *,
    excited: Bool | None = None,
    heard: Bool | None = None,
) -> Exploration:
    """Run Algorithm 1 on an activity matrix, whatever robot or mistake it comes from.

    Args:
        activity: (U, D) activity matrix, 1 where an SU is moved by a DoF.
        su_names: U SU names.
        dof_names: D DoF names.
        excited: (D,) False for DoFs that never moved; all moved if not given.
        heard: (U,) False for SUs without readings, which are left out; all have some if not given.

    Returns:
        Every intermediate result, and the constraints of the paper that the matrix violates.

    Raises:
        UsageError: shapes and names do not fit together, or names repeat.
        StructureError: there is no SU with readings, or no DoF.
    """
    raw = np.asarray(activity, dtype=bool)
    listens = np.ones(len(su_names), dtype=bool) if heard is None else np.asarray(heard)
    moves = np.ones(len(dof_names), dtype=bool) if excited is None else np.asarray(excited)
    _check(raw, su_names, dof_names, listens, moves)

    # Lines 4 and 5: identical rows are segments, identical columns are joints.
    listening = [int(u) for u in np.flatnonzero(listens)]
    rows, by_segment = merge_sus(raw[listening])
    merged_sus = tuple(tuple(listening[u] for u in group) for group in rows)
    merged_dofs, merged = merge_dofs(by_segment)

    # II-B.3: the strictly lower triangular form, where it can be had.
    row_order, column_order = sorted_order(merged)
    form = triangular_form(merged[np.ix_(row_order, column_order)])
    carrying = [j for j in column_order if merged[:, j].any()]
    silent = tuple(d for j in column_order[len(carrying) :] for d in merged_dofs[j])
    weights = np.array([len(group) for group in merged_sus])
    crossings = explain_crossings(merged, weights)
    joints = tuple(merged_dofs[j] for j in carrying)
    triangular = merged[np.ix_(row_order, carrying)]
    segments = tuple(merged_sus[s] for s in row_order)
    sus = [[su_names[u] for u in group] for group in merged_sus]
    dofs = [[dof_names[d] for d in group] for group in merged_dofs]
    found = list(say.crossing_violations(crossings, sus, dofs))
    if reference_segment(merged) is None:
        always = [dof_names[int(d)] for d in np.flatnonzero(raw[listening].all(axis=0))]
        found.append(say.no_static_segment([su_names[u] for u in listening], always))

    # Lines 6 to 9: connectivity, reference segment, end effectors, limbs.
    connectivity: Int = np.empty((0, 2), dtype=np.int64)
    true: tuple[int, ...] = ()
    false: tuple[int, ...] = ()
    if not crossings:
        triangular, segments = _with_bare_segments(triangular, segments)
        connectivity = joint_segment_connectivity(triangular)
        true, false = end_effectors(connectivity)
        found += _bare_segments(segments, joints, connectivity, dof_names)
    found += say.dofs_without_reaction(dof_names, tuple(sorted(silent)), moves.tolist())
    if not listens.all():
        found.append(say.sus_without_readings([su_names[int(u)] for u in np.flatnonzero(~listens)]))
    return Exploration(
        su_names=tuple(su_names),
        dof_names=tuple(dof_names),
        raw=raw,
        merged_sus=merged_sus,
        merged_dofs=merged_dofs,
        merged=merged,
        form=form,
        segments=segments,
        joints=joints,
        triangular=triangular,
        sequences=connection_sequences(triangular),
        connectivity=connectivity,
        true_end_effectors=true,
        false_end_effectors=false,
        limbs=limbs(connectivity, 0, true, false),
        sub_limbs=tuple(limb for s in false for limb in limbs(connectivity, s, true, false)),
        violations=tuple(found),
    )


def require_tree(exploration: Exploration) -> Exploration:
    """Refuse an activity matrix that is none of a kinematic tree.

    Args:
        exploration: what `explore` found.

    Returns:
        The same exploration.

    Raises:
        StructureError: a closed loop, coupled DoFs, or a missed reaction.
    """
    for violation in exploration.violations:
        if violation.kind in BREAKS_THE_TREE:
            raise StructureError(violation.words, violation.remedy, violation.sus, violation.dofs)
    return exploration


def _check(
    raw: Bool, su_names: Sequence[str], dof_names: Sequence[str], heard: Bool, excited: Bool
) -> None:
    shape = (len(su_names), len(dof_names))
    if raw.shape != shape or heard.shape != shape[:1] or excited.shape != shape[1:]:
        raise UsageError(
            f"an activity matrix of shape {raw.shape} does not fit {shape[0]} SUs and {shape[1]} "
            f"DoFs (heard: {heard.shape}, excited: {excited.shape})",
            "give one row for each SU and one column for each DoF",
        )
    for what, names in (("SU", su_names), ("DoF", dof_names)):
        repeated = sorted({name for name in names if list(names).count(name) > 1})
        if repeated:
            raise UsageError(
                f"several {what}s are named {', '.join(repeated)}", f"give each {what} its own name"
            )
    if not heard.any() or not dof_names:
        raise StructureError(
            "there is nothing to explore: no SU with readings, or no DoF",
            "check the topics of the log",
        )


def _with_bare_segments(
    triangular: Bool, segments: tuple[Group, ...]
) -> tuple[Bool, tuple[Group, ...]]:
    """Insert rows for segments that must exist but carry no SU.

    Args:
        triangular: (S, N) sorted matrix whose columns nest, S <= N + 1.
        segments: SUs of each row.

    Returns:
        The (N + 1, N) matrix, and the SUs of each row; none for an inserted one.
    """
    n_joints = triangular.shape[1]
    sus = {tuple(row): group for row, group in zip(triangular.tolist(), segments, strict=True)}
    complete = np.zeros((n_joints + 1, n_joints), dtype=bool)
    for n in range(n_joints):
        beyond = triangular[:, n]
        # What moves everything beyond joint n lies on the way to it.
        complete[n + 1, : n + 1] = triangular[beyond, : n + 1].all(axis=0)
    return complete, tuple(sus.get(tuple(row), ()) for row in complete.tolist())


def _bare_segments(
    segments: tuple[Group, ...],
    joints: tuple[Group, ...],
    connectivity: Int,
    dof_names: Sequence[str],
) -> list[Violation]:
    """Violations for the segments without SU other than the RS."""
    found = []
    for joint, (_, segment) in enumerate(connectivity):
        if not segments[segment]:
            beyond = [
                [dof_names[d] for d in joints[n]]
                for n in np.flatnonzero(connectivity[:, 0] == segment)
            ]
            found.append(say.segment_without_su([dof_names[d] for d in joints[joint]], beyond))
    return found
