"""Makes the scenes of the reference cases importable from this folder's tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
