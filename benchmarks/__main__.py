# SPDX-License-Identifier: Apache-2.0
"""Run every benchmark in a process of its own: `python -m benchmarks [--json FILE] [NAME ...]`, or `make bench`."""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
_PACKAGES = {path.parent.name for path in HERE.glob("[!_]*/__main__.py")}
NAMES = sorted({path.stem for path in HERE.glob("[!_]*.py")} | _PACKAGES)
STUDIES = frozenset((
    "beyond_the_table", "controllers", "gain_schedules", "model_mismatch", "null_simulations", "paper", "prove",
    "real_recordings", "residual", "sac_peers", "training_seeds", "trends",
))  # fmt: skip
"""Run only if named: they take long, or need what another command makes first."""


def main(arguments: list[str] | None = None) -> int:
    """Run the named benchmarks, default all; the exit status counts those that failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measured speeds.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(NAMES)}; default all but "
                        f"{', '.join(sorted(STUDIES))}")  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all results into one file")
    asked = parser.parse_args(arguments)
    unknown = set(asked.names) - set(NAMES)
    if unknown:
        parser.error(f"no benchmark {min(unknown)!r}; there are {', '.join(NAMES)}")
    results: dict[str, object] = {"machine": f"{platform.machine()}, Python {platform.python_version()}"}
    failed = 0
    for name in asked.names or [name for name in NAMES if name not in STUDIES]:
        print(f"\n== {name}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "result.json"
            command = [sys.executable, "-m", f"benchmarks.{name}", "--json", str(file)]
            failed += subprocess.run(command, cwd=HERE.parent, check=False).returncode != 0
            results[name] = json.loads(file.read_text()) if file.exists() else None
    if asked.json:
        asked.json.write_text(json.dumps(results, indent=2) + "\n")
    return failed


if __name__ == "__main__":
    sys.exit(main())
