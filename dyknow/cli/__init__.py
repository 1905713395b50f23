# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command lines of `rosrun dyknow ...`; the layers below do the work."""
