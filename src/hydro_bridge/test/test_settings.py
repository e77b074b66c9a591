# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import fields

import pytest

from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.serial.port import PortSettings
from hydro_bridge.settings import SettingsError, check, describe


@pytest.mark.parametrize("kind", [GuardSettings, PortSettings])
def test_every_setting_has_a_sentence_every_number_a_range_and_every_default_is_within(kind):
    docs, defaults = describe(kind), kind()
    for field in fields(kind):
        value = getattr(defaults, field.name)
        assert docs[field.name].text
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert docs[field.name].low is not None
    check(defaults)


def test_out_of_range_is_told_with_the_range():
    with pytest.raises(SettingsError, match=r"delta_kp_max is 501, allowed is \[0, 500\]: 1/s, largest"):
        check(GuardSettings(delta_kp_max=501.0))


def test_ranges_are_read_with_sign_and_exponent():
    doc = describe(GuardSettings)["delta_kp_min"]
    assert (doc.low, doc.high) == (-200.0, 0.0)
