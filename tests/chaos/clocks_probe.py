"""Clock probe: prints the wall-clock time of its process."""

import time

if __name__ == "__main__":
    print(time.time(), flush=True)
