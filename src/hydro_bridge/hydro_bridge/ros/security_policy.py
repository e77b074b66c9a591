# SPDX-License-Identifier: Apache-2.0
"""The table of rights as a policy of SROS2, for `ros2 security` (network.md).

python -m hydro_bridge.ros.security_policy FILE
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from hydro_bridge.ros.keys import enclave_name
from hydro_bridge.ros.topics import ACCESS_RIGHTS
from hydro_core.cli.console import command, make_parser, writable_file
from hydro_core.files.atomic import write_atomic

VERSION = "0.2.0"
"""Version of the policy's format, by policy.xsd of package sros2."""


def policy_xml() -> bytes:
    """Return the policy as XML, an enclave for each executable; anything not named in it is denied."""
    policy = ElementTree.Element("policy", version=VERSION)
    enclaves = ElementTree.SubElement(policy, "enclaves")
    for executable, nodes in ACCESS_RIGHTS.items():
        enclave = ElementTree.SubElement(enclaves, "enclave", path=enclave_name(executable))
        profiles = ElementTree.SubElement(enclave, "profiles")
        for name, allowed in nodes.items():
            profile = ElementTree.SubElement(profiles, "profile", ns="/", node=name)
            for kind, what, listed in (
                ("topic", "publish", allowed.publishes),
                ("topic", "subscribe", allowed.subscribes),
                ("service", "reply", allowed.answers),
                ("service", "request", allowed.calls),
            ):
                if listed:  # the schema forbids empty lists
                    expressions = ElementTree.SubElement(profile, f"{kind}s", {what: "ALLOW"})
                    for expression in sorted(set(listed)):
                        ElementTree.SubElement(expressions, kind).text = expression
    ElementTree.indent(policy)
    return ElementTree.tostring(policy, encoding="utf-8", xml_declaration=True) + b"\n"


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("security_policy", __doc__)
    parser.add_argument("file", type=writable_file, metavar="FILE", help="to write")
    write_atomic(Path(parser.parse_args().file), policy_xml())


if __name__ == "__main__":
    main()
