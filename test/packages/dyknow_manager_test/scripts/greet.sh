#!/bin/sh
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

# Neither rospy nor roscpp.
echo hello
