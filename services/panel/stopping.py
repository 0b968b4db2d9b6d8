"""The answer to Stop motion: the cell's state is looked at before it is called unanswered. Pure.

An answer can be lost or late while the request was obeyed. A bar that says HOLDING beside a line
that says NO ANSWER teaches people to believe neither.
"""

from services.panel.status_bar import held_as
from services.panel.viewer import Answer
from services.panel.watch import Snapshot

UNANSWERED = "NO ANSWER"


def stop_text(answer: Answer, heard: Snapshot) -> str:
    """Return what a person is told, with what was heard of the cell after the answer."""
    if answer.word == "done":
        return answer.text
    if answer.word == "no answer" and (state := held_as(heard)):
        return f"the arm is held, the cell says {state}; its answer was lost"
    if answer.word == "no answer":
        why = f"({answer.text}). Use the emergency stop or the pendant."
        return f"{UNANSWERED} from the cell {why}"
    return f"{answer.word}: {answer.text}"
