"""Recorder: every topic in, MCAP files out; it never commands, and nobody waits for it."""

from common.service import main
from services.recorder.service import Recorder

if __name__ == "__main__":
    main("recorder", Recorder, realtime=False)
