"""What the tests of `calcidem.dem` share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # naive.py and scenes.py, the helpers beside the tests
