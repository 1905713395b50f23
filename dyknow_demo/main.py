# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line of the demonstrations: the soccer field, or with ``--rewiring`` a chain."""

from __future__ import annotations

import signal
import sys
from typing import List, Optional, Sequence

from dyknow.errors import DyKnowError

DONE, FAILED, INTERRUPTED = 0, 1, 130

_OTHER = "--rewiring"


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Run a demonstration.

    Args:
        argv: arguments without the program's name; by default those of the process.

    Returns:
        0 if it kept what it promises, 1 if it did not or something failed, 130 after Ctrl-C.
    """
    given = sys.argv[1:] if argv is None else argv
    # roslaunch and rostest append arguments of theirs, such as __name:=demo.
    arguments: List[str] = [each for each in given if ":=" not in each]
    # SIGTERM ends it as Ctrl-C does: the processes that it started end with it.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return DONE if _run(arguments) else FAILED
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return INTERRUPTED
    except DyKnowError as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return FAILED


def _run(arguments: List[str]) -> bool:
    if _OTHER in arguments:
        from dyknow_demo.rewiring import command as rewiring

        return rewiring.run([each for each in arguments if each != _OTHER])
    from dyknow_demo.soccer import command as soccer

    return soccer.run(arguments)
