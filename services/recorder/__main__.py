"""Entry point of the recorder: every topic into MCAP files; no other process depends on it."""

from common.runtime.service import main
from services.recorder.service import Recorder

if __name__ == "__main__":
    main("recorder", Recorder, realtime=False)
