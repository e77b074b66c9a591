# SPDX-License-Identifier: Apache-2.0
"""What the site needs beside the pages.

Pages that follow from the code are generated. Links that leave docs/ become plain text, since the site has no such
files. Bars in code in tables, which GitHub wants escaped, lose the escape.
"""

from __future__ import annotations

import json
import posixpath
import re
import subprocess
from typing import Any

from mkdocs.structure.files import File

_CODE = re.compile(r"`[^`]*`")
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(((?:\.\./)+[^)\s#]+)(?:#[^)\s]*)?\)")


def on_files(files: Any, *, config: Any) -> None:
    """Add the pages that follow from the code."""
    command = "source install/setup.bash && .venv/bin/python docs/generate_reference.py"
    printed = subprocess.run(["bash", "-c", command], check=True, stdout=subprocess.PIPE, text=True).stdout
    for path, text in json.loads(printed).items():
        files.append(File.generated(config, path, content=text))


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Return a page's text as the site wants it."""
    folder = posixpath.dirname(page.file.src_uri)

    def kept(link: re.Match[str]) -> str:
        outside = posixpath.normpath(posixpath.join(folder, link[2])).startswith("..")
        return link[1] if outside else link[0]

    def unescaped(line: str) -> str:
        return _CODE.sub(lambda code: code[0].replace("\\|", "|"), line) if line.startswith("|") else line

    return _LINK.sub(kept, "\n".join(unescaped(line) for line in markdown.split("\n")))
