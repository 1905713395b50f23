"""Pauses grow for what dies again and again, and for nobody else."""

from __future__ import annotations

from dyknow.manager.patience import LONG_LIFE, LONGEST_PAUSE, Patience, pause


class Life:
    """Dies and comes back on a clock set by hand."""

    def __init__(self) -> None:
        self.now = 100.0
        self.patience = Patience(lambda: self.now)

    def die(self) -> float:
        """Die and return the seconds until the next attempt is allowed, which succeeds."""
        self.patience.died("/a")
        begin = self.now
        while not self.patience.allows("/a"):
            self.now += 0.125
            self.patience.died("/a")  # every look finds it dead
        self.patience.attempt("/a")
        self.patience.came_up("/a")
        return self.now - begin


def test_two_in_a_row_are_mended_at_once_and_then_the_pauses_double() -> None:
    assert [pause(attempts) for attempts in range(6)] == [0.0, 0.0, 0.25, 0.5, 1.0, 2.0]
    assert pause(1000) == LONGEST_PAUSE
    life = Life()
    assert [life.die() for _ in range(6)] == [0.0, 0.0, 0.25, 0.5, 1.0, 2.0]


def test_a_long_life_is_no_reason_to_wait_however_often_it_ends() -> None:
    life = Life()
    for _ in range(50):
        assert life.die() == 0.0
        life.now += LONG_LIFE


def test_the_pause_itself_is_not_taken_for_life() -> None:
    life = Life()
    pauses = [life.die() for _ in range(12)]
    assert pauses[-3:] == [LONGEST_PAUSE] * 3


def test_what_never_comes_up_is_not_forgiven() -> None:
    life = Life()
    for _ in range(12):
        life.patience.attempt("/a")
    life.now += LONG_LIFE
    life.patience.died("/a")
    assert not life.patience.allows("/a")
    assert life.patience.allows("/b")
