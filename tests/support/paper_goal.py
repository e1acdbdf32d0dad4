"""The goal of the paper's ladder in milk, and what is recommended for it, once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from amulor.design import Goal, Recommendation, recommend

PAPER = Path(__file__).parents[2] / "examples" / "goals" / "paper_milk.toml"


@cache
def goal() -> Goal:
    """Return the goal: one laser, three frequencies, two channels."""
    return Goal.from_toml(PAPER)


@cache
def choice() -> Recommendation:
    """Return the recommendation."""
    return recommend(goal())
