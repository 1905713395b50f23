# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages for monitors of formulas: their types, live topics, bags, and individuals."""
