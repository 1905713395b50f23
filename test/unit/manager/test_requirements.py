# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Verdicts that decide which parts are used, and whether a stream is good enough."""

from __future__ import annotations

import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable, Collection, Dict, List, Sequence

import pytest
from charged_robot import CHARGED, FORMULAS
from unit.manager.field import CHAIN, LIBRARY, POINT, SOURCES, Field, topic, transformation

from dyknow.errors import BadParameter, FormulaError, NoPlanFound
from dyknow.formulas import Truth, parse
from dyknow.manager.claim import Claim
from dyknow.manager.claims.requirements import CLIENT, is_own
from dyknow.manager.host import HeardVerdict
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import VERDICT


def requiring(label: str, *tags: str, initially: bool = True, library: str = LIBRARY) -> str:
    """The specification of the library with a label that requires verdicts."""
    lines = library.split("</transformation>")
    at = next(n for n, each in enumerate(lines) if f"<label>{label}</label>" in each)
    attribute = "" if initially else ' initially="false"'
    lines[at] += "".join(f"<requires{attribute}>{tag}</requires>" for tag in tags)
    return "</transformation>".join(lines)


@pytest.fixture
def field(tmp_path: Path) -> Field:
    field = Field(str(tmp_path / "state.db"))
    field.host.topics.add("/battery")
    field.manager.add_transformation(FORMULAS)
    field.manager.add_transformation(requiring("bottom camera", CHARGED))
    return field


def own(field: Field) -> Dict[str, Claim]:
    """The manager's own claims, by tag."""
    return {each.request.tag: each for each in field.living() if is_own(each)}


def required(field: Field, tag: str = CHARGED) -> str:
    """The topic of the verdicts that a part requires."""
    return own(field)[tag].topic


def decide(field: Field, topic: str, is_true: bool, seconds: float = 1.0) -> None:
    """Let a verdict come, and time pass."""
    field.host.decide(topic, is_true)
    field.settle(seconds)


def cameras(field: Field) -> List[str]:
    return [label for label in field.labels() if label.endswith("camera")]


# Required verdicts


def test_a_part_whose_verdict_is_false_is_replaced_and_may_come_back_later(field: Field) -> None:
    claim = field.acquire().claim
    field.settle()
    assert cameras(field) == ["bottom camera"]
    decide(field, required(field), True)
    field.host.decide(required(field), False, "battery.percentage = 0.19")
    before = field.now
    field.tick()
    mended = field.claim(claim.claim_id)
    assert mended.state is ClaimState.ACTIVE and mended.topic == claim.topic
    assert field.mended() == [
        "mended: /bottom_camera_1 is not available: Holds(charged, nao) is FALSE since "
        f"{before:.3f} (battery.percentage = 0.19); /ceiling_camera_1 is used now"
    ]
    field.tidy()
    assert cameras(field) == ["ceiling camera"]
    assert claim.topic in field.moving
    assert not any("sent nothing" in each for each in field.reasons()), "before the old one went"

    field.host.decide(required(field), True)
    field.tick(1.9)
    assert field.reconciler.replan(claim.claim_id, dry_run=True).spawned == ()
    field.settle(10.0)
    news = [reason for reason in field.reasons() if "cheaper" in reason]
    assert news == [f"a cheaper way has appeared, with {', '.join(CHAIN)}; replanning takes it"]
    assert cameras(field) == ["ceiling camera"], "nothing comes back by itself"
    field.reconciler.replan(claim.claim_id)
    field.tidy()
    assert cameras(field) == ["bottom camera"]


def test_claims_on_verdicts_end_with_the_claims_that_may_need_them(field: Field) -> None:
    assert own(field) == {}
    claims = [field.acquire().claim, field.acquire("Planes(field)").claim]
    field.settle()
    (verdicts,) = own(field).values()
    assert (verdicts.request.tag, verdicts.request.client_id) == (CHARGED, CLIENT)
    assert (verdicts.datatype, verdicts.state) == (VERDICT, ClaimState.ACTIVE)
    assert field.host.followed == {verdicts.topic}
    field.reconciler.release(claims[0].claim_id)
    field.settle()
    assert own(field) == {CHARGED: field.claim(verdicts.claim_id)}
    field.reconciler.release(claims[1].claim_id)
    field.tidy()
    assert own(field) == {} and field.labels() == [] and field.host.followed == frozenset()


def test_a_claim_that_cannot_depend_on_a_verdict_holds_none(field: Field) -> None:
    field.acquire("Battery(nao)")
    field.acquire(exclude=("bottom camera",))
    field.settle()
    assert own(field) == {}


def test_verdicts_may_depend_on_verdicts(field: Field) -> None:
    field.manager.add_transformation(
        FORMULAS.replace("<formula>", "<requires>Awake(?robot)</requires><formula>")
    )
    field.acquire()
    field.settle()
    assert {*own(field)} == {CHARGED, "Awake(nao)"}
    assert own(field)["Awake(nao)"].state is ClaimState.PENDING, "nothing supplies it"


def test_an_acquire_while_it_is_false_uses_something_else(field: Field) -> None:
    field.acquire("Planes(field)")
    field.settle()
    decide(field, required(field), False, 20.0)
    field.acquire()
    assert cameras(field) == ["ceiling camera"]
    field.manager.remove_transformation("ceiling camera")
    field.settle()
    refused = "bottom camera is not available: Holds\\(charged, nao\\) is FALSE since"
    with pytest.raises(NoPlanFound, match=refused):
        field.acquire("YUV(field)")


@pytest.mark.parametrize("initially", [True, False])
def test_before_the_first_verdict(field: Field, initially: bool) -> None:
    field.manager.add_transformation(requiring("bottom camera", CHARGED, initially=initially))
    field.manager.remove_transformation("ceiling camera")
    if initially:
        field.acquire()
        assert cameras(field) == ["bottom camera"]
        return
    with pytest.raises(NoPlanFound, match="Holds\\(charged, nao\\) has no verdict yet"):
        field.acquire()
    field.settle()
    assert cameras(field) == []
    decide(field, required(field), True)
    assert cameras(field) == ["bottom camera"], "at once: it was never FALSE"


@pytest.mark.parametrize("label", ["bottom camera", "joints"])
def test_without_anything_else_the_stream_goes_on_degraded(field: Field, label: str) -> None:
    """Not only a nodelet, but a topic too may require a verdict."""
    field.manager.add_transformation(requiring(label, CHARGED))
    field.manager.remove_transformation("ceiling camera")
    claim = field.acquire().claim
    field.settle()
    decide(field, required(field), False)
    degraded = field.claim(claim.claim_id)
    assert degraded.state is ClaimState.DEGRADED
    assert "is not available: Holds(charged, nao) is FALSE" in degraded.detail
    assert claim.topic in field.moving
    decide(field, required(field), True)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    field.settle(2.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_only_the_individual_that_a_verdict_is_about_is_concerned() -> None:
    field = Field(
        sources={**SOURCES, "soccer/Seer": [("eye", "in", POINT), ("seen", "out", POINT)]},
        library=transformation(
            "seer", "soccer/Seer", "in eye, out seen", "eye Eye(?robot); seen Seen(?robot)"
        ).replace("</tags>", "</tags><requires>Holds(charged, ?robot)</requires>"),
    )
    for robot in ("nao", "pepper"):
        eye = topic(f"eye of {robot}", f"/{robot}/eye", f"Eye({robot})")
        field.manager.add_transformation(eye)
        field.host.topics |= {f"/{robot}/eye", f"/{robot}/battery"}
        field.manager.add_transformation(
            FORMULAS.replace("(nao)", f"({robot})")
            .replace("<label>battery", f"<label>battery of {robot}")
            .replace("/battery<", f"/{robot}/battery<")
        )
    claims = {robot: field.acquire(f"Seen({robot})").claim for robot in ("nao", "pepper")}
    either = field.acquire("Seen(?robot)").claim
    field.settle()
    assert {*own(field)} == {"Holds(charged, nao)", "Holds(charged, pepper)"}
    assert dict(field.claim(either.claim_id).bindings) == {"?robot": "nao"}
    decide(field, required(field), False)
    assert field.state(claims["nao"].claim_id) is ClaimState.DEGRADED
    assert field.state(claims["pepper"].claim_id) is ClaimState.ACTIVE
    assert dict(field.claim(either.claim_id).bindings) == {"?robot": "pepper"}


@pytest.mark.parametrize("minutes", [2, pytest.param(10, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("formula", "each_minute"),
    [
        ("battery.percentage > 0.2", 30.0),
        ("historically[0 s, 5 s] battery.percentage > 0.2", 0.0),
    ],
)
def test_noise_around_a_threshold(
    field: Field, formula: str, each_minute: float, minutes: int
) -> None:
    """A client takes the cheaper way each second: replacements are as rare as `recover` says."""
    dice = random.Random(5)
    monitor = parse(formula).monitor(period=0.1, hold=2.0)
    claim = field.acquire().claim
    field.settle()
    for step in range(300 * minutes):
        message = SimpleNamespace(percentage=dice.gauss(0.22, 0.03))
        for verdict in monitor.feed("battery", message, field.now):
            if verdict.value != Truth.UNKNOWN:
                field.host.decide(required(field), verdict.value == Truth.TRUE, verdict.why)
        field.tick(0.2)
        if step % 5 == 0:
            field.reconciler.replan(claim.claim_id)
    gone = [
        event
        for event in field.events
        if event.after.claim_id == claim.claim_id and event.reason.startswith("mended")
    ]
    assert 1 <= len(gone) <= max(1, each_minute * minutes)


def test_verdicts_are_heard_again_after_a_restart(field: Field) -> None:
    claim = field.acquire().claim
    field.settle()
    field.kill_manager()
    field.settle()
    assert [*own(field)] == [CHARGED]
    decide(field, required(field), False)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.tidy()
    assert cameras(field) == ["ceiling camera"]


def absent(field: Field) -> None:
    """Let no claim need the verdict for a moment, since another input is away."""
    field.host.topics.discard("/joint_states")
    field.settle()
    assert own(field) == {}
    field.host.topics.add("/joint_states")


def released(field: Field) -> None:
    field.reconciler.release(own(field)[CHARGED].claim_id)


def killed(field: Field) -> None:
    field.host.verdicts(())  # those that it heard are lost
    field.kill_manager()


@pytest.mark.parametrize("forget", [absent, released, killed])
def test_false_counts_until_the_verdict_has_been_true(
    field: Field, forget: Callable[[Field], None]
) -> None:
    claim = field.acquire().claim
    field.settle()
    decide(field, required(field), False, 30.0)

    def spawned() -> Sequence[str]:
        """What a claim would use that is cheaper."""
        return field.reconciler.replan(claim.claim_id, dry_run=True).spawned

    forget(field)
    for _ in range(20):
        assert field.reconciler.acquire(StreamRequest("YUV(field)"), dry_run=True).spawned == ()
        field.tick()
    assert spawned() == ()
    field.host.decide(required(field), True)
    field.tick(1.9)
    assert spawned() == ()
    field.tick(0.2)
    assert spawned() == ("bottom camera",)


def test_false_is_forgotten_with_the_claims_that_could_depend_on_it(field: Field) -> None:
    """A client that does not wait would be refused for ever: no claim listens."""
    field.manager.remove_transformation("ceiling camera")
    field.acquire("Battery(nao)")
    claim = field.acquire().claim
    field.settle()
    decide(field, required(field), False)
    field.reconciler.release(claim.claim_id)
    field.kill_manager()
    field.tidy()
    assert own(field) == field.store.bad_verdicts() == {}
    field.acquire()
    assert cameras(field) == ["bottom camera"]


@pytest.mark.parametrize("initially", [True, False])
@pytest.mark.parametrize(
    "eye",
    [
        transformation("eye", "soccer/Camera", "out image", "image Eye(left)"),
        topic("eye", "/eye", "Eye(left)"),
    ],
    ids=["nodelet", "topic"],
)
def test_bindings_are_found_whatever_the_verdicts_are(
    field: Field, eye: str, initially: bool
) -> None:
    """A claim on the stream of each is necessary to hear its verdict."""
    field.host.topics.add("/eye")
    field.manager.add_transformation(requiring("eye", CHARGED, initially=initially, library=eye))
    found = [(("?which", "left"),)], True
    assert field.reconciler.find_bindings("Eye(?which)") == found
    field.acquire("Planes(field)")
    field.settle()
    for is_true in (False, True):
        decide(field, required(field), is_true, 5.0)
        assert field.reconciler.find_bindings("Eye(?which)") == found


CALM = "Holds(calm, nao)"


def heard_one_by_one(field: Field, monkeypatch: pytest.MonkeyPatch, first: str) -> None:
    """Let a restarted manager hear nothing in its first round, and then one verdict alone."""
    topic, listen = required(field, first), field.host.verdicts
    rounds = iter([set(), {topic}])
    field.kill_manager()

    def heard(topics: Collection[str]) -> Dict[str, HeardVerdict]:
        some = next(rounds, topics)
        return {each: verdict for each, verdict in listen(topics).items() if each in some}

    monkeypatch.setattr(field.host, "verdicts", heard)


@pytest.mark.parametrize("first", [CHARGED, CALM])
@pytest.mark.parametrize("label", ["detector", "joints"])
def test_a_part_in_use_is_kept_until_its_verdict_is_heard_again(
    field: Field, monkeypatch: pytest.MonkeyPatch, label: str, first: str
) -> None:
    field.manager.add_transformation(FORMULAS.replace("charged", "calm"))
    library = requiring("bottom camera", CHARGED, initially=False)
    field.manager.add_transformation(requiring(label, CALM, initially=False, library=library))
    with pytest.raises(NoPlanFound) as refused:
        field.acquire()
    field.settle()
    for tag in (CHARGED, CALM):
        field.host.decide(required(field, tag), True)
    field.settle(5.0)
    claim = field.claim(refused.value.claim_id)
    assert claim.state is ClaimState.ACTIVE and cameras(field) == ["bottom camera"]
    heard_one_by_one(field, monkeypatch, first)
    for _ in range(6):
        field.tick()
        assert field.claim(claim.claim_id) == claim
    assert field.reasons() == []
    decide(field, required(field), False)
    assert "/ceiling_camera_1" in field.claim(claim.claim_id).nodelets


@pytest.mark.parametrize("is_other_known", [True, False])
def test_a_topic_waits_for_its_first_verdict(field: Field, is_other_known: bool) -> None:
    """Whether another verdict is known or not."""
    if is_other_known:
        field.acquire("Planes(field)")
        field.settle()
        decide(field, required(field), True)
    field.manager.add_transformation(FORMULAS.replace("charged", "calm"))
    library = requiring("bottom camera", CHARGED)
    field.manager.add_transformation(requiring("joints", CALM, initially=False, library=library))
    with pytest.raises(NoPlanFound) as refused:
        field.acquire()
    why = f"topic /joint_states is not available: {CALM}"
    assert f"{why} has no verdict yet" in str(refused.value)
    field.settle()
    waiting = field.claim(refused.value.claim_id)
    assert waiting.state is ClaimState.PENDING and f"{why} has no verdict" in waiting.detail
    decide(field, required(field, CALM), False)
    assert f"{why} is FALSE since" in field.claim(waiting.claim_id).detail
    decide(field, required(field, CALM), True, 5.0)
    assert field.state(refused.value.claim_id) is ClaimState.ACTIVE


# Formulas of requests

NEAR = "it.point.x < 3"


def monitored(field: Field, claim: Claim) -> str:
    """The topic of the verdicts about a claim's stream, whose nodelet is wired to it."""
    now = field.claim(claim.claim_id)
    assert now.wiring[now.monitor]["it"] == claim.topic
    return now.wiring[now.monitor]["holds"]


def test_a_stream_whose_formula_is_false_goes_on_without_one_of_its_parts(field: Field) -> None:
    claim = field.acquire(require=NEAR).claim
    field.settle()
    first = monitored(field, claim)
    decide(field, first, True)
    field.host.decide(first, False, "it.point.x = 4")
    before = field.now
    field.tick()
    assert field.mended() == [
        f"mended: 'it.point.x < 3' is FALSE since {before:.3f} (it.point.x = 4); "
        "/ceiling_camera_1, /monitor_of_position_2 are used now".replace(
            "position", claim.topic.strip("/").replace("/", "_")
        )
    ]
    field.tidy()
    assert cameras(field) == ["ceiling camera"]
    second = monitored(field, claim)
    assert second != first, "its verdicts know nothing of the earlier stream"
    decide(field, second, True, 5.0)
    assert len(field.living()) == 1 + len(own(field))


def test_a_formula_that_turned_false_in_a_repair_counts_if_it_stays_false(field: Field) -> None:
    claim = field.acquire(require=NEAR).claim
    field.settle()
    topic = monitored(field, claim)
    decide(field, topic, True)

    def turn_false(what: str, argument: str) -> None:
        if what == "load":
            field.host.decide(topic, False)
            field.sleep(0.01)

    field.host.fail = turn_false
    field.host.kill(field.manager.graph.get(claim.nodelets[0]).manager)
    field.settle()
    field.host.recover()
    assert monitored(field, claim) == topic
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    decide(field, topic, False)
    assert not [each for each in field.reasons() if "FALSE" in each], "of the earlier stream yet"
    field.settle(3.0)
    decide(field, topic, False)
    assert [each for each in field.reasons() if "'it.point.x < 3' is FALSE" in each]


def test_without_another_plan_a_false_formula_degrades_the_stream(field: Field) -> None:
    field.manager.remove_transformation("ceiling camera")
    claim = field.acquire(require=NEAR).claim
    field.settle()
    events = len(field.events)
    decide(field, monitored(field, claim), False, 5.0)
    degraded = field.claim(claim.claim_id)
    assert degraded.state is ClaimState.DEGRADED
    assert degraded.detail.startswith("'it.point.x < 3' is FALSE")
    assert "no part of it can be replaced" in degraded.detail
    assert len(field.events) == events + 1
    decide(field, monitored(field, claim), True)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_a_formula_that_is_false_of_everything_does_not_flap(field: Field) -> None:
    claim = field.acquire(require=NEAR).claim
    for _ in range(240):
        field.tick(0.5)
        field.host.decide(monitored(field, claim), False)
    assert 1 <= len(field.mended()) <= 8, "each pause is twice the one before"


def test_messages_that_are_stamped_long_before_they_arrive_are_judged(field: Field) -> None:
    claim = field.acquire(require="rate(it) > 5").claim
    name = field.claim(claim.claim_id).monitor
    delay: Any = field.host.parameters[f"{name}/delay"]
    monitor = parse("rate(it) > 5").monitor(delay=delay)
    stamped = [SimpleNamespace(header=SimpleNamespace(stamp=each / 10)) for each in range(1, 61)]
    verdicts = [v for each in stamped for v in monitor.feed("it", each, each.header.stamp + 0.25)]
    assert verdicts[-1].value is Truth.TRUE and monitor.late == 0


def test_a_monitor_that_dies_is_made_again(field: Field) -> None:
    claim = field.acquire(require=NEAR).claim
    field.settle()
    name = field.claim(claim.claim_id).monitor
    field.destroy_by_hand(name)
    field.settle()
    assert monitored(field, claim) in {f"{each}/holds" for each in field.host.running}
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.labels() == []


def test_a_monitor_is_no_silent_part(field: Field) -> None:
    claim = field.acquire(require=NEAR, max_silence=1.0).claim
    field.settle()
    field.host.silent.add(field.claim(claim.claim_id).monitor)
    field.settle(10.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.mended() == []


def test_clients_share_a_topic_if_they_require_the_same(field: Field) -> None:
    topics = [
        field.acquire(require=require).claim.topic for require in ("", NEAR, NEAR, "present(it)")
    ]
    assert topics[1] == topics[2] and len({*topics}) == 3


@pytest.mark.parametrize(
    ("require", "error", "text"),
    [
        ("it.point.x <", FormulaError, "expected"),
        ("other.point.x < 3", BadParameter, "reads 'it' alone"),
        ("1 < 2", FormulaError, "reads no port"),
        ("every ?c (it.data < 0.05)", BadParameter, "without 'every' and 'some'.*individuals ?"),
        ("present(it) and some ?c (it.data < 1)", BadParameter, "without 'every' and 'some'"),
    ],
)
def test_refused_formulas(field: Field, require: str, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        field.acquire(require=require)
    assert field.living() == []
