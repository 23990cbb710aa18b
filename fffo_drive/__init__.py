"""Real-time drive controller for BLDC servo axes over CANopen: PI plus feed-forward friction observer (FFFO).

The names below are the library (`fffo_drive.library`); each is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .library import (
        Axis,
        ControlLaw,
        LawInput,
        MeasuredRun,
        RunMetrics,
        adopt,
        close_the_loop,
        commission,
        diagnose,
        evaluate,
        export,
        identify,
        import_log,
        margins,
        read_axis,
        read_facts,
        read_model,
        read_run,
        register_law,
        replay,
        run,
        simulate,
        tune,
        write_axis,
        write_model,
    )

__version__ = "0.1.0"
__all__ = [
    "Axis",
    "ControlLaw",
    "LawInput",
    "MeasuredRun",
    "RunMetrics",
    "adopt",
    "close_the_loop",
    "commission",
    "diagnose",
    "evaluate",
    "export",
    "identify",
    "import_log",
    "margins",
    "read_axis",
    "read_facts",
    "read_model",
    "read_run",
    "register_law",
    "replay",
    "run",
    "simulate",
    "tune",
    "write_axis",
    "write_model",
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from . import library

        return getattr(library, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
