"""Instrument design: predicted range errors, and a recommendation for a goal."""

from amulor.design.axes import AXES
from amulor.design.candidates import Parameters
from amulor.design.evaluate import TERMS, evaluate
from amulor.design.goal import Goal, json_schema
from amulor.design.recommend import Between, Bound, Choice, Recommendation, recommend
from amulor.design.requirements import Requirement, Shortfall
from amulor.design.vehicle import Lines

__all__ = [
    "AXES",
    "TERMS",
    "Between",
    "Bound",
    "Choice",
    "Goal",
    "Lines",
    "Parameters",
    "Recommendation",
    "Requirement",
    "Shortfall",
    "evaluate",
    "json_schema",
    "recommend",
]
