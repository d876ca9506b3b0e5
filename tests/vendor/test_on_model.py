"""SUs on a given model: found, written into its text, and models that are not the robot."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vendor.model_robot import URDF, Recorded, model, recorded, with_zero

from skin2urdf.arrays import F64, Bool
from skin2urdf.cli.main import main
from skin2urdf.errors import ModelMismatchError, UnreadableInputError
from skin2urdf.geometry.se3 import exp, inverse, log
from skin2urdf.output import save_on_model
from skin2urdf.page.advice import advice
from skin2urdf.page.contents import load_contents
from skin2urdf.recording.description import robot_descriptions
from skin2urdf.recording.records import Recording
from skin2urdf.recording.writing import write
from skin2urdf.report.model_document import as_document
from skin2urdf.report.on_model import as_text
from skin2urdf.signals.motion import joint_motion
from skin2urdf.signals.poses import find_rests
from skin2urdf.signals.records import SuClock
from skin2urdf.simulation.robots import GivenSu, SkinLayout
from skin2urdf.urdf.compare import compare
from skin2urdf.urdf.loading import Robot, configuration
from skin2urdf.vendor.calibrate import calibrate_with_model
from skin2urdf.vendor.description import describe
from skin2urdf.vendor.editing import with_additions
from skin2urdf.vendor.matching import match
from skin2urdf.vendor.output import model_urdf
from skin2urdf.vendor.placing import Placed, place_sus
from skin2urdf.vendor.records import Correction, ModelCalibration
from skin2urdf.vendor.source import read_model

REVERSED = URDF.replace('<axis xyz="0 1 0"/><limit low', '<axis xyz="0 -1 0"/><limit low', 1)


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(tmp_path_factory.mktemp("toy"))


Calibrate = Callable[[str, Correction], ModelCalibration]


@pytest.fixture(scope="module")
def calibrated(toy: Recorded) -> Calibrate:
    """Calibrations on a text, each done once."""

    @cache
    def calibrated(text: str, correction: Correction) -> ModelCalibration:
        return calibrate_with_model(toy.recording, model(text), correction=correction)

    return calibrated


def test_sus_are_found_on_the_vendors_links_as_well_as_stated(
    toy: Recorded, calibrated: Calibrate
) -> None:
    found = calibrated(URDF, Correction())
    assert found.quality == "good"
    assert dict(zip(found.tree.su_names, found.links, strict=True)) == {
        name: toy.link[name] for name in found.tree.su_names
    }
    for u, name in enumerate(found.tree.su_names):
        if found.observability.su_verdict[u] != "determined":
            continue
        off = log(inverse(toy.T_link_su[name]) @ found.T_link_su[u])
        assert off @ np.linalg.solve(found.observability.su_covariance[u], off) < 25
        assert np.linalg.norm(off[:3]) < 1e-3
    # The one that the first joint alone turns has its place along that axis open.
    assert "not observable" in found.observability.su_verdict


def test_the_vendors_text_stays_byte_for_byte_around_what_is_added(calibrated: Calibrate) -> None:
    found = calibrated(URDF, Correction())
    written = model_urdf(found)
    end = URDF.rindex("</robot>")
    assert written.startswith(URDF[:end])
    assert written.endswith(URDF[end:])
    assert "\n" not in written.replace("\r\n", "")
    read = describe(model(written))
    assert {joint.child for joint in read.joints} >= set(found.tree.su_names)


def test_the_document_and_the_text_tell_whose_the_kinematics_are(calibrated: Calibrate) -> None:
    found = calibrated(URDF, Correction())
    document = as_document(found)
    assert document["model"]["kept"] is True
    assert document["model"]["sha256"] == "0" * 64
    assert document["sus"].keys() == set(found.tree.su_names)
    assert json.dumps(document, allow_nan=False)
    assert "toy.urdf" in as_text(found).splitlines()[1]


def test_a_specimens_zero_is_allowed_for_and_corrected_where_asked(calibrated: Calibrate) -> None:
    text = with_zero("lift", 0.004)
    kept = calibrated(text, Correction())
    assert kept.quality == "fair"
    assert kept.deviates
    assert model_urdf(kept).startswith(text[: text.rindex("</robot>")])
    corrected = calibrated(text, Correction("zeros"))
    lift = corrected.tree.joint_names.index("lift")
    assert corrected.corrections[lift, 5] == pytest.approx(-0.004, abs=1e-4)
    assert list(np.flatnonzero(corrected.significant.any(axis=1))) == [lift]
    (joint,) = (j for j in describe(model(model_urdf(corrected))).joints if j.name == "lift")
    assert np.abs(joint.T_parent_origin[:3, :3] - np.eye(3)).max() < 1e-3
    # All but the numbers of origins, and the SUs, is as it was.
    plain = re.compile(r"""(?:xyz|rpy)=["'][^"']*["']""")
    end = text.rindex("</robot>")
    as_was = plain.sub("", text[:end])
    bare = plain.sub("", model_urdf(corrected))
    assert bare.replace("<origin  />", "<origin />").startswith(as_was[: as_was.index("<joint")])
    assert bare.count("<!--") == 2
    assert bare.count("\r\n") == text.count("\r\n") + 6 * corrected.tree.n_sus


def test_a_zero_far_off_is_named_and_found_where_asked(calibrated: Calibrate) -> None:
    text = with_zero("lift", 0.1)
    with pytest.raises(ModelMismatchError) as error:
        calibrated(text, Correction())
    assert error.value.joints == ("lift",)
    assert error.value.remedy
    assert error.value.exit_status == 1


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return recorded(tmp_path_factory.mktemp("short"), minutes=0.25)


def elsewhere(joint: str, xi: list[float]) -> str:
    """The vendor's file with a joint moved by a twist."""
    chassis = match(describe(model()), ["turn", "lift", "roll"])
    j = [each.name for each in chassis.joints].index(joint)
    T = np.array(chassis.T_parent_joint)
    T[j] = T[j] @ exp(np.array(xi))
    return with_additions(URDF, "toy.urdf", [], {joint: chassis.origins(T)[j]})


def test_a_joint_of_the_other_sense_is_named(calibrated: Calibrate) -> None:
    with pytest.raises(ModelMismatchError) as error:
        calibrated(REVERSED, Correction())
    assert error.value.joints == ("lift",)


@pytest.mark.parametrize(
    ("joint", "axis", "seed", "roll"),
    [
        # A half turn of the joint beyond takes most of what is left.
        ("turn", "0 0 1", 11, 0.02),
        # The mount that goes with the wrong sense is upright.
        ("roll", "2 0 1", 20, np.pi),
    ],
)
def test_a_sense_is_named_that_rough_fits_hardly_see(
    joint: str, axis: str, seed: int, roll: float, tmp_path: Path
) -> None:
    robot = recorded(tmp_path, minutes=0.25, seed=seed, base_rpy=(roll, 0.0, 0.0))
    other = " ".join(str(-int(word)) for word in axis.split())
    text = URDF.replace(f'<axis xyz="{axis}"/>', f'<axis xyz="{other}"/>')
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(robot.recording, model(text))
    assert error.value.joints == (joint,)
    assert error.value.remedy


def test_a_sense_is_named_before_a_half_turn_of_an_axis_beyond(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    # Where the axes on both sides of a joint meet in it and are parallel, both are the same.
    text = URDF.replace('xyz="0.02 0 0.2"', 'xyz="0 0 0.2"').replace('"2 0 1"', '"0 0 1"')
    text = text.replace('xyz="0.3 0.01 0" rpy="0.2 0 0"', 'xyz="0 0 0.3"')
    text = text.replace('"prismatic"', '"revolute"').replace('upper="0.04"', 'upper="1.5"')
    text = text.replace('velocity="0.1"', 'velocity="3"')
    wrist = recorded(
        tmp_path_factory.mktemp("wrist"), text=text, minutes=0.25, base_rpy=(0.0, 0.0, 0.0)
    )
    reversed_ = text.replace('<axis xyz="0 1 0"/><limit low', '<axis xyz="0 -1 0"/><limit low', 1)
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(wrist.recording, model(reversed_))
    assert error.value.joints == ("lift",)
    assert "roll" in str(error.value)


def test_the_mirror_image_of_a_leg_is_no_robot_with_mirrored_sensors(tmp_path: Path) -> None:
    # About the plane of the parallel axes, the other sense of the first joint mirrors all motion.
    text = URDF.replace('xyz="0 0 1"/><limit', 'xyz="1 0 0"/><limit').replace('"2 0 1"', '"0 1 0"')
    text = text.replace('rpy="0.2 0 0"', 'rpy="0 0 0"')
    leg = recorded(tmp_path, text=text, minutes=0.25, base_rpy=(0.0, 0.0, 0.0))
    other = text.replace('xyz="1 0 0"/><limit', 'xyz="-1 0 0"/><limit')
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(leg.recording, model(other))
    assert error.value.joints == ("turn",)


def test_an_su_with_an_axis_the_other_way_round_is_left_out(short: Recorded) -> None:
    three = next(su.name for su in short.recording.sus if short.link[su.name] == "three")
    sus = [
        replace(su, specific_force=su.specific_force * (-1.0, 1.0, 1.0)) if su.name == three else su
        for su in short.recording.sus
    ]
    found = calibrate_with_model(replace(short.recording, sus=tuple(sus), digest=""), model())
    assert found.odd.keys() == {three}
    assert not found.deviates
    assert found.to_repair


def test_a_small_tilt_of_an_axis_is_no_base_that_gives_way(calibrated: Calibrate) -> None:
    with pytest.raises(ModelMismatchError) as error:
        calibrated(elsewhere("lift", [0.003, 0.002, 0.0, 0.008, 0.008, 0.0]), Correction())
    assert error.value.joints == ("lift",)


def test_a_zero_that_parallel_axes_share_is_named(tmp_path: Path) -> None:
    text = URDF.replace('"2 0 1"', '"0 1 0"').replace('rpy="0.2 0 0"', 'rpy="0 0 0"')
    arm = recorded(tmp_path, text=text, minutes=0.25)
    off = text.replace('<origin xyz="0.02 0 0.2"/>', '<origin xyz="0.02 0 0.2" rpy="0 0.03 0"/>')
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(arm.recording, model(off))
    assert error.value.joints == ("lift",)


def test_a_model_without_a_joint_of_that_name_is_refused(calibrated: Calibrate) -> None:
    text = URDF.replace('"lift"', '"a"').replace('"turn"', '"b"').replace('"roll"', '"c"')
    with pytest.raises(ModelMismatchError) as error:
        calibrated(text, Correction())
    assert error.value.joints == ("b", "a", "c", "grip")


def test_joints_follow_what_they_mimic_and_the_rest_is_named() -> None:
    mimic = '<mimic joint="lift" multiplier="-2" offset="0.3"/>'
    text = URDF.replace('<axis xyz="2 0 1"/>', f'<axis xyz="2 0 1"/>{mimic}')
    found = match(describe(model(text)), ["grasp", "lift", "turn"])
    assert [joint.name for joint in found.joints] == ["turn", "lift", "roll"]
    assert list(found.measured) == [2, 1, 1]
    assert list(found.factor) == [1.0, 1.0, -2.0]
    assert found.extra == ("grasp",)
    assert found.absent == {"grip": 0.0}
    all_ = match(describe(model(URDF)), ["turn", "lift", "roll", "grip"])
    # The placements are those of the URDF, whatever turns the axes to z.
    given = [joint.T_parent_origin for joint in all_.joints]
    assert np.abs(all_.origins(all_.T_parent_joint) - given).max() < 1e-12


def test_the_command_writes_the_file_and_reads_the_description_in_a_bag(
    toy: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log_file, vendor = tmp_path / "log.mcap", tmp_path / "toy.urdf"
    write(toy.recording, log_file)
    vendor.write_bytes(URDF.encode())
    out = tmp_path / "with_skin.urdf"
    page = tmp_path / "page.html"
    command = ["calibrate", str(log_file), "--model", str(vendor), "-o", str(out), "--quiet"]
    assert main([*command, "--report", str(page)]) == 0
    _has_a_page_of_the_model(page.read_text(), out)
    assert out.read_bytes().startswith(URDF[: URDF.rindex("</robot>")].encode())
    assert json.loads(out.with_suffix(".json").read_text())["model"]["kind"] == "urdf"
    assert robot_descriptions(log_file) == {}
    assert main(["calibrate", str(log_file), "--model", "bag", "-o", str(out)]) == 2
    assert "robot_description" in capsys.readouterr().err
    assert main(["calibrate", str(log_file), "--correct", "zeros", "-o", str(out)]) == 2


def _has_a_page_of_the_model(page: str, urdf: Path) -> None:
    """What was kept is told as kept, readings are shown, and SUs stand where the URDF has them."""
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page)
    shown = json.loads(data)
    document = json.loads(urdf.with_suffix(".json").read_text())
    assert {trace["su"] for trace in shown["traces"]} == document["sus"].keys()
    assert shown["figures"].keys() == {"robot", "activity", "by_su"}
    assert page.count('<td class="words ">kept</td>') == len(document["model"]["joints"])
    contents = load_contents(urdf)
    frames = contents.frames()
    placed = forward(contents.robot, contents.positions)
    assert not contents.limbs
    for name in document["sus"]:
        assert np.abs(frames[name] - placed[name]).max() < 1e-9


def forward(robot: Robot, positions: Mapping[str, float]) -> dict[str, F64]:
    """(4, 4) frames of all links that a URDF has, by name."""
    import pinocchio as pin

    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, configuration(robot, positions))
    return {
        frame.name: np.array(data.oMf[i].homogeneous)
        for i, frame in enumerate(robot.model.frames)
        if frame.type == pin.FrameType.BODY
    }


def test_of_one_su_alone_what_its_sensor_hides_asks_for_its_data_sheet(
    toy: Recorded, tmp_path: Path
) -> None:
    tip = next(su for su in toy.recording.sus if toy.link[su.name] == "three")
    found = calibrate_with_model(replace(toy.recording, sus=(tip,)), model())
    # Its stated deviation holds what its sensor hides, and no motion helps with that.
    assert found.quality == "good"
    (urdf, _) = save_on_model(found, tmp_path / "tip.urdf")
    remedies = [each.remedy for each in advice(load_contents(urdf).document)]
    assert len(remedies) == 1
    assert "--cross" in remedies[0]


def test_a_clock_that_is_off_is_told_in_the_document_as_well(calibrated: Calibrate) -> None:
    found = calibrated(URDF, Correction())
    name = found.tree.su_names[0]
    late = replace(found, clocks=((SuClock(name, 0.084, 1e-4, 0.0, 1e-6, 15.0),),))
    told = as_document(late)["notes"]
    assert any(name in note and "84" in note for note in told)
    assert all(note in as_text(late) for note in told)


def test_rests_at_both_ends_of_a_log_are_no_gaps(toy: Recorded) -> None:
    motion = joint_motion(toy.recording)
    time = motion.grid.time
    first, _, last = find_rests(motion)[:3]
    # Nothing is compared at the ends: filters reach beyond them.
    recording = between(toy.recording, time[first.end] - 0.4, time[last.begin] + 0.4)
    assert len(find_rests(joint_motion(recording))) == 3
    found = calibrate_with_model(recording, model())
    assert found.links == tuple(toy.link[name] for name in found.tree.su_names)


def test_an_su_on_a_tilted_base_is_told_from_a_dead_one_on_a_link(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    tilted = recorded(
        tmp_path_factory.mktemp("tilted"), sus_on_base=1, base_rpy=(0.25, 0.0, 0.0), grade="bma150"
    )
    found = calibrate_with_model(tilted.recording, model())
    assert found.links == tuple(tilted.link[name] for name in found.tree.su_names)
    assert not any(found.instead)


def test_all_samples_decide_where_a_rough_look_left_two_links(
    toy: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    def undecided(*arguments: Any) -> Placed:
        placed = place_sus(*arguments)
        first = list(placed.su_joint).index(0)
        instead = [(0,) if u == first else () for u in range(len(placed.su_joint))]
        on_base = np.where(placed.su_joint == 0, -1, placed.su_joint)
        return replace(placed, su_joint=on_base, instead=tuple(instead))

    monkeypatch.setattr("skin2urdf.vendor.calibrate.place_sus", undecided)
    found = calibrate_with_model(toy.recording, model())
    assert found.links == tuple(toy.link[name] for name in found.tree.su_names)
    assert not found.deviates


def test_an_su_beside_a_vertical_axis_is_not_on_the_base(tmp_path: Path) -> None:
    beside = (
        GivenSu("one", (0.005, 0.0, 0.1), (0.3, 0.2, 0.1)),
        GivenSu("two", (0.1, 0.0, 0.05), (0.0, 0.0, 0.0)),
    )
    robot = recorded(tmp_path, skin=SkinLayout(0, 0, given=beside), base_rpy=(0.0, 0.0, 0.0))
    found = calibrate_with_model(robot.recording, model())
    of = dict(zip(found.tree.su_names, found.links, strict=True))
    assert of == {name: robot.link[name] for name in of}


def test_a_log_without_a_rest_does_and_what_it_leaves_open_is_named(toy: Recorded) -> None:
    recording = between(toy.recording, 21.35, 27.35)
    assert not find_rests(joint_motion(recording))
    found = calibrate_with_model(recording, model())
    assert dict(zip(found.tree.su_names, found.links, strict=True)) == {
        name: toy.link[name] for name in found.tree.su_names
    }
    assert set(found.observability.su_verdict) == {"not observable"}
    assert found.quality == "fair"


def test_short_runs_with_longer_pauses_are_compared_where_they_move(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    long = recorded(tmp_path_factory.mktemp("long"), minutes=2.0)
    runs = part(long.recording, lambda time: np.mod(time, 10.0) < 4.5)
    found = calibrate_with_model(runs, model())
    assert found.links == tuple(long.link[name] for name in found.tree.su_names)
    assert found.quality == "good"


def between(recording: Recording, begin: float, end: float) -> Recording:
    """What was recorded between two times [s]."""
    return part(recording, lambda time: (time >= begin) & (time <= end))


def part(recording: Recording, of: Callable[[F64], Bool]) -> Recording:
    """What was recorded at some of the times (N,) [s]."""
    joints = [
        replace(x, time=x.time[of(x.time)], position=x.position[of(x.time)])
        for x in recording.joints
    ]
    sus = [
        replace(x, time=x.time[of(x.time)], specific_force=x.specific_force[of(x.time)])
        for x in recording.sus
    ]
    return replace(recording, joints=tuple(joints), sus=tuple(sus))


def test_a_description_in_a_bag_is_read(tmp_path: Path) -> None:
    import struct

    from mcap.writer import Writer

    path = tmp_path / "log.mcap"
    text = URDF.encode()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/robot_description", "cdr", schema)
        data = b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    found = read_model("bag", [path])
    assert found.text == URDF
    assert found.kind == "bag"


def test_xacro_without_its_packages_says_how_to_get_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "xacrodoc", None)
    monkeypatch.setitem(__import__("sys").modules, "xacro", None)
    path = tmp_path / "robot.urdf.xacro"
    path.write_text(URDF)
    with pytest.raises(UnreadableInputError) as error:
        read_model(path)
    assert "xacrodoc" in error.value.remedy
    assert error.value.exit_status == 2
    with pytest.raises(UnreadableInputError):
        describe(model("<robot"))


def test_the_noise_of_sensors_is_told_as_densities(calibrated: Calibrate) -> None:
    document = as_document(calibrated(URDF, Correction()))
    for su in document["sus"].values():
        # 1 mg at 500 Hz is what the simulated sensors have.
        assert su["noise_density"] == pytest.approx([9.81e-3 / 500**0.5] * 3, rel=0.25)
        assert su["topic"]


@pytest.mark.parametrize(
    ("joint", "xi"),
    [
        ("lift", [0.04, 0.0, 0.0, 0.1, 0.0, 0.0]),
        # The zero of the joint before, and smaller shifts of both, would explain it nearly as well.
        ("roll", [0.042, -0.026, 0.0, -0.093, -0.074, 0.0]),
        # That zero takes most of what is left, and leaves a hundred times noise.
        ("roll", [-0.05, 0.0, 0.0, -0.03, 0.16, 0.0]),
    ],
)
def test_a_joint_that_sits_elsewhere_is_named(
    joint: str, xi: list[float], calibrated: Calibrate
) -> None:
    with pytest.raises(ModelMismatchError) as error:
        calibrated(elsewhere(joint, xi), Correction())
    assert error.value.joints == (joint,)
    assert error.value.remedy


def renamed(recording: Recording, joint: str) -> Recording:
    """The recording with one of its joints called head."""
    joints = [replace(x, name="head") if x.name == joint else x for x in recording.joints]
    return replace(recording, joints=tuple(joints))


def test_joints_that_log_or_model_lack_are_told_and_what_they_move_is_named(
    short: Recorded,
) -> None:
    found = calibrate_with_model(renamed(short.recording, "roll"), model())
    told = as_document(found)["model"]
    assert told["joints_the_log_lacks"].keys() == {"roll", "grip"}
    assert list(told["joints_the_model_lacks"]) == ["head"]
    assert {short.link[name] for name in found.odd} == {"three"}
    assert found.to_repair


def test_where_nothing_fits_joints_of_other_names_are_named(short: Recorded) -> None:
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(renamed(short.recording, "turn"), model())
    assert {"head", "turn"} <= set(re.findall(r"\w+", error.value.remedy))


def test_another_robot_is_named(short: Recorded) -> None:
    chassis = match(describe(model()), ["turn", "lift", "roll"])
    rng = np.random.default_rng(1)
    far = np.concatenate([rng.normal(0, 0.1, (3, 3)), rng.normal(0, 1.0, (3, 3))], axis=1)
    new = chassis.origins(chassis.T_parent_joint @ exp(far))
    origins = {joint.name: T for joint, T in zip(chassis.joints, new, strict=True)}
    other = with_additions(URDF, "toy.urdf", [], origins)
    with pytest.raises(ModelMismatchError) as error:
        calibrate_with_model(short.recording, model(other))
    assert error.value.joints == ("turn", "lift", "roll")
    assert error.value.remedy


def test_links_of_the_vendor_are_no_sus_when_compared(short: Recorded, tmp_path: Path) -> None:
    tool = '<link name="tool"/><joint name="to_tool" type="fixed"><parent link="three"/>'
    text = URDF.replace(
        '<joint name="turn"', f'{tool}<child link="tool"/></joint><joint name="turn"'
    )
    vendor = tmp_path / "vendor.urdf"
    vendor.write_bytes(text.encode())
    found = calibrate_with_model(short.recording, vendor)
    (urdf, _) = save_on_model(found, tmp_path / "with_skin.urdf")
    compared = compare(urdf, vendor, rng=np.random.default_rng(0))
    assert {su.name for su in compared.sus} | {*compared.not_observable} == {*found.tree.su_names}
    assert compared.position.rms < 1e-6


def test_a_mount_that_was_turned_is_told(
    calibrated: Calibrate, tmp_path_factory: pytest.TempPathFactory
) -> None:
    upright = calibrated(URDF, Correction())
    assert as_document(upright)["model"]["mount"]["turned"] is False
    hung = recorded(tmp_path_factory.mktemp("hung"), minutes=0.25, base_rpy=(np.pi, 0.0, 0.0))
    found = calibrate_with_model(hung.recording, model())
    assert as_document(found)["model"]["mount"]["turned"] is True
    assert found.quality == "good"
    assert np.rad2deg(found.tilt) == pytest.approx(180.0, abs=0.5)
