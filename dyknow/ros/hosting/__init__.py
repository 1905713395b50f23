# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How the DyKnow manager starts, finds and reaches the nodelet managers of every kind."""
