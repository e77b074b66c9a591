# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_bridge.signals import FloatArray, ReferenceSignal, Waveform
from hydro_sim.box import reference
from hydro_sim.box.reference import REFERENCE_DTYPE

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=2.0)


def generator(signal: ReferenceSignal) -> np.ndarray:
    state = np.zeros(1, REFERENCE_DTYPE)
    want(state, signal)
    return state


def want(state: np.ndarray, signal: ReferenceSignal) -> None:
    values = (signal.waveform, signal.amplitude, signal.offset, signal.frequency, signal.phase, 0.0)
    state["wanted"] = np.array([values], reference.SIGNAL_DTYPE)


@given(
    waveform=st.sampled_from(Waveform),
    offset=st.floats(-100.0, 100.0),
    frequency=st.floats(0.1, 5.0),
    phase=st.floats(-7.0, 7.0),
    start=st.floats(0.0, 20.0),
)
@settings(max_examples=60, deadline=None)
def test_rate_is_the_derivative_and_amplitude_the_bound(
    waveform: Waveform, offset: float, frequency: float, phase: float, start: float
) -> None:
    signal = ReferenceSignal(waveform=waveform, amplitude=300.0, offset=offset, frequency=frequency, phase=phase)
    times = start + np.linspace(0.0, 2.0, 500)
    step = 1e-7
    _, rates = reference.sample(signal, times)
    ahead, behind = (reference.sample(signal, times + shift)[0] for shift in (step, -step))
    values, _ = reference.sample(signal, times)
    np.testing.assert_allclose(rates, (ahead - behind) / (2.0 * step), atol=0.2)
    assert np.max(np.abs(values - offset)) <= 300.0 * (1.0 + 1e-12)


def trace(state: np.ndarray, times: FloatArray, changes: dict[int, ReferenceSignal]) -> FloatArray:
    """Value and rate at each time, shape (n, 2), with the signals wanted from given samples on."""
    out = []
    for k, time in enumerate(times):
        if k in changes:
            want(state, changes[k])
        out.append(reference.advance(state[0], time)[:2])
    return np.array(out)


def test_arming_fades_in_from_the_measured_force() -> None:
    state = generator(SINE)
    reference.begin(state[0], -120.0, 4.0)
    assert reference.advance(state[0], 4.0)[:2] == (-120.0, 0.0)
    values = trace(state, 4.0 + 1e-3 * np.arange(1000), {})
    np.testing.assert_allclose(values[300:, 0], reference.sample(SINE, 1e-3 * np.arange(300, 1000))[0], atol=1e-9)


@pytest.mark.parametrize("changes", [(700,), (700, 800), (50, 120, 900)])
def test_changes_at_any_time_leave_value_and_rate_continuous(changes: tuple[int, ...]) -> None:
    """Also in the middle of a fade: the rate is everywhere the derivative of the value, and finite."""
    others = [
        ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=250.0, frequency=1.0, phase=0.3),
        ReferenceSignal(offset=-200.0),
        ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=0.7, phase=1.0),
    ]
    state = generator(SINE)
    reference.begin(state[0], 0.0, 0.0)
    step = 1e-3
    values = trace(state, step * np.arange(2500), dict(zip(changes, others, strict=False)))
    slopes = np.diff(values[:, 0]) / step
    np.testing.assert_allclose(slopes, 0.5 * (values[1:, 1] + values[:-1, 1]), atol=5.0)
    assert np.max(np.abs(np.diff(values[:, 1]))) < 200.0
