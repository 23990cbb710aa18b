"""A line of an axis file is changed or added; everything else stays, byte for byte."""

from __future__ import annotations

import pytest

from fffo_drive.config.axis_text import replace_file, with_line
from fffo_drive.documents import DocumentError

TEXT = "# ours\nname: a   # of the shop\nmodel: models/one.yaml  # fitted\nloop: {rate_hz: 500}\n"


def changed(tmp_path, text, key, value):
    path = tmp_path / "axis.yaml"
    path.write_bytes(text.encode())
    return with_line(path, key, value)


def test_a_value_is_replaced_and_its_comment_stays(tmp_path):
    assert changed(tmp_path, TEXT, "model", "two.yaml") == TEXT.replace("models/one.yaml", "two.yaml")


def test_a_key_that_is_not_there_gets_a_line_behind_the_model(tmp_path):
    wanted = TEXT.replace("# fitted\n", "# fitted\ncommissioning: a.commissioning.yaml\n")
    assert changed(tmp_path, TEXT, "commissioning", "a.commissioning.yaml") == wanted
    assert changed(tmp_path, wanted, "commissioning", "b.yaml") == wanted.replace("a.commissioning", "b")


def test_line_ends_of_another_system_and_a_file_without_a_last_one_are_kept(tmp_path):
    assert (
        changed(tmp_path, "model: m\r\nname: a\r\n", "commissioning", "c")
        == "model: m\r\ncommissioning: c\r\nname: a\r\n"
    )
    assert changed(tmp_path, "name: a\nmodel: m", "commissioning", "c") == "name: a\nmodel: m\ncommissioning: c\n"


def test_a_name_that_yaml_would_read_otherwise_is_quoted(tmp_path):
    assert 'commissioning: "a: b.yaml"' in changed(tmp_path, TEXT, "commissioning", "a: b.yaml")


@pytest.mark.parametrize("text", ["{name: a, model: m}\n", "name: a\nmodel:\n  m\n"])
def test_a_file_that_is_written_otherwise_is_left_to_its_owner(tmp_path, text):
    with pytest.raises(DocumentError, match="on a line of its own yourself"):
        changed(tmp_path, text, "commissioning" if text.startswith("{") else "model", "x.yaml")


def test_a_link_to_a_file_stays_one_and_the_rights_stay(tmp_path):
    real, link = tmp_path / "real.yaml", tmp_path / "link.yaml"
    real.write_text("a: 1\n")
    real.chmod(0o640)
    link.symlink_to(real)
    replace_file(link, "a: 2\n")
    assert link.is_symlink()
    assert (real.read_text(), real.stat().st_mode & 0o777) == ("a: 2\n", 0o640)
