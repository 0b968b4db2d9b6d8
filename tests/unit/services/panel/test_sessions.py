"""The sessions of a panel: random, bounded in number, and limited in time."""

from hypothesis import given
from hypothesis import strategies as st

from forcemesh.clock import NS_PER_S
from services.panel.sessions import MOST_SESSIONS, SESSION_IDLE_S, SESSION_LASTS_S, Sessions

HOUR_NS = 3600 * NS_PER_S


@given(st.lists(st.floats(0.0, 30 * 24.0), min_size=1, max_size=40))
def test_a_session_lasts_while_it_is_used_and_at_most_a_week(pauses_h):
    """Each use extends it; a pause of half a day ends it, and so does its age."""
    sessions, now_ns = Sessions(), 0
    number, used_ns, open_ = sessions.begin("operate", 0), 0, True
    for pause_h in pauses_h:
        now_ns += round(pause_h * HOUR_NS)
        left_alone = now_ns - used_ns >= SESSION_IDLE_S * NS_PER_S
        open_ = open_ and not left_alone and now_ns < SESSION_LASTS_S * NS_PER_S
        assert (sessions.rights(number, now_ns) == "operate") is open_
        used_ns = now_ns


def test_the_number_of_sessions_is_bounded():
    """The least recently used one is dropped, all that ended when the next one begins."""
    sessions = Sessions()
    mine, idle = sessions.begin("operate", 0), sessions.begin("operate", 0)
    for count in range(3 * MOST_SESSIONS):
        assert sessions.rights(mine, count) == "operate"
        sessions.begin("view", count)
        assert len(sessions) <= MOST_SESSIONS
    assert sessions.rights(idle, 3 * MOST_SESSIONS) is None
    sessions.begin("operate", 3 * MOST_SESSIONS + round(SESSION_IDLE_S * NS_PER_S))
    assert len(sessions) == 1
