# SPDX-License-Identifier: Apache-2.0
"""One holder at a time, and the epoch that its commands carry."""

from __future__ import annotations

from itertools import count

import pytest

from hydro_bridge.safety.lease import DISARMED_BY_PERSON, LEASE_TIMEOUT, Lease


@pytest.fixture
def lease() -> Lease:
    """Held by a trainer since 0 s."""
    lease = Lease(count(1).__next__)
    assert lease.grant("trainer", 0, 0.0) == ""
    return lease


def test_the_second_is_told_who_commands_and_a_holder_that_asks_again_keeps_claim_and_epoch(lease: Lease) -> None:
    claim, epoch = lease.claim, lease.epoch
    assert "trainer commands this plant" in lease.grant("evaluate", 0, 1.0)
    assert "trainer commands this plant" in lease.grant("trainer", claim + 100, 1.0), "of the same name"
    for now in range(1, 10):
        assert lease.grant("trainer", claim, float(now)) == ""
    assert (lease.holder, lease.claim, lease.epoch) == ("trainer", claim, epoch)
    assert lease.grant("evaluate", 0, 9.0 + LEASE_TIMEOUT) != ""


def test_a_silent_holder_is_succeeded_and_its_commands_are_refused(lease: Lease) -> None:
    old, now = lease.epoch, LEASE_TIMEOUT + 0.1
    assert lease.grant("evaluate", 0, now) == "" and lease.holder == "evaluate"
    assert not lease.accepts("gains", old, now + 1.0) and lease.accepts("gains", lease.epoch, now + 1.0)
    assert "evaluate commands this plant" in lease.grant("trainer", old, now + 1.0)


def test_a_claim_lapses_with_silence_in_which_no_command_of_the_holders_came(lease: Lease) -> None:
    assert not lease.expire(LEASE_TIMEOUT) and lease.holder
    assert lease.accepts("gains", lease.epoch, LEASE_TIMEOUT)
    assert "trainer commands" in lease.grant("evaluate", 0, LEASE_TIMEOUT + 0.1)
    assert lease.accepts("correction", lease.epoch, 2 * LEASE_TIMEOUT, renews=False), "the filter's"
    assert not lease.expire(2 * LEASE_TIMEOUT) and lease.expire(2 * LEASE_TIMEOUT + 0.1) and not lease.holder
    assert not lease.expire(100.0), "nobody is there to lose it"


def test_a_claim_from_before_a_plant_counted_by_its_box_lapses_too() -> None:
    """A holder whose grant was lost asks as a stranger; the host's clock may be days ahead of the box's."""
    lease = Lease()
    assert lease.grant("trainer", 0, 2e5) == ""
    assert "trainer commands this plant" in lease.grant("trainer", 0, 1.0) and not lease.expire(1.0 + LEASE_TIMEOUT)
    assert lease.expire(1.1 + LEASE_TIMEOUT) and lease.grant("trainer", 0, 5.0) == ""


def test_what_carries_no_epoch_or_an_old_one_is_refused_and_counted(lease: Lease) -> None:
    old = lease.epoch
    lease.end_session(10.0)
    assert not lease.accepts("gains", old, 10.1) and not lease.refused, "on its way when the session ended"
    for topic, epoch in (("gains", old), ("gains", 0), ("reference", 0)):
        assert not lease.accepts(topic, epoch, 11.0)
    assert lease.refused == {"gains": 2, "reference": 1}
    drawn = {Lease().epoch for _ in range(100)}
    assert len(drawn) == 100 and 0 not in drawn and max(drawn) < 2**64, "nobody guesses it, and none is said twice"


def test_only_the_holder_can_give_it_back(lease: Lease) -> None:
    old = lease.epoch
    assert not lease.release(0, 0.0) and not lease.release(lease.claim + 1, 1.0) and lease.holder
    assert lease.release(lease.claim, 1.0) and not lease.holder
    assert not lease.release(0, 1.0), "nobody holds it"
    assert lease.grant("collect", 0, 1.1) == "" and lease.holder == "collect" and lease.epoch != old


def test_what_a_person_disarmed_only_a_person_arms(lease: Lease) -> None:
    lease.on_disarmed(lease.claim)
    assert lease.arm_refusal(lease.claim, 0, "") == "", "its own disarming"
    lease.on_disarmed(0)
    assert lease.arm_refusal(lease.claim, 0, "") == DISARMED_BY_PERSON and lease.arm_refusal(0, 0, "") == ""
    assert "trainer commands this plant, not evaluate" in lease.arm_refusal(0, 0, "evaluate")
    assert "changed hands since" in lease.arm_refusal(0, lease.epoch + 1, "trainer")
    lease.on_armed()
    assert lease.arm_refusal(lease.claim, lease.epoch, "trainer") == ""
    lease.on_disarmed(0)
    lease.grant("evaluate", 0, LEASE_TIMEOUT + 0.1)
    assert lease.arm_refusal(lease.claim, 0, "") == "", "the bar was the other's"


def test_a_holder_that_disarms_by_its_claim_from_before_its_silence_may_arm(lease: Lease) -> None:
    old = lease.claim
    assert lease.expire(LEASE_TIMEOUT + 0.1)
    lease.grant("trainer", old, LEASE_TIMEOUT + 0.2)
    lease.on_disarmed(old)  # asked for before the answer to the line above came
    assert lease.claim != old and lease.arm_refusal(lease.claim, lease.epoch, "trainer") == ""
