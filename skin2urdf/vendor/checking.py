"""check(): is a calibration still true? Every SU that moved, turned, died or was exchanged.

The joints are taken as they were found, and each SU's placement is estimated anew from whatever
motion a short log holds; the difference from where it was is held against what both say of
themselves, on all the directions that both know (:mod:`noticing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.calibration.clock import Clock, Progress, Tell
from skin2urdf.calibration.pipeline import recordings_of
from skin2urdf.calibration.result import GOOD_FIT, Source
from skin2urdf.calibration.rounds import sample_logs
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.errors import InsufficientDataError
from skin2urdf.faults import Fault, distinct
from skin2urdf.geometry.se3 import inverse, log
from skin2urdf.notes import Noted
from skin2urdf.recording.records import Recording
from skin2urdf.signals.trajectory import trajectory
from skin2urdf.vendor.explained import GROSS, Explained
from skin2urdf.vendor.fitting import REACH, Bench
from skin2urdf.vendor.known_skin import KnownSkin, KnownSu, load_skin
from skin2urdf.vendor.leftover import Leftover
from skin2urdf.vendor.matching import Chassis, match
from skin2urdf.vendor.noticing import Difference, differing
from skin2urdf.vendor.placing import Placed, placed_from, turned_up
from skin2urdf.vendor.records import Correction
from skin2urdf.vendor.refusing import another_robot
from skin2urdf.vendor.rigid import Fit

What = Literal["as it was", "moved", "elsewhere", "exchanged", "gone", "open", "does not fit"]
"""Of an SU: where it was; shifted or turned on its link; on another link; in the place of another
SU; without usable readings; not to be told from this log; fits on no link."""

FALSE_ALARM = 1e-4
"""Probability that an SU that did not move is told to, of all SUs of a robot together: one log in
ten thousand if errors were Gaussian, and less than one in 200 with tails as wide as they are."""
_FAR = 8.0
"""What an SU leaves, over the median SU, from which its place is looked for on all links."""
_NEAR = 0.02, 0.1
"""How near an SU is to the place of another to have taken it [m, rad]."""


@dataclass(frozen=True, eq=False)
class SuCheck(Record):
    """One SU, held against what was known of it.

    Attributes:
        name: the SU.
        what: what became of it.
        link: the link that it sits on.
        twist: (6,) from where it was to where it is, in its frame (linear [m], angular [rad]).
        covariance: (6, 6) of it, both estimates' together.
        off: that difference over its covariance, and how large a slip such a log tells.
        place_of: the SU whose place it has taken; empty where none.
        T_link_su: (4, 4) where it is on its link [m].
        covariance_new: (6, 6) of that.
        unobservable_new: (k, 6) what the log does not tell of it.
    """

    name: str
    what: What
    link: str
    twist: F64
    covariance: F64
    off: Difference
    place_of: str
    T_link_su: F64
    covariance_new: F64
    unobservable_new: F64

    @property
    def shift(self) -> tuple[float, float]:
        """How far it moved, and the standard deviation of that along the way [m]."""
        return _length(self.twist[:3], self.covariance[:3, :3])

    @property
    def turn(self) -> tuple[float, float]:
        """How far it turned, and the standard deviation of that about the axis [rad]."""
        return _length(self.twist[3:], self.covariance[3:, 3:])

    @property
    def changed(self) -> bool:
        """Whether it is not as it was."""
        return self.what not in ("as it was", "open")

    @property
    def told(self) -> bool:
        """Whether the log tells anything of where it is."""
        return self.what not in ("gone", "open")


def _length(x: F64, covariance: F64) -> tuple[float, float]:
    length = float(np.linalg.norm(x))
    along = x / length if length > 0 else np.eye(3)[0]
    return length, float(np.sqrt(max(along @ covariance @ along, 0.0)))


@dataclass(frozen=True, eq=False)
class Checked:
    """A calibration held against a log.

    Attributes:
        skin: the calibration.
        chassis: its joints, matched with the log's.
        sus: one entry for each of its SUs.
        explained: the fit of the SUs that have readings.
        left: what it leaves.
        new: SUs of the log that the calibration does not have.
        faults: what is wrong with the SUs' streams.
        sources: the logs.
        notes: what else was found, in words.
        seconds: time each stage took [s].
    """

    skin: KnownSkin
    chassis: Chassis
    sus: tuple[SuCheck, ...]
    explained: Explained
    left: Leftover
    new: tuple[str, ...]
    faults: tuple[Fault, ...]
    sources: tuple[Source, ...]
    notes: tuple[Noted, ...]
    seconds: dict[str, float]

    @property
    def true(self) -> bool:
        """Whether the calibration is still true of all its SUs."""
        return not any(su.changed for su in self.sus)

    @property
    def in_common(self) -> str:
        """The joint beyond which all SUs changed, and none before it; empty where there is none.

        Two SUs and more do not slip at once: the zero of that joint's encoder may have.
        """
        index = {joint.name: j for j, joint in enumerate(self.chassis.joints)}
        tree = self.chassis.tree((), ())
        at = {su.name: _segment(self.chassis, index, su) for su in self.skin.sus}
        told = [su for su in self.sus if su.told]
        changed = {su.name for su in told if su.changed}
        for name, j in reversed(index.items()):
            beyond = {su.name for su in told if j in tree.chain(at[su.name])}
            if len(beyond) > 1 and beyond == changed:
                return name
        return ""


def check(
    logs: str | Path | Recording | Sequence[str | Path | Recording],
    urdf: str | Path,
    settings: CalibrationSettings | None = None,
    *,
    progress: Progress | None = None,
) -> Checked:
    """Hold a calibration against a log of any motion.

    Args:
        logs: paths of logs, or recordings already read; half a minute does.
        urdf: the URDF that was calibrated, with its JSON beside it.
        settings: choices of the estimation.
        progress: told how far each stage is.

    Raises:
        UnreadableInputError: a log or the calibration can not be read.
        InsufficientDataError: the logs lack what it takes.
        ModelMismatchError: the robot in the log is another one, or no joint has the same name.
    """
    settings = settings or CalibrationSettings()
    clock = Clock(progress)
    skin = load_skin(urdf)
    recordings = clock.run("reading", lambda tell: recordings_of(logs, tell, settings.without))
    sampled = sample_logs(recordings, settings, clock)
    chassis = match(skin.description, sampled.sampled[0].motion.dof_names)
    usable = np.any([s.valid.any(axis=0) for s in sampled.sampled], axis=0)
    known = {su.name: su for su in skin.sus}
    heard = [u for u, name in enumerate(sampled.su_names) if usable[u] and name in known]
    if not heard:
        raise InsufficientDataError(
            f"no SU of {skin.description.text.source} has usable readings in the log",
            "record the topics of the SUs that were calibrated, under the names they had",
        )
    trajectories = [
        chassis.along(trajectory(s, g, REACH), np.array(heard))
        for g, s in enumerate(sampled.sampled)
    ]
    names = tuple(sampled.su_names[u] for u in heard)
    bench = Bench(chassis, trajectories, names, settings)
    before = [known[name] for name in names]
    found = clock.run("all samples", lambda tell: _fitted(bench, before, skin.up, tell))
    streams = [replace(f, log=g) for g, s in enumerate(sampled.sampled) for f in s.faults]
    sus = clock.run("tests", lambda _: _compared(found, before, skin))
    return Checked(
        skin=skin,
        chassis=chassis,
        sus=sus,
        explained=found,
        left=found.left,
        new=tuple(name for name in sampled.su_names if name not in known),
        faults=distinct(streams),
        sources=tuple(Source(r.source, r.digest, r.duration) for r in recordings),
        notes=tuple(dict.fromkeys(note for s in sampled.sampled for note in s.notes)),
        seconds=clock.seconds,
    )


def _fitted(bench: Bench, before: Sequence[KnownSu], up: F64, tell: Tell) -> Explained:
    """All samples, SUs beginning where they were; those that can not be there, wherever they fit.

    There are two fits at least, and a third where an SU is elsewhere.

    Raises:
        ModelMismatchError: most SUs fit nowhere.
    """
    chassis, sensors = bench.chassis, bench.settings.estimation.priors
    index = {joint.name: j for j, joint in enumerate(chassis.joints)}
    segments = np.array([_segment(chassis, index, su) for su in before])
    fits = []
    for su, joint in zip(before, segments, strict=True):
        T = np.array(su.T_link_su)
        if joint >= 0:
            T[:3] = chassis.R_link_joint[joint].T @ T[:3]
        fits.append(Fit(T[:3, :3], T[:3, 3], su.bias, su.shape, 0.0, np.zeros(0), 0.0))
    ups = np.tile(up, (len(bench.logs), 1))
    nothing = ((),) * len(fits)
    there = Placed(segments, tuple(fits), ups, nothing, np.zeros(len(fits)), nothing)
    there = replace(there, up=turned_up(chassis, bench.logs, there, sensors))
    found = _explained(bench, there, lambda share: tell(0.5 * share))
    odd = _odd(found)
    if odd.any():
        anywhere = placed_from(chassis, bench.logs, there.up, sensors)
        mixed = [
            (anywhere.su_joint[u], anywhere.fits[u]) if odd[u] else (segments[u], fits[u])
            for u in range(len(fits))
        ]
        again = replace(
            there,
            su_joint=np.array([joint for joint, _ in mixed]),
            fits=tuple(fit for _, fit in mixed),
        )
        found = _explained(bench, again, lambda share: tell(0.5 + 0.25 * share))
    if np.nanmedian(found.left.rms) > GROSS:
        raise another_robot(found)
    learnt = bench.learnt(found.along, sensors)
    begin = 0.75 if odd.any() else 0.5
    along = bench.fit(
        found.placed, found.blueprint, learnt, found.along.state, last=True,
        tell=lambda share: tell(begin + (1.0 - begin) * share),
    )  # fmt: skip
    return replace(found, along=along)


def _odd(found: Explained) -> Bool:
    """(U,) SUs whose readings are not explained, or far worse than those of the others."""
    each = found.left.ratio
    far = each > _FAR * max(float(np.nanmedian(each)), GOOD_FIT)
    return np.asarray(far | (found.left.rms > GROSS))


def _segment(chassis: Chassis, index: dict[str, int], su: KnownSu) -> int:
    """The joint before an SU among those that the log moves; what is beyond is fixed to it."""
    by_name = {joint.name: joint for joint in chassis.description.joints}
    carriers = {joint.child: joint for joint in chassis.description.joints}
    name = su.joint
    while name is not None and name not in index:
        above = carriers.get(by_name[name].parent)
        name = above.name if above else None
    return index[name] if name is not None else -1


def _explained(bench: Bench, placed: Placed, tell: Tell) -> Explained:
    sensors = bench.settings.estimation.priors
    blueprint = bench.blueprint(Correction(), placed.up[0])
    along = bench.fit(placed, blueprint, sensors, tell=tell)
    return Explained(bench, placed, blueprint, along, {}, {})


def _compared(found: Explained, before: Sequence[KnownSu], skin: KnownSkin) -> tuple[SuCheck, ...]:
    """The verdict on every SU of the calibration."""
    chassis, sensors = found.bench.chassis, found.bench.settings.estimation.priors
    seen = found.bench.judged(found.along, sensors)
    tree = found.along.problem.tree
    links = _links(chassis, skin)
    odd = _odd(found)
    out: dict[str, SuCheck] = {}
    for u, su in enumerate(before):
        joint = int(tree.su_joint[u])
        T = chassis.T_link_su(joint, found.along.state.T_joint_su[u])
        link = chassis.link(joint)
        both = su.covariance + seen.su_covariance[u]
        twist = log(inverse(su.T_link_su) @ T)
        level = FALSE_ALARM / len(before)
        off = differing(twist, both, level, su.unobservable, seen.su_unobservable[u])
        # A log of which neither shift nor turn could be told says nothing of the SU.
        silent = np.isnan(off.shift) and np.isnan(off.turn)
        what: What = "open" if off.dof == 0 or silent else "as it was"
        if link != links[su.name]:
            what, off = "elsewhere", off._replace(chi2=np.inf, dof=6, probability=0.0)
        elif off.probability < level:
            what = "moved"
        if odd[u]:
            what = "does not fit"
        place_of = _place_of(su, link, T, skin, links) if what in ("moved", "elsewhere") else ""
        if place_of:
            what = "exchanged"
        out[su.name] = SuCheck(
            su.name, what, link, twist, both, off, place_of, T,
            seen.su_covariance[u], seen.su_unobservable[u],
        )  # fmt: skip
    return tuple(out.get(su.name) or _gone(su, links[su.name]) for su in skin.sus)


def _links(chassis: Chassis, skin: KnownSkin) -> dict[str, str]:
    """The link, among those that the log moves, that each SU was on."""
    index = {joint.name: j for j, joint in enumerate(chassis.joints)}
    return {su.name: chassis.link(_segment(chassis, index, su)) for su in skin.sus}


def _gone(su: KnownSu, link: str) -> SuCheck:
    """An SU without usable readings."""
    nothing = np.zeros((6, 6))
    return SuCheck(
        su.name, "gone", link, np.zeros(6), nothing, Difference(np.inf, 0, 0.0, np.nan, np.nan), "",
        su.T_link_su, su.covariance, su.unobservable,
    )  # fmt: skip


def _place_of(su: KnownSu, link: str, T: F64, skin: KnownSkin, links: dict[str, str]) -> str:
    """The SU in whose place another one is now; empty where it is in none."""
    for other in skin.sus:
        if other.name == su.name or links[other.name] != link:
            continue
        off = log(inverse(other.T_link_su) @ T)
        if np.linalg.norm(off[:3]) < _NEAR[0] and np.linalg.norm(off[3:]) < _NEAR[1]:
            return other.name
    return ""
