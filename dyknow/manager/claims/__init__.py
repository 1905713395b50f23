# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request: planned, made, repaired, and collected when they are not needed.

* ``reconciler``: the requests of clients, and the rounds; ``answers`` words the replies.
* ``claim_table``: the claims, in memory and on disk.
* ``world``: what all parts read, an immutable value; ``ends`` reads one nodelet for it.
* ``claim_planner``: plans in that world, and chooses nodelets for steps of plans.
* ``assembly``: carries a plan out, through ``connector``.
* ``repair`` and ``garbage_collector``: the two halves of a round.
* ``judgements``: the health of streams, by the counts of ``flows``, the ``limits`` of claims and
  the verdicts of ``requirements``.
"""
