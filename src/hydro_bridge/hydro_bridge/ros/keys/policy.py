# SPDX-License-Identifier: Apache-2.0
"""Table of rights as an SROS2 policy (version 0.2.0, policy.xsd of package sros2), one enclave per executable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.etree import ElementTree

from hydro_bridge.ros.keys.rights import RIGHTS, Rights, enclave_of

VERSION = "0.2.0"


def policy_xml(rights: Mapping[str, Mapping[str, Rights]] = RIGHTS) -> bytes:
    """Return the policy as XML; anything not named in it is denied."""
    policy = ElementTree.Element("policy", version=VERSION)
    enclaves = ElementTree.SubElement(policy, "enclaves")
    for executable, nodes in rights.items():
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
