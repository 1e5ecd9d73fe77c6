"""Writes to a bag in a separate thread, which also encodes images while the next ones are rendered."""

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

MAX_QUEUED = 4
"""Maximum number of calls of ``put`` in the queue: a few frames, and the messages recorded between them."""


@dataclass(frozen=True, slots=True, eq=False)
class RawItem:
    """One serialized message."""

    topic: str
    data: bytes
    log_ns: int
    """Time in the bag, ns."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameItem:
    """A frame of one camera, which is converted to messages when it is written."""

    messages: CameraMessages
    topics: dict[str, str]
    """Kind of message -> topic."""
    frame: Frame
    T_target_camera: Mat4 | None
    log_ns: int
    """Time in the bag, ns."""


Item = RawItem | FrameItem


class BagQueue:
    """Writes items in the order of ``put``. A context manager, whose exit waits until all items are written.

    Args:
        bag: bag with all topics declared; only the queue may write to it meanwhile.
    """

    def __init__(self, bag: BagWriter) -> None:
        self._bag = bag
        self._items: Queue[Sequence[Item] | None] = Queue(MAX_QUEUED)
        self._error: GibsonSimError | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="bag-writer", daemon=True)
        self._thread.start()

    def put(self, items: Sequence[Item]) -> None:
        """Appends items, which must not change afterwards; blocks while the queue is full.

        Raises:
            RecordError: an earlier item could not be written.
        """
        self._items.put(items)
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        while (items := self._items.get()) is not None:
            if self._error is not None:
                continue  # ``put`` must not block forever
            try:
                for item in items:
                    self._write(item)
            except GibsonSimError as error:
                self._error = error

    def _write(self, item: Item) -> None:
        if isinstance(item, RawItem):
            self._bag.write(item.topic, item.data, item.log_ns, item.log_ns)
            return
        kinds, stamp_ns = frozenset(item.topics), item.frame.stamp_ns
        for kind, message in item.messages.infos(stamp_ns, kinds, exact_bytes):
            self._bag.write(item.topics[kind], message, item.log_ns, item.log_ns)
        for kind, message in item.messages.images(item.frame, kinds, item.T_target_camera, image_to_bytes):
            self._bag.write(item.topics[kind], message, item.log_ns, item.log_ns)

    def close(self) -> None:
        """Waits until all items are written, and raises the first error; a second call does nothing."""
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
