# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages and remote calls: the master, services and topics, each with a time limit."""
