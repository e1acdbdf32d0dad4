"""Project file with scans, as `amulor archive` and drawings read it."""

from __future__ import annotations

FIELDS = {
    "name": '"Ladder"',
    "title": '"Ladder of the demo"',
    "monument": '"Ladder, no. 12"',
    "place": '"Tank 3, 52.1 N 4.3 E"',
    "first_day": "2026-05-01",
    "last_day": "2026-05-02",
    "conditions": '"0.5 m deep, visibility 6 m, 12 degC, dark"',
    "scanner": '"amulor bench, model 1"',
    "serial_number": '"B-001"',
    "operator": '"A. Diver, Institute"',
    "control_data": '"none"',
    "purpose": '"test"',
    "copyright": '"CC BY 4.0, Institute"',
}


def project_text(
    scans: dict[str, tuple[str, str, str]], *, rms_error: str = "", **fields: str
) -> str:
    """Return the text of a project file.

    The scans are image, raw files, and lines of the pose, by name; fields replace those
    of the section [project] or are added.
    """
    lines = ["[project]"]
    texts = {name: f'"{text}"' for name, text in fields.items()}
    lines += [f"{name} = {text}" for name, text in (FIELDS | texts).items()]
    lines += ["[registration]", 'method = "targets"', "points = 4"]
    lines += [f'rms_error = "{rms_error}"'] if rms_error else []
    for name, (image, raw, pose) in scans.items():
        lines += ["[[scans]]", f'name = "{name}"', f'image = "{image}"', f"raw = {raw}"]
        lines += ["[scans.pose]", pose] if pose else []
    return "\n".join(lines) + "\n"
