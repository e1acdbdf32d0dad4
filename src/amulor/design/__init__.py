"""Which instrument: errors of any design, and a recommendation for a goal."""

from amulor.design.axes import AXES
from amulor.design.candidates import Parameters
from amulor.design.evaluate import TERMS, evaluate
from amulor.design.goal import Goal, json_schema

__all__ = ["AXES", "TERMS", "Goal", "Parameters", "evaluate", "json_schema"]
