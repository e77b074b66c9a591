# SPDX-License-Identifier: Apache-2.0
"""`ros2 launch` for launch files as simple as ours.

`description` is what such a file is written in, under upstream's names; `modules` puts these names where the file looks
for them; `processes` starts what it describes and ends it; `verb` is the command.
"""
