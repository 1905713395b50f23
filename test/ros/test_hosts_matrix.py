#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A claim over two hosts through every fault of a link or a process, watched or not."""

from __future__ import annotations

import hosts_suite
from hosts_suite import ClaimOverHosts, Split
from processes import suspended

#: Seconds for which each fault lasts, and for which its end is watched.
SECONDS = 8.0


class FaultsTest(ClaimOverHosts):
    max_silence = 0.0

    def setUp(self):
        super().setUp()
        self.with_claim(self.max_silence)

    def test_the_link_is_cut(self):
        self.loses_it(self.network.cut(self.far), SECONDS)

    def test_nothing_comes_from_there(self):
        self.loses_it(self.network.without((self.far, self.network.desk)), SECONDS)

    def test_nothing_gets_there(self):
        self.loses_it(self.network.without((self.network.desk, self.far)), SECONDS)

    def test_the_nodelet_manager_is_stopped(self):
        self.loses_it(suspended(self.far_process.pid), SECONDS)

    def test_100_ms_each_way(self):
        self.keeps_it(self.network.far(self.far, 0.1), SECONDS)

    def test_200_ms_each_way(self):
        self.keeps_it(self.network.far(self.far, 0.2), SECONDS)


class WatchedFaultsTest(FaultsTest):
    """The same for a claim whose parts must not be silent."""

    max_silence = 1.0


class SplitTest(Split):
    def test_the_newcomer_survives_though_the_manager_never_saw_the_elder(self):
        self.newcomer_survives(self.restart_time)


if __name__ == "__main__":
    hosts_suite.run("hosts_matrix")
