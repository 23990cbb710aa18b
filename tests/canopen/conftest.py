"""`scripted_node` is importable. (This directory cannot be a package: `canopen` is the name of the library.)"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = str(Path(__file__).resolve().parent)
if HERE not in sys.path:
    sys.path.append(HERE)
