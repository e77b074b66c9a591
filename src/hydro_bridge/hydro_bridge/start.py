# SPDX-License-Identifier: Apache-2.0
"""The beginning that all executables share, before anything that takes its time is imported.

In a package's setup.py:  "trainer = hydro_bridge.start:main_of.hydro_policy.nodes.trainer"
"""

from __future__ import annotations

from importlib import import_module

from hydro_bridge import endings


class MainOf:
    """An entry point that imports its module late: `main_of.package.module()` runs `main` of package.module."""

    def __init__(self, module: str = "") -> None:
        self._module = module

    def __getattr__(self, name: str) -> MainOf:
        return MainOf(f"{self._module}.{name}".lstrip("."))

    def __call__(self) -> int | None:
        """Answer Ctrl-C from now on, import the module, and run its `main`."""
        before = endings.answer(endings.leave)  # importing takes seconds, and a traceback tells nobody anything
        main = import_module(self._module).main
        endings.restore(before)
        status: int | None = main()
        return status


main_of = MainOf()
