# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The graph and what stands around it: bar, menus, files, time-line, a topic's last message."""
