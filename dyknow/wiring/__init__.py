# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Whole wirings: saved as XML, read, compared with the running system, and loaded."""
