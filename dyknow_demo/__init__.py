# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration: camera frames through a chain of nodelets that is re-wired while it runs."""
