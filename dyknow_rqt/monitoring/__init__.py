# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window's way to the running system, or to a simulated one, and its snapshot of it."""
