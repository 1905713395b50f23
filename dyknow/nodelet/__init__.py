# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The runtime of nodelets, as nodelet_core is for C++, in Python and without ROS."""

from dyknow.nodelet.handle import Nodelet

__all__ = ["Nodelet"]
