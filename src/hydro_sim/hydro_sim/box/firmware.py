# SPDX-License-Identifier: Apache-2.0
"""The box in C (`firmware/`) as a shared library: bytes of the line in, one sample each millisecond, bytes out.

`make setup` builds it in double and in single precision as the package hydro_firmware.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import LawState
from hydro_bridge.settings import SettingsError
from hydro_bridge.signals import STATE_DTYPE, FloatArray, Law, StateArray
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.header import NAME, filled, structure, values
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors

Precision = Literal["double", "single"]

SINGLE_DTYPE = np.dtype(
    [(name, np.float32 if index > 1 and name != "flags" else STATE_DTYPE[name]) for index, name in
     enumerate(STATE_DTYPE.names or ())], align=True,
)  # fmt: skip
"""`hydro_sample` of the library in single precision."""

_BURST_MAX = 516
_COUNTS = ("taken", "stale", "greetings", "refused", "refused_references", "last_command")


def library_path(precision: Precision) -> Path:
    """Return the path of the library that set-up built. Raises SettingsError: it is not there."""
    name = f"libhydro_box_{precision}.so"
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in filter(None, prefixes):
        if (path := Path(prefix, "lib", name)).is_file():
            return path
    raise SettingsError(f"{name} is not built: run `make setup`, and `source install/setup.bash`")


@cache
def _library(precision: Precision) -> ctypes.CDLL:
    library = ctypes.CDLL(str(library_path(precision)))
    for function in ("hydro_c_box_size", "hydro_c_config_size", "hydro_c_frames"):
        getattr(library, function).restype = ctypes.c_size_t
    return library


class Firmware:
    """One box in C, from its power-on.

    Parameters
    ----------
    bench, config, sensors
        What it believes, its settings, and the ages of its rates.
    precision
        Of its numbers.
    epoch
        Of its power-on.
    name
        What it calls itself.
    """

    def __init__(
        self,
        bench: Bench,
        config: BoxConfig | None = None,
        sensors: Sensors | None = None,
        precision: Precision = "double",
        epoch: int = 1,
        name: str = NAME,
    ) -> None:
        self._c = _library(precision)
        kind = structure(ctypes.c_float if precision == "single" else ctypes.c_double)
        if ctypes.sizeof(kind) != self._c.hydro_c_config_size():
            raise SettingsError("the built firmware is of another version: run `make setup`")
        self._config = filled(kind, values(bench, config or BoxConfig(), sensors or Sensors(), name))
        self._box = ctypes.create_string_buffer(self._c.hydro_c_box_size())
        self._out = ctypes.create_string_buffer(_BURST_MAX)
        self._counts = (ctypes.c_uint32 * len(_COUNTS))()
        self._sample = np.zeros(1, SINGLE_DTYPE if precision == "single" else STATE_DTYPE)
        self._measurement = np.zeros(8)
        self.epoch = epoch
        self.power_on(epoch)

    def power_on(self, epoch: int | None = None) -> None:
        """Reset to power-on, with the given epoch or the next."""
        self.epoch = self.epoch % 0xFFFFFFFF + 1 if epoch is None else epoch
        self._c.hydro_c_power_on(self._box, ctypes.byref(self._config), ctypes.c_uint32(self.epoch))

    def take(self, data: bytes) -> None:
        """Process bytes that arrived over the line."""
        self._c.hydro_c_bytes(self._box, data, ctypes.c_size_t(len(data)))

    def tick(self, measurement: FloatArray, time: float) -> npt.NDArray[np.void]:
        """Run one sample on x, shape (8,), at box time [s]; return a record of `STATE_DTYPE`, shape (1,)."""
        self._measurement[:] = measurement
        place = ctypes.c_void_p(self._sample.ctypes.data)
        self._c.hydro_c_tick(
            self._box, ctypes.c_void_p(self._measurement.ctypes.data), ctypes.c_double(time), place
        )  # fmt: skip
        result: StateArray = self._sample.astype(STATE_DTYPE)
        return result

    def frames(self) -> bytes:
        """Return the bytes sent up the line after a tick."""
        count = self._c.hydro_c_frames(self._box, self._out)
        return ctypes.string_at(self._out, count)

    def law_state(self) -> LawState:
        """Return the force law as it acted in the last sample."""
        out = (ctypes.c_double * 9)()
        self._c.hydro_c_law_state(self._box, out)
        law, value, rate, a_0, a_1, a_2, a_3, *scales = out
        return LawState(Law(int(law)), value, rate, (a_0, a_1, a_2, a_3), *scales)

    def counts(self) -> dict[str, int]:
        """Commands taken, commands old or repeated, greetings; values and references refused; the newest command."""
        self._c.hydro_c_counts(self._box, self._counts)
        return dict(zip(_COUNTS, map(int, self._counts), strict=True))
