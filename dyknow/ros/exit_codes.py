"""How the processes of `nodelet` end: with the exit codes of nodelet_core."""

DONE = 0
"""Done, stopped on request, or no longer needed because the bond broke."""

FAILED = 255
"""Something was refused or is wrong; nodelet_core returns -1."""

INTERRUPTED = 130
"""Stopped before it could do what it was asked for; as a shell shows for SIGINT."""
