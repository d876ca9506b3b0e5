from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skin2urdf.recording.naming import su_names


def test_frames_name_sus_where_they_are_unique() -> None:
    sources = [("/imu", "a"), ("/skin", "b"), ("/skin", "c")]
    assert su_names(sources) == ["a", "b", "c"]


def test_topics_name_sus_whose_frames_are_shared_or_empty() -> None:
    sources = [
        ("/arm/imu", "imu_link"),
        ("/hand/imu", "imu_link"),
        ("/foot/imu", ""),
        ("/skin", "x"),
        ("/skin", "imu_link"),
        ("/tool", "/leading_slash"),
    ]
    assert su_names(sources) == [
        "arm_imu",
        "hand_imu",
        "foot_imu",
        "x",
        "skin_imu_link",
        "leading_slash",
    ]


def test_a_topic_that_reads_like_a_frame_is_numbered() -> None:
    assert su_names([("/a", "b"), ("/b", "")]) == ["b", "b_2"]


words = st.text(alphabet="ab/_2", max_size=4)


@given(st.lists(st.tuples(words, words), max_size=8, unique=True))
def test_names_are_unique_and_never_empty(sources: list[tuple[str, str]]) -> None:
    names = su_names(sources)
    assert len(set(names)) == len(sources)
    assert all(names)
