# SPDX-License-Identifier: Apache-2.0
"""Make this checkout ready to run (environment, pinned wheels, built packages, compiled kernels), as far as it is not.

Usage: python3 -m setup.bootstrap [--checks] [--main-job | --without-kernels]

    --checks            install what checks and tests need, too
    --main-job          compile only the kernels that `make train` runs
    --without-kernels   compile none
"""

# This file must parse on old Pythons, to say in a sentence that they are too old: no `from __future__`, late imports.
import os
import sys


def complaint(version, folder):
    """Return a sentence if hydro cannot run on Python `version`, (major, minor, ...), or in `folder`; else None."""
    if not (3, 10) <= tuple(version[:2]) <= (3, 13):
        sentence = "Python {}.{} found, but 3.10 to 3.13 is needed: name one, as in `make setup PYTHON=python3.12`."
        return sentence.format(*version[:2])
    if any(ord(letter) > 127 for letter in folder):
        return "{} has letters outside of ASCII, which CMake cannot build in: move the checkout.".format(folder)
    return None


def main():
    """Run the set-up. Returns the exit status: 0, or 2 after one sentence on stderr."""
    try:
        sentence = complaint(sys.version_info, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
        if not sentence:
            from setup import steps

            words = sys.argv[1:]
            kernels = "none" if "--without-kernels" in words else "main-job" if "--main-job" in words else "all"
            sentence = steps.carry_out("--checks" in words, kernels)
    except KeyboardInterrupt:
        sys.stderr.write("setup: interrupted; run it again to go on.\n")
        return 130
    if sentence:
        sys.stderr.write("setup: " + sentence + "\n")
    return 2 if sentence else 0


if __name__ == "__main__":
    sys.exit(main())
