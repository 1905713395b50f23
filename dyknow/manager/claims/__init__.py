# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request: planned, made, repaired, and collected when they are not needed.

Start with ``reconciler``; ``world`` is what all its parts read.
"""
