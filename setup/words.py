# SPDX-License-Identifier: Apache-2.0
"""Names in the field's words: `python -m setup.words` refuses those that have a standard term (`make lint`)."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STANDARD = {
    "abandoned_after": "gains_timeout", "box_header": "export", "filter_header": "export_c",
    "Findings": "ReportMarks", "flag_words": "flag_labels", "last_words": "last_line", "level_back": "level_vjp",
    "listen_to_box": "subscribe_to_box", "memory_size": "nbytes", "PolicyKeeper": "RunState",
    "policy_header": "export_c", "untold": "unexplained",
}  # fmt: skip
"""Standard term of each word. Meant otherwise: an argument of skrl, a module, a level in the backward direction."""
EXCEPTIONS = {("benchmarks/_sac_learners.py", "memory_size"), ("tests/test_firmware_parts.py", "policy_header"),
              ("src/hydro_sim/hydro_sim/model/assembly.py", "level_back")}  # fmt: skip
found = [
    f"{file}:{number}: {word} is {STANDARD[word]} here"
    for folder in ("src", "benchmarks", "tests", "docs", "demo")
    for path in sorted((ROOT / folder).rglob("*.py"))
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
    for word in STANDARD.keys() & set(re.findall(r"\w+", line))
    if ((file := str(path.relative_to(ROOT))), word) not in EXCEPTIONS
]
sys.exit("\n".join(found) or 0)
