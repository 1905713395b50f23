# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Exit codes of the processes of `nodelet`: those of nodelet_core."""

DONE = 0
"""Done, stopped on request, or no longer needed because the bond broke."""

FAILED = 255
"""A request was refused, or an argument is wrong; nodelet_core returns -1."""

INTERRUPTED = 130
"""Stopped before it could do what it was asked for; as a shell shows for SIGINT."""
