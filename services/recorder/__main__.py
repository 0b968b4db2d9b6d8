"""Entry point of the recorder: every topic into MCAP files; no other process depends on it."""

from common.runtime.service import main
from forcemesh.zenoh_settings import listen_with_one_thread
from services.recorder.service import Recorder

if __name__ == "__main__":
    listen_with_one_thread()
    main("recorder", Recorder, realtime=False)
