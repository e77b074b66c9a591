# SPDX-License-Identifier: Apache-2.0
"""Creates an SROS2 keystore that grants each executable exactly the topics and services it uses.

ros2 run hydro_bridge create_keystore KEYSTORE          # keys and policy, for the domain of ROS_DOMAIN_ID; network.md
ros2 run hydro_bridge create_keystore --policy FILE     # the policy alone, which needs no sros2
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

from hydro_bridge.ros.keys import ENABLE, ENFORCE, KEYSTORE, STRATEGY, enclave_of
from hydro_bridge.ros.topics import RIGHTS
from hydro_core.cli.console import UserError, command, command_line, writable, writable_folder
from hydro_core.files.atomic import flush_folder, write_whole

VERSION = "0.2.0"
"""Of the policy, by policy.xsd of package sros2."""


def policy_xml() -> bytes:
    """Return the policy as XML; anything not named in it is denied."""
    policy = ElementTree.Element("policy", version=VERSION)
    enclaves = ElementTree.SubElement(policy, "enclaves")
    for executable, nodes in RIGHTS.items():
        enclave = ElementTree.SubElement(enclaves, "enclave", path=enclave_of(executable))
        profiles = ElementTree.SubElement(enclave, "profiles")
        for name, allowed in nodes.items():
            profile = ElementTree.SubElement(profiles, "profile", ns="/", node=name)
            _allow(profile, "topic", "publish", allowed.publishes)
            _allow(profile, "topic", "subscribe", allowed.subscribes)
            _allow(profile, "service", "reply", allowed.answers)
            _allow(profile, "service", "request", allowed.calls)
    ElementTree.indent(policy)
    return ElementTree.tostring(policy, encoding="utf-8", xml_declaration=True) + b"\n"


def _allow(profile: ElementTree.Element, kind: str, what: str, names: Iterable[str]) -> None:
    """Add one list of expressions; the schema forbids empty ones."""
    if listed := sorted(set(names)):
        expressions = ElementTree.SubElement(profile, f"{kind}s", {what: "ALLOW"})
        for name in listed:
            ElementTree.SubElement(expressions, kind).text = name


POLICY_FILE = "policy.xml"
_ONLY_OWNER = 0o077  # umask: whoever can read a key can act as its owner


def make_keystore(folder: Path, policy: bytes, enclaves: Iterable[str]) -> None:
    """Create `folder`, private to its owner, with keys and permissions for all enclaves of `policy`, or not at all.

    It is valid for the domain of ROS_DOMAIN_ID. The policy is stored beside the keys.

    Raises UserError: the package sros2 is missing or refuses, or the folder exists.
    """
    try:
        from sros2 import errors, keystore
    except ImportError as error:
        raise UserError(
            f"keys are made by the package sros2, which is not here ({error}): apt install ros-jazzy-sros2, "
            "and source ROS 2; `create_keystore --policy FILE` writes the policy without it"
        ) from None
    if folder.exists():
        raise UserError(f"{folder} is there already: name another folder, its keys will not know those of this one")
    domain()  # sros2 would copy any value unchecked
    with _growing(folder) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sros2's own, about its library calls
        (partial / POLICY_FILE).write_bytes(policy)
        try:
            keystore.create_keystore(partial)
            for enclave in enclaves:
                keystore.create_enclave(partial, enclave)  # permits everything until the policy is signed
                keystore.create_permission(partial, enclave, partial / POLICY_FILE)
        except (errors.SROS2Error, RuntimeError) as error:
            raise UserError(f"sros2 refuses: {error}") from None


def domain() -> int:
    """Return the domain that keys are made for: ROS_DOMAIN_ID, or 0.

    Raises UserError: it is not a number that ROS accepts.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdecimal() and int(text) <= 232):
        raise UserError(f"ROS_DOMAIN_ID={text}: must be a number from 0 to 232")
    return int(text)


@contextmanager
def _growing(folder: Path) -> Iterator[Path]:
    """Yield a private temporary folder, renamed to `folder` on success and removed on failure."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    before = os.umask(_ONLY_OWNER)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield partial
        partial.rename(folder)
        flush_folder(folder.parent)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    finally:
        os.umask(before)


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    result = command_line("create_keystore", __doc__)
    result.add_argument("keystore", nargs="?", type=writable_folder, metavar="KEYSTORE", help="folder to make")
    result.add_argument("--policy", type=writable, metavar="FILE", help="also write the policy, as SROS2 reads it")
    return result


@command()
def main() -> None:
    """Entry point."""
    asked = parser().parse_args()
    if asked.keystore is None and asked.policy is None:
        raise UserError("create_keystore needs KEYSTORE, a folder to make, or --policy FILE")
    policy = policy_xml()
    if asked.policy is not None:
        write_whole(Path(asked.policy), policy)
        print(f"{asked.policy}: the policy of {len(RIGHTS)} enclaves", file=sys.stderr)
    if asked.keystore is not None:
        make_keystore(asked.keystore, policy, map(enclave_of, RIGHTS))
        print(
            f"{asked.keystore}: keys of {len(RIGHTS)} enclaves for ROS_DOMAIN_ID {domain()}, readable by you only. "
            "In each shell that starts a node:\n"
            f"  export {KEYSTORE}={asked.keystore.resolve()} {ENABLE}=true {STRATEGY}={ENFORCE}",
            file=sys.stderr,
        )
