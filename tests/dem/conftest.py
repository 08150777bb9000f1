"""What the tests of `calcidem.dem` share."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # naive.py and scenes.py, the helpers beside the tests

settings.register_profile("untimed", deadline=None)  # as in tests/conftest.py, which mutants do without
settings.load_profile("untimed")
