# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bus over rospy: registrations, topics, and the link inside the process."""
