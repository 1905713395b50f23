# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet proxy of the paper's figure 2: ports instead of topics, re-wired while running."""

from dyknow.proxy.handle import NodeHandle
from dyknow.proxy.proxy import NodeletProxy

__all__ = ["NodeHandle", "NodeletProxy"]
