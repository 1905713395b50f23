# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What nodelet_core is for C++, in Python and without ROS: bus, scheduler, handles, loader."""

from dyknow.nodelet.nodelet import Nodelet

__all__ = ["Nodelet"]
