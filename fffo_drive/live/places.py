"""Files that the live server leaves beside the daemon's sockets; independent of the server's own imports."""

from __future__ import annotations

URL_FILE, VIEWERS_FILE, TOKEN_FILE = "scope.url", "viewers.url", "scope.token"
URL_MODE, TOKEN_MODE = 0o644, 0o640
