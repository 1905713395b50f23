# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager is killed before and after each of its effects; its promises are kept.

Lives are random, each by its number: users and clients work, and processes die. One operation is
ended at some moment; then the same manager starts again, perhaps after a reboot, and perhaps it is
killed once more while it starts.
"""

from __future__ import annotations

import collections
import random
from functools import partial
from typing import Any, Callable, Dict, Optional, Tuple

import pytest
from unit.manager.field import IMAGE, LIBRARY, SOURCES, Field, counted_ids

from dyknow.errors import DyKnowError
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter

#: Calls by which a manager changes its host and its store.
ON_HOST = ("ensure", "retire", "renew", "load", "unload", "forget", "connect", "set_parameter")
ON_DISK = ("write", "write_later", "write_pending", "end")


class Killed(BaseException):
    """The manager is killed here; nothing that it does from now on has an effect."""


class Life:
    """One life of a manager, which ends at a moment; there are two for each effect.

    Attributes:
        moments: how many have gone by.
        end: the moment at which it ends; None for never.
    """

    def __init__(self, end: Optional[int] = None) -> None:
        self.moments = 0
        self.end = end

    def go_on(self, is_moment: bool) -> None:
        """Raise if this life has ended by now, perhaps at this moment."""
        self.moments += is_moment
        if self.end is not None and self.moments >= self.end:
            raise Killed


class Mortal:
    """Stands for a host or a store as long as a life goes on."""

    def __init__(self, real: object, life: Life, effects: Tuple[str, ...]) -> None:
        self._real = real
        self._life = life
        self._effects = effects

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._real, name)
        if not callable(found):
            return found

        def call(*args: Any, **kwds: Any) -> Any:
            self._life.go_on(name in self._effects)
            result = found(*args, **kwds)
            self._life.go_on(name in self._effects)
            return result

        return call


#: Label, and whether it gets a process of its own.
KINDS = (
    ("subsampler", False),
    ("subsampler", True),
    ("native", False),
    ("native", True),
    ("program", False),
    ("script", False),
    ("script", True),
)
MORE = "".join(
    f"<transformation {kind}><label>{label}</label><source>{source}</source>"
    '<params><param name="size" type="int">3</param></params>'
    '<ports><port type="in">yuv</port><port type="out">planes</port></ports></transformation>'
    for label, kind, source in (
        ("native", "", "soccer/Native"),
        ("program", 'type="node"', "soccer/program"),
        ("script", 'type="node"', "soccer/script.py"),
    )
)
TAGS = ("YUV(field)", "RelativePosition(ball)", "FieldPosition(ball)")

Made = Tuple[str, bool, bool, Tuple[Tuple[str, str], ...], Tuple[Parameter, ...]]
"""Label, isolated, protected, topics, parameters."""


class Lives(Field):
    """A field whose manager may end at any moment, and the acknowledged changes."""

    def __init__(self, path: str, is_stock: bool) -> None:
        self.life = Life()
        ports = [("yuv", "in", IMAGE), ("planes", "out", IMAGE)]
        more = dict.fromkeys(("soccer/Native", "soccer/program", "soccer/script.py"), ports)
        super().__init__(
            path,
            {**SOURCES, **more},
            LIBRARY.replace("</transformations>", MORE + "</transformations>"),
        )
        self.host.cpp.add("soccer/Native")
        self.host.scripts.add("soccer/script.py")
        self.host.stock = is_stock
        self.promised: Dict[str, Made] = {}
        self.doubtful: Dict[str, Tuple[Optional[Made], Optional[Made]]] = {}
        self.claimed: Dict[str, str] = {}
        self.doubtful_claim: Optional[str] = None

    def seen_by_manager(self) -> Any:
        return Mortal(self.host, self.life, ON_HOST), Mortal(self.store, self.life, ON_DISK)

    def start_again(self, end: Optional[int] = None) -> None:
        """Start a new life, which may end during its start."""
        self.life = Life(end)
        self.open()

    # Users, clients and accidents

    def work(self, dice: random.Random) -> None:
        changes = [self.change_nodelet] * 5 + [self.restart_part] + [self.change_claim] * 3
        action = dice.choice([*changes, self.happen])
        action(dice)

    def change_nodelet(self, dice: random.Random) -> None:
        number = dice.randrange(len(KINDS))
        label, isolated = KINDS[number]
        name = f"/hand_{number}"
        old = self.promised.get(name)
        topics = {"yuv": dice.choice(["", "/x"]), "planes": dice.choice(["", f"{name}/own"])}
        pairs = tuple(sorted(topics.items()))
        given = (Parameter("note", "string", str(dice.randrange(9))),)
        new: Optional[Made] = (label, isolated, dice.random() < 0.3, pairs, given)
        if old is None:
            assert new is not None
            request = SpawnRequest(label, name, topics, new[2], isolated, parameters=given)
            action: Callable[[], object] = partial(self.manager.spawn, request)
        elif old[2]:
            new = (*old[:2], False, *old[3:])
            action = partial(self.manager.set_protection, name, False)
        elif dice.random() < 0.5:
            new = None
            action = partial(self.manager.destroy, name)
        elif dice.random() < 0.4:
            restarted = self.manager.graph.get(name)
            shared = dice.random() < 0.3 and not restarted.isolated
            new = old
            action = partial(self.manager.restart, restarted.manager if shared else name)
        elif dice.random() < 0.2:
            new = (*old[:4], given)
            action = partial(self.manager.set_parameter, name, given[0])
        elif self.manager.graph.get(name).is_fixed:
            return
        else:
            new = (*old[:3], pairs, old[4])
            action = partial(self.connect, name, topics)
        self.doubtful[name] = (old, new)
        try:
            action()
        except DyKnowError:
            return  # a failed change is resolved at the end, like one under way
        if new is None:
            del self.promised[name]
        else:
            self.promised[name] = new
        del self.doubtful[name]

    def restart_part(self, dice: random.Random) -> None:
        """Restart a nodelet of a claim, perhaps with another specification."""
        parts = sorted(name for each in self.living() for name in each.nodelets)
        if not parts:
            return
        name = dice.choice(parts)
        cost = dice.choice(["", ' cost="1"', ' cost="2"'])
        try:
            if dice.random() < 0.3:
                text = LIBRARY.replace(
                    "<transformation><label>sub", f"<transformation{cost}><label>sub"
                )
                self.manager.add_transformation(text)
            self.manager.restart(name)
        except DyKnowError:
            return

    def connect(self, name: str, topics: Dict[str, str]) -> None:
        self.host.connect(name, topics)
        self.manager.look()

    def change_claim(self, dice: random.Random) -> None:
        if self.claimed and dice.random() < 0.5:
            claim_id = dice.choice(sorted(self.claimed))
            tag = self.claimed.pop(claim_id)
            self.doubtful_claim = tag
            self.reconciler.release(claim_id)
        elif self.claimed and dice.random() < 0.3:
            try:
                self.reconciler.replan(dice.choice(sorted(self.claimed)))
            except DyKnowError:
                return
        else:
            self.doubtful_claim = tag = dice.choice(TAGS)
            try:
                self.claimed[self.acquire(tag).claim.claim_id] = tag
            except DyKnowError:
                return
        self.doubtful_claim = None

    def happen(self, dice: random.Random) -> None:
        processes = sorted(self.host.processes)
        if processes:
            self.host.kill(dice.choice(processes))
        for _ in range(dice.randrange(4)):
            self.tick()

    # Invariants

    def come_to_rest(self) -> None:
        """Let all be mended, and what nobody needs linger and go."""
        for _ in range(40):
            self.tick(0.5)

    def is_calm(self) -> bool:
        records = self.manager.graph.all()
        return all(each.state is State.RUNNING for each in records) and all(
            each.state is ClaimState.ACTIVE for each in self.living()
        )

    def check_all(self) -> None:
        """All that was promised is there, once, and nothing else."""
        self.come_to_rest()
        assert self.is_calm(), [(e.name, e.state, e.detail) for e in self.manager.graph.all()]
        self.check()
        records = {each.name: each for each in self.manager.graph.all()}
        found = {name: made_of(each) for name, each in records.items() if "/hand_" in name}
        for name, outcomes in self.doubtful.items():
            assert found.get(name) in outcomes, (name, outcomes)
            self.promised.pop(name, None)
            if name in found:
                self.promised[name] = found[name]
        self.doubtful.clear()
        assert found == self.promised
        living = {each.claim_id: each.request.tag for each in self.living()}
        if self.doubtful_claim is not None and len(living) > len(self.claimed):
            strange = next(each for each in living if each not in self.claimed)
            assert living[strange] == self.doubtful_claim
            self.claimed[strange] = living[strange]
        self.doubtful_claim = None
        assert living == self.claimed
        hosted = [name for each in self.host.processes.values() for name in each.nodelets]
        assert sorted(hosted) == sorted(records), "nothing is doubled, and nothing an orphan"
        needed = {name for each in self.living() for name in each.nodelets}
        assert set(records) - set(found) == needed, "no part is left over"
        alone = collections.Counter(
            each.state.isolated_for for each in self.host.processes.values()
        )
        del alone[""]
        assert alone == collections.Counter(n for n, each in records.items() if each.isolated)
        owners = {key.rpartition("/")[0] for key in self.host.parameters}
        assert owners <= set(records), "no parameter is left behind"

    def check_end(self) -> None:
        """Nothing is left once all is destroyed and released."""
        for claim_id in self.claimed:
            self.reconciler.release(claim_id)
        for name, made in self.promised.items():
            if made[2]:
                self.manager.set_protection(name, False)
            self.manager.destroy(name)
        self.come_to_rest()
        assert self.host.running == []
        assert self.host.parameters == {}
        assert not any(each.state.isolated_for for each in self.host.processes.values())
        assert [
            self.store.read(table, lambda key, text: text) for table in ("nodelets", "claims")
        ] == [{}, {}]


def made_of(record: Any) -> Made:
    topics = tuple(sorted((port.name, port.topic) for port in record.ports))
    isolated = record.isolated and record.label != "program"
    return (record.label, isolated, record.is_protected, topics, record.parameters)


def live(path: str, number: int, end: Optional[int]) -> int:
    """Live one life; returns how many moments it had. It ends at one of them, or never."""
    dice = random.Random(number)
    lives = Lives(path, is_stock=number % 2 == 1)
    lives.life.end = end
    try:
        for _ in range(8):
            lives.work(dice)
            lives.tick()
    except Killed:
        pass
    moments = lives.life.moments
    dice = random.Random(f"{number} {end}")
    if dice.random() < 0.4:
        lives.host.reboot()
    for _ in range(2):
        if dice.random() < 0.4:
            with pytest.raises(Killed):
                lives.start_again(dice.randrange(1, 30))
                for _ in range(60):
                    lives.tick(0.5)
                raise Killed  # it was over before
    lives.start_again()
    lives.check_all()
    lives.check_end()
    lives.store.close()
    return moments


def check(path: str, number: int, every: int) -> None:
    """Live one life again and again, until each ``every``-th moment has been its end."""
    with counted_ids():
        moments = live(path + "-whole", number, None)
        for end in range(1 + number % every, moments + 1, every):
            try:
                live(f"{path}-{end}", number, end)
            except BaseException:
                print(f"life {number}, ended at moment {end} of {moments}")
                raise


@pytest.mark.parametrize("number", range(10))
def test_a_life_that_ends_at_any_moment_is_gone_on_with(tmp_path: Any, number: int) -> None:
    check(str(tmp_path / "state"), number, 20)


@pytest.mark.long
@pytest.mark.parametrize("number", range(10, 60))
def test_many_lives_that_end_at_each_moment_are_gone_on_with(tmp_path: Any, number: int) -> None:
    check(str(tmp_path / "state"), number, 2)
