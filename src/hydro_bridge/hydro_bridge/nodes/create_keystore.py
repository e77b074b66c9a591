# SPDX-License-Identifier: Apache-2.0
"""Creates an SROS2 keystore that grants each executable exactly the topics and services it uses.

ros2 run hydro_bridge create_keystore KEYSTORE          # keys and policy, for the domain of ROS_DOMAIN_ID; network.md
ros2 run hydro_bridge create_keystore --policy FILE     # the policy alone, which needs no sros2
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hydro_bridge.cli.console import UserError, command, command_line, writable, writable_folder
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.ros.keys import (
    ENABLE,
    ENFORCE,
    KEYSTORE,
    STRATEGY,
    domain,
    enclave_of,
    make_keystore,
    policy_xml,
)
from hydro_bridge.ros.topics import RIGHTS


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
