# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from dyknow.testing.fixtures import nodelet_harness

__all__ = ["nodelet_harness"]
