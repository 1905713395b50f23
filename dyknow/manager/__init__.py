# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager: which nodelets can run, which do run, and how they are connected.

This layer is plain Python. It imports no ROS, and it reaches nodelets only through its
injected collaborators, so all of it runs in tests without a roscore.

Four parts of it are packages of their own: ``specifications`` (of transformations), ``planning``
(the cheapest way to a stream), ``supervision`` (the life of nodelets) and ``claims`` (streams on
request, on top of everything else). The modules here are the manager itself: the graph and its
records, the library, the durable store, and the seam to the host that runs nodelets.
"""
