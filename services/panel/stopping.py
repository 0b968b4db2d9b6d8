"""Result text of Stop motion: the cell's state is read before a reply counts as missing. Pure.

A reply can be lost or late although the request was executed. The page must not show HOLDING and
NO ANSWER at the same time.
"""

from services.panel.status_bar import held_as
from services.panel.viewer import RequestOutcome
from services.panel.watch import Snapshot

UNANSWERED = "NO ANSWER"


def stop_text(answer: RequestOutcome, snapshot: Snapshot) -> str:
    """Return the text for the operator, from the reply and the state received after it."""
    if answer.word == "done":
        return answer.text
    if answer.word == "no answer" and (state := held_as(snapshot)):
        return f"the arm is held (state {state}); the reply was lost"
    if answer.word == "no answer":
        why = f"({answer.text}). Use the emergency stop or the pendant."
        return f"{UNANSWERED} from the cell {why}"
    return f"{answer.word}: {answer.text}"
