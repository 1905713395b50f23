# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Loading and unloading: classes of nodelets, their modules, and what an unload leaves."""
