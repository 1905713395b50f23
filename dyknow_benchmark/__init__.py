# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measurements of DyKnow beside its peers, each in a ROS of its own on this machine.

``rosrun dyknow benchmark chain`` is the paper's figure 4. What is compared is measured in turns in
one run, since the speed of a machine drifts.
"""
