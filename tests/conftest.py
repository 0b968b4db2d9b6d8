"""What every test shares: how hypothesis draws.

On a developer's machine each run draws new examples; in CI the same ones are drawn every time, so
that a red run is always the change's own doing.
"""

import os

from hypothesis import settings

# No deadline per example: how long one takes is the machine's business, not the code's.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, database=None, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "dev")
