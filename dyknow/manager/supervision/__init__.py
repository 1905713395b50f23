# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Supervision of nodelets: spawned, observed, restored, restarted and moved."""
