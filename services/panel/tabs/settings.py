"""Settings tab: theme of this browser, and how it draws the 3D view."""

import threading
from contextlib import suppress

import viser

from services.panel.markup import html
from services.panel.prose import Prose
from services.panel.tabs import Tab
from services.panel.viewer import Viewer, put

DARK_KEY = "forcemesh dark"
ANSWERS_WITHIN_S = 20.0
DRAWN_SLOWLY = html(  # bar.html shows it where the browser has no graphics card
    '<p class="fm-software">The 3D view is drawn without a graphics card; it may lag.</p>'
)


def build(viewer: Viewer) -> None:
    """Fill the tab."""
    add_settings(viewer.client)


def add_settings(client: viser.ClientHandle) -> None:
    """Add the dark mode switch, whose setting the browser stores, and the note on drawing."""
    dark = client.gui.add_checkbox("Dark mode", initial_value=False)
    Prose(client.gui, DRAWN_SLOWLY)

    def show(*, persist: bool) -> None:
        client.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark.value)
        if persist:
            client.local_storage.set_item(DARK_KEY, "yes" if dark.value else "no")

    dark.on_update(lambda _event: show(persist=True))

    def recall() -> None:
        with suppress(TimeoutError):  # a busy browser keeps the light theme
            if client.local_storage.get_item(DARK_KEY, timeout=ANSWERS_WITHIN_S) == "yes":
                put(dark, value=True)
                show(persist=False)

    threading.Thread(target=recall, daemon=True).start()


TAB = Tab(100, "Settings", viser.Icon.SETTINGS, build)
