"""Images that wait while one is adapted: the oldest ones are skipped, and all are counted."""

from __future__ import annotations

from gibson_path_following.images.image_queue import ImageCounts, ImageQueue


def test_a_queue_of_one_holds_the_newest_image_and_counts_the_skipped_ones() -> None:
    queue: ImageQueue[int] = ImageQueue(1)
    for image in (1, 2, 3):
        queue.add(image)
    assert (queue.pop(), queue.pop()) == (3, None)
    queue.note_result(usable=True)
    assert queue.counts == ImageCounts(received=3, adapted=1, skipped=2)


def test_a_longer_queue_returns_images_in_their_order_and_skips_the_oldest() -> None:
    queue: ImageQueue[int] = ImageQueue(2)
    for image in (1, 2, 3):
        queue.add(image)
    assert (queue.waiting, queue.pop(), queue.pop(), queue.waiting) == (2, 2, 3, 0)
    assert queue.counts.skipped == 1


def test_counts_are_those_since_the_last_line() -> None:
    queue: ImageQueue[int] = ImageQueue(1)
    queue.add(1)
    before = queue.counts
    queue.note_result(usable=False)
    queue.add(2)
    assert str(queue.counts.since(before)) == "1 received, 0 adapted, 1 skipped, 1 unusable"


def test_images_without_a_result_are_skipped_at_the_end() -> None:
    queue: ImageQueue[int] = ImageQueue(5)
    for image in (1, 2, 3):
        queue.add(image)
    queue.pop()
    queue.note_result(usable=True)
    queue.pop()  # interrupted while it is adapted
    for _ in range(2):
        queue.close()
        assert queue.counts == ImageCounts(received=3, adapted=1, skipped=2)
