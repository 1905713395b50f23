# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The demonstration: ``story``, on the field of the case study ``soccer``."""
