# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes of this machine: their programs, start and end, and the one that runs a node."""
