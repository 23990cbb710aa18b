"""What the program says where the libraries of an extra are missing: these libraries, for this environment."""

import sys

import pytest

from fffo_drive import extras
from fffo_drive.extras import libraries_of, needs_extra


@pytest.mark.parametrize(("extra", "library"), [("live", "websockets"), ("import", "h5py"), ("fleet", "fsspec")])
def test_the_libraries_are_named_and_the_python_that_needs_them(extra, library):
    said = needs_extra("this", extra)
    assert said.startswith(f"this needs the extra `{extra}`: {sys.executable} -m pip install ")
    assert library in said
    assert "fffo-drive" not in said.partition("pip install")[2]  # on no index: a stranger could take the name


def test_from_a_source_tree_that_is_not_installed_the_extra_is_named(monkeypatch):
    def missing(name):
        raise extras.PackageNotFoundError(name)

    monkeypatch.setattr(extras, "requires", missing)
    assert libraries_of("live") == ["fffo-drive[live]"]
