"""The browser page: a server for this computer, and pages saved as one file."""

from amulor.view.page.live import Live
from amulor.view.page.recording import Recording, opened, recording_of
from amulor.view.page.saved import save_page, saved_page
from amulor.view.page.serve import background, serve

__all__ = [
    "Live",
    "Recording",
    "background",
    "opened",
    "recording_of",
    "save_page",
    "saved_page",
    "serve",
]
