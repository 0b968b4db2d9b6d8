"""What a reader remembers of writers is bounded, however many there were."""

from tests.fakes.line import Line

MOST_RETIRED = 64


def test_the_memory_of_former_writers_is_bounded() -> None:
    """A hundred thousand epochs of a stranger fill no memory; the newest ones are never heard."""
    line = Line()
    for epoch in range(1, 5000):
        assert line.say(1, epoch=epoch)
    assert len(line.reader._retired_epochs) == MOST_RETIRED
    for epoch in range(5000 - MOST_RETIRED, 4999):
        assert not line.say(2, epoch=epoch)
    assert line.reader.counters.retired == MOST_RETIRED - 1


def test_who_comes_back_after_all_of_them_is_a_second_writer() -> None:
    """Forgotten is not trusted: a writer that another follows at once is a conflict."""
    line = Line()
    for epoch in range(1, MOST_RETIRED + 3):
        line.say(1, epoch=epoch)
    assert line.say(7, epoch=1)
    assert line.read().conflict
