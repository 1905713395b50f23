# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""DyKnow from a shell: no node, but errors that say what to do."""
