"""The paper's table in this process: who has turns when."""

from __future__ import annotations

from gibson_sim_bench.protocol import BLOCK
from gibson_sim_bench.table1 import in_turns


def test_frames_their_parts_and_another_way_have_turns() -> None:
    done: list[str] = []

    def other(count: int) -> list[float]:
        done.append(f"other {count}")
        return [0.5] * count

    times, others = in_turns(lambda: done.append("whole"), lambda: done.append("apart"), BLOCK + 2, 3, other)
    assert (len(times), others) == (BLOCK + 2, [0.5] * (BLOCK + 2))
    before, *blocks = " ".join(done).replace("other 3", "|").split(f"other {BLOCK}")
    assert before.startswith("whole whole whole | apart")
    assert (before.count("whole"), blocks[0].count("whole")) == (3 + 1 + BLOCK, 1 + 2)
    assert done[-1] == "other 2"


def test_without_another_way_there_are_frames_alone() -> None:
    times, others = in_turns(lambda: None, lambda: None, 2, 1)
    assert (len(times), others) == (2, [])
