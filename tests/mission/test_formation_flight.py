"""Formation flight without anything around it: points that do at once what they are told, and what ends a step."""

from __future__ import annotations

import json

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight import guidance
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.failsafe import first_roles
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.roster import enlist
from groundstation.mission.verdict import Figures

CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
TICK_NS = 20_000_000
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


class Team:
    """Eight points, or four, in formation flight."""

    def __init__(self, *changes: str, roles: bool = True) -> None:
        self.plan = load_mission(CUBE8, changes)
        self.figures, self.texts = Figures(), list[str]()
        self.roster = enlist(self.plan)
        self.flight = FormationFlight(
            self.plan,
            self.roster,
            Helm(Guide(self.plan), self.plan.size),
            self.figures,
            lambda kind, text, given: self.texts.append(text),
        )
        if roles:
            self.flight.assign(first_roles(self.plan))
        self.pos: FloatArray = self.flight.gather_ned_m.copy()
        self.vel: FloatArray = np.zeros_like(self.pos)
        self.now_ns = 0
        self.nobody: BoolArray = np.zeros(self.plan.size, dtype=np.bool_)
        self.flight.next_step(0, self.poses())

    def poses(self) -> Poses:
        return Poses(self.pos, self.vel, np.tile(LEVEL, (self.plan.size, 1)), self.nobody)

    def leave(self, vehicles: list[int]) -> str:
        """Some drop out; returns why the others cannot go on."""
        self.roster.release(vehicles)
        return self.flight.close_up(0)

    def ends(self, limit_s: float = 60.0, *, absent: BoolArray | None = None, follow: bool = True) -> str:
        """Flies on until something follows; returns the phase, or why it cannot go on."""
        for _ in range(round(limit_s / 0.02)):
            tick = self.flight.step(self.now_ns, self.poses(), absent)
            if tick.give_up or tick.follows is not None:
                return tick.give_up or (tick.follows.value if tick.follows else "")
            if follow:
                self.vel = tick.vel_ned_m_s
                self.pos = self.pos + 0.02 * self.vel
            self.now_ns += TICK_NS
        return "nothing"


def test_points_form_hold_and_come_back() -> None:
    team = Team("steps.1.hold.seconds=1")
    assert team.ends() == "hold"
    assert 1.0 < team.figures.time_to_form_s < 15.0
    assert team.ends() == "return"
    assert team.figures.converged


def test_nobody_flies_without_roles() -> None:
    with pytest.raises(RuntimeError, match="without roles"):
        Team(roles=False).ends()


def test_a_team_that_does_not_form_in_its_time_gives_up() -> None:
    team = Team("steps.0.form.timeout_s=2")
    ended = team.ends(follow=False)
    assert isinstance(ended, str)
    assert ended.startswith("not formed after 2 s: a distance is ")


def test_a_team_that_formed_on_its_head_is_told_so_and_not_that_a_distance_is_infinite() -> None:
    """All distances are right then. On 1719c84: "a distance is inf m off"."""
    team = Team("steps.0.form.timeout_s=2")
    points = team.plan.formation.points_enu_m[team.flight.role_of_agent]
    team.pos = points[:, [1, 0, 2]]  # NED from ENU would turn the heights as well
    assert team.flight.error_m(team.pos) < 1e-9
    words = "not formed after 2 s: the team stands upside down (set upright_1_s or takeoff.stagger_m)"
    assert team.ends(follow=False) == words
    team.pos = 1.1 * team.pos
    assert "upside down (set upright_1_s or takeoff.stagger_m), and a distance is " in str(team.ends(follow=False))


@pytest.mark.parametrize(
    ("changes", "lost", "words"),
    [
        (("steps=[form: {}, move: {turn_deg: 20}]",), [0], "a mission of several formations, or with moves"),
        ((), [0, 1, 2, 3], "4 of 8 vehicles are left in the formation, which needs more than half"),
    ],
)
def test_a_team_that_cannot_go_on_without_some_says_why(changes: tuple[str, ...], lost: list[int], words: str) -> None:
    team = Team("on_lost=continue_open", *changes)
    assert words in team.leave(lost)


def test_a_graph_that_those_left_do_not_hold_together_is_no_formation(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_given: object) -> None:
        raise ValueError("falls into two")

    team = Team("on_lost=continue_open")
    monkeypatch.setattr("groundstation.mission.flight.formation_flight.task_for_those_left", broken)
    assert team.leave([3]) == "falls into two"


def test_the_first_roles_are_filled_up_from_the_last() -> None:
    team = Team("on_lost=continue_take_over")
    before = team.flight.role_of_agent.copy()
    first, last = (int(np.flatnonzero(before == role)[0]) for role in (0, 7))
    assert team.leave([first]) == ""
    assert team.flight.role_of_agent[last] == 0
    assert team.figures.role_swaps == 1
    roles = team.flight.role_of_agent
    assert team.leave([int(np.flatnonzero(roles == 6)[0])]) == ""  # the last that is taken: nobody moves up
    assert team.figures.role_swaps == 1
    assert team.ends() == "hold"


MOVE = "steps=[form: {{}}, move: {{{}}}]"


def test_a_move_turns_grows_and_is_told() -> None:
    team = Team(MOVE.format("by_m: [0.2, 0, 0.2], turn_deg: 30, scale: 1.2"))
    assert team.ends() == "move"
    assert team.ends() == "return"
    assert "the middle of the team has moved by" in team.texts[-1]
    assert any("scale changing" in text for text in team.texts)
    assert any("scale 1.2" in text for text in team.texts)
    assert team.flight.error_m(team.pos) < 0.05


def test_a_move_that_only_moves_is_told_without_a_size() -> None:
    team = Team(MOVE.format("by_m: [0.2, 0, 0]"))
    assert team.ends() == "move"
    assert team.ends() == "return"
    assert "told were 0.20 0.00 0.00 m" in team.texts[-1]
    assert not any("scale changing" in text for text in team.texts)


def test_a_move_that_would_leave_the_fence_from_here_does_not_begin() -> None:
    team = Team(MOVE.format("by_m: [0, 0, 0.6]"))
    assert team.ends() == "move"
    team.pos = team.pos - [0.0, 0.0, 1.3]  # where plan and start put it, it would have had room
    assert str(team.ends()).startswith("move not begun: it would take vehicle ")


def test_a_move_waits_for_one_that_does_not_follow_and_gives_up_in_the_end() -> None:
    team = Team(MOVE.format("by_m: [0.4, 0, 0], seconds: 4"))
    assert team.ends() == "move"
    absent = team.nobody.copy()
    absent[2] = True
    ended = team.ends(absent=absent)
    assert ended == "move not finished: 0 % of the way done, a vehicle does not follow"


def test_a_formation_that_is_torn_while_it_moves_is_lost() -> None:
    team = Team(MOVE.format("by_m: [0.4, 0, 0], seconds: 4"))
    assert team.ends() == "move"
    team.pos[0] += [0.4, 0.0, 0.0]
    assert str(team.ends(follow=False)).startswith("formation lost while moving: a distance is ")


def test_a_wall_holds_up_a_move() -> None:
    team = Team(MOVE.format("by_m: [0.4, 0, 0], seconds: 4"), "keep_place_1_s=0")
    assert team.ends() == "move"
    assert team.ends(1.0) == "nothing"
    team.pos[:, 1] += 2.98 - team.pos[:, 1].max()  # blown there, as one
    ended = str(team.ends())
    assert ended.startswith("move not finished: ")
    assert ended.endswith("the fence is in the way")


def test_large_teams_form_the_same_without_a_view_of_everybody_by_everybody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the law is shown smoothed places, as it always is."""
    configs, rng = packaged_configs(), np.random.default_rng(5)
    pads = [[east, north, 0.0] for east in range(8) for north in range(8)]
    vehicles = [{"id": k + 1, "link": "udpin://127.0.0.1:14540", "pad_m": pad} for k, pad in enumerate(pads)]
    team = Team(
        f"formation={configs / 'formations' / 'grid64.yaml'}",
        f"gains={configs / 'gains' / 'grid64.npz'}",
        f"vehicles={json.dumps(vehicles)}",
        "fence={min_m: [-9, -9, 0], max_m: [16, 16, 20]}",
        "steps.0.form.tolerance_m=0.15",
        "failsafe={action: hold}",
    )
    team.pos = team.pos + rng.normal(scale=0.1, size=team.pos.shape)
    team.vel = rng.normal(scale=0.1, size=team.vel.shape)
    poses = team.poses()
    told = {}
    for square in (False, True):
        if square:
            monkeypatch.setattr(guidance, "_MANY", 65)
        else:
            monkeypatch.setattr(guidance, "local_views", None)
        flight = FormationFlight(
            team.plan, enlist(team.plan), Helm(Guide(team.plan), 64), Figures(), lambda kind, text, given: None
        )
        flight.assign(first_roles(team.plan))
        flight.next_step(0, poses)
        told[square] = flight.step(0, poses).vel_ned_m_s
        monkeypatch.undo()
    assert np.linalg.norm(told[True], axis=1).max() > 0.01
    np.testing.assert_allclose(told[False], told[True], atol=1e-9)
