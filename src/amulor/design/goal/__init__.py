"""What is asked of an instrument, and what it may be made of: one TOML file."""

from amulor.design.goal.goal_file import Goal, json_schema

__all__ = ["Goal", "json_schema"]
