# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds that speak the protocol of bondpy, with one thread for all of them."""
