# SPDX-License-Identifier: Apache-2.0
"""Security by SROS2: enclave of this process, policy, keystore; the rights are those of `topics.RIGHTS`.

A process' enclave is its executable's, however it was started (network.md). ROS's own variables enable security, for a
process and its children. ROS reads only `true` as on, and silently runs unsecured if a key is missing, unless the
strategy is exactly `Enforce`. Here unrecognised values are refused, and Enforce is the default.

The policy is one of SROS2, version 0.2.0 (policy.xsd of package sros2).
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

from rclpy.node import Node
from rclpy.parameter import Parameter

from hydro_bridge.errors import UserError
from hydro_bridge.files.atomic import flush_folder
from hydro_bridge.ros.topics import RIGHTS
from hydro_bridge.settings import SettingsError

ENABLE = "ROS_SECURITY_ENABLE"
STRATEGY = "ROS_SECURITY_STRATEGY"
KEYSTORE = "ROS_SECURITY_KEYSTORE"
ENFORCE = "Enforce"
_MEANT = {ENABLE: ("true", "false"), STRATEGY: (ENFORCE, "Permissive")}


def enclave_of(executable: str) -> str:
    """Return the name of an executable's enclave."""
    return f"/hydro/{executable}"


def enclave_arguments() -> list[str]:
    """Return the arguments that select this process' enclave, if it runs one of our executables; the user's own win.

    The enclave is named with and without keys, so that both use the same start-up path.
    """
    executable = Path(sys.argv[0]).stem
    return ["--ros-args", "--enclave", enclave_of(executable)] if executable in RIGHTS else []


def security_enabled() -> bool:
    """Whether security is enabled; if so, enforce it for this process and its children unless the user has chosen.

    Raises SettingsError: a variable has a value that ROS would read as off.
    """
    for variable, meant in _MEANT.items():
        if (value := os.environ.get(variable, "")) and value not in meant:
            raise SettingsError(f"{variable}={value}: ROS knows {' and '.join(meant)} only, to the letter")
    if os.environ.get(ENABLE) != "true":
        return False
    os.environ.setdefault(STRATEGY, ENFORCE)
    return True


def verify_keys() -> None:
    """Join and leave the graph, so that missing or rejected keys fail at the start.

    Raises SettingsError: this enclave has no keys, or the middleware has no security.
    """
    no_services = Parameter("start_type_description_service", value=False)
    try:
        Node(
            "_hydro_keys",
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[no_services],
        ).destroy_node()
    except RuntimeError as error:
        raise key_error(error) from None


def key_error(error: RuntimeError) -> SettingsError:
    """Return ROS's error about unusable keys as one sentence."""
    said = " ".join(re.sub(r",? at /\S+:\d+", "", str(error)).split())
    keystore = os.environ.get(KEYSTORE) or "not set"
    return SettingsError(
        f"ROS does not start with keys ({KEYSTORE}: {keystore}): {said}; "
        "`ros2 run hydro_bridge create_keystore KEYSTORE` makes them, docs/manual/explanation/network.md says "
        "what else they need"
    )


VERSION = "0.2.0"


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
