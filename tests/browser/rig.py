"""A page as a person uses it, and the processes behind it."""

import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from playwright.sync_api import Error as PlaywrightError
from playwright.sync_api import Locator, Page
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from tools.tree import ROOT

TRIES, HIT_WITHIN_S, CHECKS = 3, 20.0, 5
ENDS_WITHIN_S = 30.0
PATIENCE_S = 90.0  # of the test, not of the cell: drawing without a graphics card is slow
# The scene is drawn for pictures only: software WebGL would take the processor from the cell.
SPARE = """
window.__draw = false;
const kinds = ['drawElements', 'drawArrays', 'clear'];
for (const name of [...kinds, ...kinds.slice(0, 2).map((kind) => kind + 'Instanced')]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...all) {
    if (window.__draw) return draw.apply(this, all);
  };
}
window.requestAnimationFrame = (frame) => setTimeout(() => frame(performance.now()), 150);
window.cancelAnimationFrame = clearTimeout; // a frame that is called off stays away
"""
DRAW_ONCE = (
    "new Promise(done => { window.__draw = true;"
    " setTimeout(() => { window.__draw = false; done(); }, 900); })"
)


class Cockpit:
    """One page as a person uses it: clicks, and texts."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.clicks = 0
        self.asked: list[str] = []
        page.set_default_timeout(1e3 * PATIENCE_S)
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("websocket", lambda socket: self.asked.append(socket.url))

    def open(self, address: str) -> "Cockpit":
        """Load the page, and wait for the forms of this session."""
        self.page.goto(address)
        self.page.get_by_text("Replies to requests appear here.").wait_for()
        return self

    def button(self, label: str) -> Locator:
        """Return the visible button with exactly this label."""
        exactly = re.compile(rf"^\s*{re.escape(label)}\s*$")
        return self.page.locator("button:visible", has_text=exactly).first

    def click(self, label: str) -> None:
        """Click a button."""
        self.clicks += 1
        hit(self.button(label))

    def cancel(self) -> None:
        """Answer no to the open question, or wait until it has closed by itself."""

        def is_closed() -> bool:
            no = self.button("Cancel")
            if no.count():
                with suppress(PlaywrightTimeout, PlaywrightError, AssertionError):
                    found = no.evaluate(WHERE, timeout=2e3)
                    if not found["covered"]:
                        self.page.mouse.click(found["x"], found["y"])
            return no.count() == 0

        self.clicks += 1
        wait_until(is_closed)

    def tab(self, label: str) -> None:
        """Go to a tab."""
        self.clicks += 1
        hit(self.page.get_by_role("tab", name=label))

    def fill(self, label: str, value: float) -> None:
        """Type a number into the field behind a label."""
        name = self.page.locator("label:visible").filter(has_text=label).first
        row = name.locator("xpath=ancestor::div[contains(@class, 'Flex-root')][1]")
        field = row.locator("input[inputmode]").first
        field.fill(f"{value:g}")
        field.press("Enter")

    def choose(self, label: str, option: str) -> None:
        """Choose an option of the list behind a label."""
        name = self.page.locator("label:visible").filter(has_text=re.compile(rf"^{label}$")).first
        row = name.locator("xpath=ancestor::div[contains(@class, 'Flex-root')][1]")
        row.locator("input:visible").first.click()
        self.page.locator("[role=option]:visible").filter(
            has_text=re.compile(rf"^{option}$")
        ).first.click()

    @property
    def state(self) -> str:
        """Return the arm's state in the bar."""
        return self.page.locator("#fm-state").inner_text()

    def until_state(self, word: str, within_s: float = PATIENCE_S) -> None:
        """Wait until the bar shows a state."""
        self.page.locator("#fm-state", has_text=re.compile(rf"^{word}")).wait_for(
            timeout=1e3 * within_s
        )

    def until_reply(self, text: str) -> None:
        """Wait until the line of replies contains a text."""
        self.page.get_by_text(text).locator("visible=true").first.wait_for()

    def arm(self) -> None:
        """Arm, and confirm; again when a machine that stalled made the inputs invalid."""
        for _ in range(TRIES):
            self.click("Arm")
            self.click("Arm now")
            with suppress(PlaywrightTimeout):
                self.until_state("ARMED", within_s=15.0)
                return
        raise AssertionError(f"not armed: {self.answer()}")

    def answer(self) -> str:
        """Return the last reply, as the page shows it."""
        return " / ".join(self.page.locator(".mantine-Notification-root").all_inner_texts())

    def press(self) -> None:
        """Start pressing with the values of the form, and confirm."""
        self.click("Start pressing")
        self.click("Press now")
        self.until_state("ACTIVE")

    def picture(self, name: str) -> None:
        """Draw the scene once and store a picture in out/."""
        self.page.evaluate(
            "document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click())"
        )
        self.page.evaluate(DRAW_ONCE)
        (ROOT / "out").mkdir(exist_ok=True)
        self.page.screenshot(path=ROOT / "out" / f"{name}.png", timeout=1e3 * PATIENCE_S)


WHERE = """e => { e.scrollIntoView({block: 'nearest'});
  const box = e.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2;
  if (!box.width || !box.height) return {x, y, covered: 'not there any more'};
  const top = document.elementFromPoint(x, y);
  return {x, y, covered: e.contains(top) ? '' : top ? top.outerHTML.slice(0, 200) : 'nothing'}; }"""


def hit(target: Locator) -> None:
    """Click an element that rests and is not covered, without waiting for frames.

    The page is not drawn here, so the library's own wait for rest would be long.
    """
    target.wait_for()
    give_up_s, before, checks = time.monotonic() + HIT_WITHIN_S, None, 0
    while True:
        found = target.evaluate(WHERE)
        checks += 1
        if not found["covered"] and found == before:
            break
        # One check may take longer than the whole time-out on a machine that stalls.
        assert time.monotonic() < give_up_s or checks < CHECKS, found
        before = found
        time.sleep(0.15)
    target.page.mouse.click(found["x"], found["y"])


def wait_until(done, within_s=PATIENCE_S) -> None:
    """Wait until a condition is true."""
    give_up_s = time.monotonic() + within_s
    while not done():
        assert time.monotonic() < give_up_s, f"not within {within_s:g} s"
        time.sleep(0.1)


@contextmanager
def running(*words: object, **environment: str) -> Iterator[None]:
    """Run a Python process until the end of the block, where it must end by itself."""
    command = [sys.executable, *(str(word) for word in words)]
    process = subprocess.Popen(
        command, cwd=ROOT, env=os.environ | environment, stdout=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait(ENDS_WITHIN_S)


def answers(port: int) -> bool:
    """Return whether a panel answers."""
    with suppress(OSError):
        return urllib.request.urlopen(f"http://127.0.0.1:{port}/alive", timeout=5.0).status == 200
    return False
