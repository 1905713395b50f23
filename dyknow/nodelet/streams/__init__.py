# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams inside a process: publishers, subscribers, and the bus on which they meet."""
