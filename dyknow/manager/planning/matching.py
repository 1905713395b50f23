# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Matches the parts that a plan needs with the nodelets that can be connected elsewhere."""

from __future__ import annotations

from typing import Dict, Iterable, Mapping, TypeVar

Need = TypeVar("Need")
Nodelet = TypeVar("Nodelet")


def matched(
    fitting: Mapping[Need, Iterable[Nodelet]], begun: Mapping[Need, Nodelet]
) -> dict[Need, Nodelet]:
    """Give as many needs as possible a nodelet that fits, by augmenting paths.

    H. W. Kuhn, "The Hungarian method for the assignment problem", Naval Research Logistics
    Quarterly 2, 1955.

    Args:
        fitting: the nodelets that fit each need, the preferred ones first.
        begun: a matching to begin with; needs that have a nodelet in it keep one.
    """
    found = dict(begun)
    users = {nodelet: need for need, nodelet in begun.items()}
    for need in [each for each in fitting if each not in found]:
        #: The needs that would take each nodelet.
        takers: Dict[Nodelet, Need] = {}
        waiting = [need]
        for taker in waiting:  # grows meanwhile
            left = [each for each in fitting[taker] if each not in takers]
            takers.update(dict.fromkeys(left, taker))
            unused = next((each for each in left if each not in users), None)
            if unused is None:
                waiting += [users[each] for each in left]
                continue
            path: Nodelet | None = unused
            while path is not None:  # each on the path takes the nodelet of the one before
                user = takers[path]
                before = found.get(user)
                users[path], found[user] = user, path
                path = before
            break
    return found
