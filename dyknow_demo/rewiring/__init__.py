# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Frames of two cameras through a chain that is re-wired by hand; none is lost or doubled."""
