"""Keys of the pages: one for each role, made from one, with a name before them or without."""

from __future__ import annotations

import pytest

from fffo_drive.daemon.parameters import METHODS
from fffo_drive.live.keys import LONGEST_NAME, Asker, Keys
from fffo_drive.roles import ROLES, may


def test_each_role_has_a_key_of_its_own_and_the_last_one_makes_all():
    keys = Keys()
    assert len({keys.of(role) for role in ROLES}) == len(ROLES)
    assert [keys.asker(keys.of(role)) for role in ROLES] == [Asker(role) for role in ROLES]
    again = Keys(keys.last)
    assert [again.of(role) for role in ROLES] == [keys.of(role) for role in ROLES]
    assert Keys(keys.of("move")).of("move") != keys.of("tune")
    assert Keys().last != keys.last


def test_a_name_gives_no_rights_and_is_reported():
    keys = Keys()
    asker = keys.asker(f"Änne K.:{keys.of('stop')}")
    assert asker == Asker("stop", "Änne K.")
    assert asker.text == "Änne K. (stop)"
    assert Asker("move").text == "role move"


@pytest.mark.parametrize("name", ["a:b", "a\nb", "<b>", "x" * (LONGEST_NAME + 1), ""])
def test_what_is_no_name_is_no_key(name):
    keys = Keys()
    assert keys.asker(f"{name}:{keys.last}") is None


@pytest.mark.parametrize("given", ["", "guess", None, 3, [], "\ud800", ":"])
def test_what_is_no_key_gives_nothing(given):
    assert Keys().asker(given) is None


def test_each_method_of_the_daemon_says_which_role_it_needs():
    needs = {role: {name for name, method in METHODS.items() if method.role == role} for role in ROLES}
    assert needs["stop"] == {"stop", "disable", "quick_stop"}
    assert needs["move"] == {"enable", "start", "jog", "velocity", "step", "reset_fault", "record"}
    assert needs["tune"] == {"toggle", "set", "model", "reload"}
    assert not any(may("look", METHODS[name].role) for name in needs["stop"])
