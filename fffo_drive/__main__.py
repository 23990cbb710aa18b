"""`python -m fffo_drive` is the command `fffo-drive`."""

from __future__ import annotations

import sys

from .cli import main

sys.exit(main())
