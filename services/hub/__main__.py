"""Hub: the Zenoh router on which every process of a cell hangs. Its only own word is its health."""

from common.bus import open_hub
from common.service import main
from services.hub.service import Hub

if __name__ == "__main__":
    main("hub", Hub, connect=open_hub)
