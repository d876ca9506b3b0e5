"""Work that is shared among threads."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from skin2urdf.threads import MANY, do_each, each


@pytest.mark.parametrize("n_sus", [1, MANY])
def test_what_is_made_keeps_its_order(n_sus: int) -> None:
    assert list(each(lambda x: x * x, range(50), n_sus)) == [x * x for x in range(50)]


def test_things_of_few_sus_are_done_where_they_are_asked_for() -> None:
    found: set[int] = set()
    do_each(lambda _: found.add(threading.get_ident()), range(5), MANY - 1)
    assert found == {threading.get_ident()}


def test_few_things_are_asked_for_ahead() -> None:
    asked: list[int] = []

    def things() -> Iterator[int]:
        for x in range(100):
            asked.append(x)
            yield x

    made = each(str, things(), MANY)
    assert next(made) == "0"
    assert len(asked) < 20
    assert list(made)[-1] == "99"


def test_what_fails_is_told() -> None:
    def fail(x: int) -> None:
        if x == 3:
            raise ValueError("three")

    with pytest.raises(ValueError, match="three"):
        do_each(fail, range(10), MANY)
