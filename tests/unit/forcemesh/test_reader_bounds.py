"""A reader's memory of writers is bounded, however many there were."""

from tests.fakes.line import Line

MOST_RETIRED = 64


def test_the_memory_of_former_writers_is_bounded() -> None:
    """A hundred thousand epochs of another writer fill no memory; the newest are never accepted."""
    line = Line()
    for epoch in range(1, 5000):
        assert line.deliver(1, epoch=epoch)
    assert len(line.reader._retired_epochs) == MOST_RETIRED
    for epoch in range(5000 - MOST_RETIRED, 4999):
        assert not line.deliver(2, epoch=epoch)
    assert line.reader.counters.retired == MOST_RETIRED - 1


def test_a_writer_that_comes_back_after_all_of_them_is_a_second_writer() -> None:
    """A forgotten writer is not trusted: if another follows at once, that is a conflict."""
    line = Line()
    for epoch in range(1, MOST_RETIRED + 3):
        line.deliver(1, epoch=epoch)
    assert line.deliver(7, epoch=1)
    assert line.read().conflict
