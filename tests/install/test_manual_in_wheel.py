"""A wheel without the tools of its manual is not built unless asked for."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

HOOK = Path(__file__).resolve().parents[2] / "tools" / "manual_in_wheel.py"


@pytest.fixture
def hook(tmp_path, monkeypatch):
    """Of a tree without .venv, by an interpreter that has nothing."""
    spec = importlib.util.spec_from_file_location("manual_in_wheel", HOOK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    return module.ManualHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel")


def test_the_build_fails_with_the_line_that_mends_it(hook):
    with pytest.raises(RuntimeError, match="Type `tools/environment test` in the clone, and build again"):
        hook.initialize("standard", {"force_include": {}})


def test_a_wheel_without_pages_is_one_that_was_asked_for(hook, monkeypatch):
    monkeypatch.setenv("FFFO_DRIVE_WITHOUT_MANUAL", "1")
    found = {"force_include": {}}
    hook.initialize("standard", found)
    assert found == {"force_include": {}}


def test_an_editable_installation_needs_no_pages(hook):
    hook.initialize("editable", {"force_include": {}})
