"""Comings and goings: who enters the plan, parks, leaves a bay, and leaves the plan."""

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.crowd import Crowd
from geoaim.synthetic.traffic.demand import Driver, Walker
from geoaim.synthetic.traffic.fleet import NOSE, TAIL, Fleet, Rules

REST = 100.0  # s, mean time that a vehicle stands in a bay
ROOM = 5.0  # m between a vehicle that enters and the one before it, and more at speed
AT_REST = 0.05  # m before the end of its way where a vehicle in a bay stands
OUT = 30.0  # m from its bay, where a vehicle leaves it free
RADIUS = {"pedestrian": 0.25, "cyclist": 0.4}  # m
Moment = TypeVar("Moment", Fleet, Crowd)


def enter(fleet: Fleet, rules: Rules, driver: Driver, number: int) -> Fleet:
    """The fleet with a driver at the start of his way; the same fleet while there is no room.

    Who finds his bay taken drives on.
    """
    way = driver.way
    if rules.bay[way] >= 0 and _is_taken(fleet, rules, int(rules.bay[way])):
        way = int(np.argmax((rules.entry == rules.entry[way]) & (rules.bay < 0)))
    same = rules.entry[fleet.way] == rules.entry[way]
    speed = driver.pace * float(rules.wish[way, 0])
    if same.any():
        tails = fleet.at[same] - TAIL * fleet.length[same]
        room = float(tails.min()) - NOSE * driver.size[0]
        ahead = float(fleet.speed[same][np.argmin(tails)])
        if room < ROOM + 0.5 * ahead:
            return fleet
        speed = min(speed, ahead + 0.15 * room)
    return join(fleet, vehicle(driver, number, way=way, speed=speed))


def vehicle(
    driver: Driver,
    number: int,
    *,
    way: int,
    at: float = 0.0,
    speed: float = 0.0,
    leaves: float = np.inf,
) -> Fleet:
    """A fleet of one."""
    values = (at, speed, 0.0, driver.size[0], driver.pace, driver.headway, leaves)
    return Fleet(np.array([number]), np.array([way]), *(np.array([value]) for value in values))


def park(fleet: Fleet, rules: Rules, clock: float, generator: np.random.Generator) -> Fleet:
    """Those who have come to the end of a way into a bay stay there for a while."""
    finish = rules.finish[fleet.way]
    stand = rules.inwards[fleet.way] & (fleet.at > finish - AT_REST) & np.isinf(fleet.leaves)
    if not stand.any():
        return fleet
    leaves = fleet.leaves.copy()
    leaves[stand] = clock + 5.0 + generator.exponential(REST, int(stand.sum()))
    still = np.where(stand, 0.0, fleet.speed)
    at = np.where(stand, finish, fleet.at)
    return replace(fleet, leaves=leaves, at=at, speed=still, change=np.minimum(fleet.change, still))


def leave_bay(fleet: Fleet, rules: Rules, clock: float, generator: np.random.Generator) -> Fleet:
    """Whose time has come takes a way out of its bay, one after the other."""
    ready = np.flatnonzero(fleet.leaves <= clock)
    leaving = (rules.bay[fleet.way] >= 0) & ~rules.inwards[fleet.way] & (fleet.at < OUT)
    if len(ready) == 0 or leaving.any():
        return fleet
    way, at, leaves = fleet.way.copy(), fleet.at.copy(), fleet.leaves.copy()
    first = ready[0]
    outs = np.flatnonzero((rules.bay == rules.bay[way[first]]) & ~rules.inwards)
    way[first], at[first], leaves[first] = generator.choice(outs), 0.0, np.inf
    return replace(fleet, way=way, at=at, leaves=leaves)


def leave_plan(fleet: Fleet, rules: Rules) -> Fleet:
    """Without those who have come to the end of their way."""
    done = (fleet.at >= rules.finish[fleet.way] - POINT_SPACING_M) & ~rules.inwards[fleet.way]
    return pick(fleet, ~done) if done.any() else fleet


def step_in(crowd: Crowd, walker: Walker, number: int, done: float = 0.0) -> Crowd:
    """The crowd with one more, who has walked so many metres of his path."""
    last = len(walker.path) - 1
    at = min(int(done / POINT_SPACING_M), last - 1)
    length = max(crowd.path.shape[1], last + 1)
    ahead = walker.path[at + 1] - walker.path[at]
    ahead = ahead / np.sqrt((ahead**2).sum())
    aside = walker.aside * np.array([-ahead[1], ahead[0]])
    one = Crowd(
        number=np.array([number]),
        place=(walker.path[at] + aside)[None],
        speed=0.8 * walker.pace * ahead[None],
        path=_long(walker.path[None], length),
        over=_long(walker.over[None], length),
        last=np.array([last]),
        done=np.array([POINT_SPACING_M * at]),
        aside=np.array([walker.aside]),
        pace=np.array([walker.pace]),
        radius=np.array([RADIUS[walker.kind]]),
    )
    return join(replace(crowd, path=_long(crowd.path, length), over=_long(crowd.over, length)), one)


def nobody() -> tuple[Fleet, Crowd]:
    """An empty plan."""
    whole, real, pairs = np.empty(0, int), np.empty(0), np.empty((0, 2))
    fleet = Fleet(whole, whole, real, real, real, real, real, real, real)
    path, over = np.empty((0, 1, 2)), np.empty((0, 1), int)
    return fleet, Crowd(whole, pairs, pairs, path, over, whole, real, real, real, real)


def join(some: Moment, others: Moment) -> Moment:
    """Both together."""
    return type(some)(
        *(np.concatenate([getattr(some, f.name), getattr(others, f.name)]) for f in fields(some))
    )


def pick(some: Moment, who: Bool[Array, "n"]) -> Moment:
    """Those alone for whom `who` is true."""
    return type(some)(*(getattr(some, f.name)[who] for f in fields(some)))


def _is_taken(fleet: Fleet, rules: Rules, bay: int) -> bool:
    """Whether somebody stands in a bay, drives to it, or has not quite left it."""
    away = ~rules.inwards[fleet.way] & (fleet.at > OUT)
    return bool(((rules.bay[fleet.way] == bay) & ~away).any())


def _long(rows: Array, length: int) -> Array:
    """Paths with their last point repeated up to a length."""
    more = length - rows.shape[1]
    return (
        np.concatenate([rows, np.repeat(rows[:, -1:], more, axis=1)], axis=1) if more > 0 else rows
    )
