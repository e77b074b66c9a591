# SPDX-License-Identifier: Apache-2.0
"""Make this checkout ready to run: environment, pinned wheels, built packages, compiled kernels.

Does nothing where nothing has changed.

Usage: python3 -m setup.bootstrap [--force] [--checks] [--main-job | --without-kernels]

    --force             everything again
    --checks            install what checks and tests need, too
    --main-job          compile only the kernels that `make train` runs
    --without-kernels   compile none
"""

# This file must parse on old Pythons, to say in a sentence that they are too old: no `from __future__`, late imports.
import sys

OLDEST, NEWEST = (3, 10), (3, 13)


def python_complaint(version):
    """Return a sentence if packages cannot run on Python `version`, a tuple starting (major, minor); else None."""
    if OLDEST <= tuple(version[:2]) <= NEWEST:
        return None
    sentence = "Python {}.{} found, but 3.10 to 3.13 is needed: name one, as in `make setup PYTHON=python3.12`."
    return sentence.format(*version[:2])


def main():
    """Run the set-up. Returns the exit status: 0, or 2 after one sentence on stderr."""
    complaint = python_complaint(sys.version_info)
    if complaint:
        sys.stderr.write("setup: " + complaint + "\n")
        return 2
    from setup import plan, progress

    try:
        words = sys.argv[1:]
        kernels = "none" if "--without-kernels" in words else "main-job" if "--main-job" in words else "all"
        plan.carry_out(force="--force" in words, checks="--checks" in words, kernels=kernels)
    except progress.SetupError as error:
        sys.stderr.write("setup: {}\n".format(error))
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("setup: interrupted; run it again to go on.\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
