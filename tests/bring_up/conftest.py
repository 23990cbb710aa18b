"""`scripted_node` of tests/canopen and `paper_drive` are importable."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for place in (HERE, HERE.parent / "canopen"):
    if str(place) not in sys.path:
        sys.path.append(str(place))
