# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measurements of DyKnow and its peers, each with a ROS master of its own on this machine.

``rosrun dyknow benchmark chain`` is the paper's figure 4. Variants that are compared are measured
in turns in one run, since a machine's speed drifts.
"""
