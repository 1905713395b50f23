# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`rosrun dyknow manager`: the command line of the manager's node."""

from __future__ import annotations

import sys
from typing import Sequence

if __name__ == "__main__":
    import dyknow.interruptible  # noqa: F401
from dyknow.cli.node_help import HELP, MANAGER
from dyknow.ros.process.signals import DONE, FAILED


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node with a command line, by default the process's, and return the exit code."""
    argv = list(sys.argv if argv is None else argv)
    words = [word for word in argv[1:] if ":=" not in word]
    if HELP.intersection(words):
        print(MANAGER, end="")
        return DONE
    if words:
        print(
            f"manager: '{words[0]}' would have no effect; expected ROS's own arguments alone, "
            "such as __name:=NAME or _PARAMETER:=VALUE (see 'manager --help')",
            file=sys.stderr,
        )
        return FAILED
    import dyknow.ros.lean  # noqa: F401
    from dyknow.cli.boot import CALLS  # after --help, which needs no ROS
    from dyknow.ros.manager.manager_node import run

    return run(argv, CALLS)


if __name__ == "__main__":
    sys.exit(main())
