"""Writes to a bag in a thread of its own: pictures become messages and bytes there, while the next ones are drawn."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from queue import Queue
from types import TracebackType

from gibson_sim.bags.writer import BagWriter
from gibson_sim.errors import GibsonSimError
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.ros.topics.camera_messages import CameraMessages
from gibson_sim.ros.wire.exact_bytes import exact_bytes
from gibson_sim.ros.wire.fast_publish import image_to_bytes
from gibson_sim.types import Frame

MOST_WAITING = 4
"""So many calls of ``put`` wait: a few pictures and what was recorded between them."""


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """One message as bytes."""

    topic: str
    data: bytes
    log_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What one camera saw, to become messages."""

    messages: CameraMessages
    topics: dict[str, str]
    """Kind of message -> topic."""
    frame: Frame
    T_target_camera: Mat4 | None
    log_ns: int


Item = Raw | Picture


class BagQueue:
    """Items are written in the order in which they come. Use it as a context manager: its end waits until all are written.

    Args:
        bag: topics are declared; nobody else writes until the end.
    """

    def __init__(self, bag: BagWriter) -> None:
        self._bag = bag
        self._items: Queue[Sequence[Item] | None] = Queue(MOST_WAITING)
        self._error: GibsonSimError | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="bag-writer", daemon=True)
        self._thread.start()

    def put(self, items: Sequence[Item]) -> None:
        """Takes items, which must stay as they are; waits while too many are not written yet.

        Raises:
            RecordError: what came before could not be written.
        """
        self._items.put(items)
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while (items := self._items.get()) is not None:
            if self._error is not None:
                continue  # whoever puts must not wait for ever
            try:
                for item in items:
                    self._write(item)
            except GibsonSimError as error:
                self._error = error

    def _write(self, item: Item) -> None:
        if isinstance(item, Raw):
            self._bag.write(item.topic, item.data, item.log_ns, item.log_ns)
            return
        wanted, stamp_ns = frozenset(item.topics), item.frame.stamp_ns
        for kind, message in item.messages.infos(stamp_ns, wanted, exact_bytes):
            self._bag.write(item.topics[kind], message, item.log_ns, item.log_ns)
        for kind, message in item.messages.images(item.frame, wanted, item.T_target_camera, image_to_bytes):
            self._bag.write(item.topics[kind], message, item.log_ns, item.log_ns)

    def close(self) -> None:
        """Waits until everything is written; a second call does nothing. Raises what went wrong."""
        if not self._ended:
            self._ended = True
            self._items.put(None)
            self._thread.join()
            if self._error is not None:
                raise self._error

    def __enter__(self) -> BagQueue:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
            return
        self._ended = True
        self._items.put(None)
        self._thread.join()
