"""The paper's table in this process: the order of interleaved measurements."""

from __future__ import annotations

from gibson_sim_bench.protocol import BLOCK
from gibson_sim_bench.table1 import measure_interleaved


def test_frames_staged_frames_and_another_configuration_are_interleaved() -> None:
    done: list[str] = []

    def other(count: int) -> list[float]:
        done.append(f"other {count}")
        return [0.5] * count

    times, others = measure_interleaved(lambda: done.append("whole"), lambda: done.append("apart"), BLOCK + 2, 3, other)
    assert (len(times), others) == (BLOCK + 2, [0.5] * (BLOCK + 2))
    before, *blocks = " ".join(done).replace("other 3", "|").split(f"other {BLOCK}")
    assert before.startswith("whole whole whole | apart")
    assert (before.count("whole"), blocks[0].count("whole")) == (3 + 1 + BLOCK, 1 + 2)
    assert done[-1] == "other 2"


def test_without_another_configuration_there_are_frames_alone() -> None:
    times, others = measure_interleaved(lambda: None, lambda: None, 2, 1)
    assert (len(times), others) == (2, [])
