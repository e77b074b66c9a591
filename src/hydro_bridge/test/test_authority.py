# SPDX-License-Identifier: Apache-2.0
"""One holder at a time, and the epoch that its commands carry."""

from __future__ import annotations

from itertools import count

import pytest

from hydro_bridge.safety.authority import KEPT, LEASE, Authority


@pytest.fixture
def authority() -> Authority:
    return Authority(count(1).__next__)


def test_the_second_is_told_who_commands_and_a_holder_that_asks_again_keeps_claim_and_epoch(authority) -> None:
    assert authority.take("trainer", 0, 0.0) == ""
    claim, epoch = authority.claim, authority.epoch
    assert "trainer commands this plant" in authority.take("evaluate", 0, 1.0)
    assert "trainer commands this plant" in authority.take("trainer", claim + 100, 1.0), "of the same name"
    for now in range(1, 10):
        assert authority.take("trainer", claim, float(now)) == ""
    assert (authority.holder, authority.claim, authority.epoch) == ("trainer", claim, epoch)
    assert authority.take("evaluate", 0, 9.0 + LEASE) != ""


def test_a_silent_holder_is_succeeded_and_its_commands_are_refused(authority: Authority) -> None:
    authority.take("trainer", 0, 0.0)
    old = authority.epoch
    now = LEASE + 0.1
    assert authority.take("evaluate", 0, now) == ""
    assert authority.holder == "evaluate"
    assert not authority.admits("gains", old, now + 1.0)
    assert authority.admits("gains", authority.epoch, now + 1.0)
    assert "evaluate commands this plant" in authority.take("trainer", old, now + 1.0)


def test_a_claim_lapses_with_silence_in_which_no_command_came(authority: Authority) -> None:
    authority.take("trainer", 0, 0.0)
    assert not authority.lapse(LEASE) and authority.holder
    authority.renew(LEASE)
    assert "trainer commands" in authority.take("evaluate", 0, LEASE + 0.1)
    assert not authority.lapse(2 * LEASE) and authority.lapse(2 * LEASE + 0.1) and not authority.holder
    assert not authority.lapse(100.0), "nobody is there to lose it"


def test_what_carries_no_epoch_or_an_old_one_is_refused_and_counted(authority: Authority) -> None:
    authority.take("trainer", 0, 0.0)
    old = authority.epoch
    authority.end(10.0)
    assert not authority.admits("gains", old, 10.1) and not authority.refused, "on its way when the session ended"
    assert not authority.admits("gains", old, 11.0)
    assert not authority.admits("gains", 0, 11.0)
    assert not authority.admits("reference", 0, 11.0)
    assert authority.refused == {"gains": 2, "reference": 1}


def test_only_the_holder_can_give_it_back_and_an_heir_is_waited_for_but_not_for_ever(authority: Authority) -> None:
    assert not authority.give(0, 0.0)
    authority.take("trainer", 0, 0.0)
    old = authority.epoch
    assert not authority.give(authority.claim + 1, 1.0) and authority.holder
    assert authority.give(authority.claim, 1.0, heir="evaluate") and not authority.holder
    assert "handed over to evaluate" in authority.take("collect", 0, 1.1)
    assert "handed over to evaluate" in authority.take("trainer", 0, 1.1), "nor he who gave it"
    assert authority.take("evaluate", 0, 2.0) == "" and authority.holder == "evaluate"
    assert authority.epoch != old
    authority.give(authority.claim, 3.0)
    assert authority.take("collect", 0, 3.1) == "", "given back to whoever asks"
    authority.give(authority.claim, 4.0, heir="evaluate")
    assert authority.take("collect", 0, 4.0 + KEPT) == "", "the heir has not come"


def test_numbers_are_drawn_anew_and_are_never_0() -> None:
    drawn = {Authority().epoch for _ in range(100)}
    assert len(drawn) == 100 and 0 not in drawn and max(drawn) < 2**64
