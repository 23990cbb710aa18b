"""The cache of compiled kernels: whether the loop starts at once, here and in the service."""

from __future__ import annotations

from pathlib import Path

from .findings import HostFinding, ok, warning

SERVICE_CACHES = "/var/cache/private/fffo-drive"  # where DynamicUser= has the service's CacheDirectory=
LOOP_INDEX = "loop.*.nbi"  # numba's index of runtime/loop.py


def cache_findings(directory: Path, digest: str, services: Path = Path(SERVICE_CACHES)) -> list[HostFinding]:
    """The cache of this user and those of services; `directory` and `digest` are those of `fffo_drive.jit`."""
    findings = [_cache("kernel cache", directory, "the first run compiles for half a minute, once")]
    try:
        found = sorted(path for path in services.iterdir() if path.is_dir())
    except OSError:  # not installed, or not root
        return findings
    return findings + [
        _cache(f"kernel cache of {path.name}", path / digest, f"systemctl start fffo-drive@{path.name} fills it, once")
        for path in found
    ]


def _cache(subject: str, directory: Path, remedy: str) -> HostFinding:
    if any(directory.rglob(LOOP_INDEX)):
        return ok(subject, f"warm: {directory}")
    return warning(subject, f"cold: {directory} has no compiled loop of this version", remedy)
