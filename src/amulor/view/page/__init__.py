"""Browser page: a local server, and copies saved as one file.

Saving a scan needs no package beyond those of amulor; serving needs the extra `view`.
"""

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.view.page.live import Live
    from amulor.view.page.recording import Recording, opened, recording_of
    from amulor.view.page.saved import save_page, saved_page
    from amulor.view.page.server import background, serve

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

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            "Live": "amulor.view.page.live",
            "Recording": "amulor.view.page.recording",
            "background": "amulor.view.page.server",
            "opened": "amulor.view.page.recording",
            "recording_of": "amulor.view.page.recording",
            "save_page": "amulor.view.page.saved",
            "saved_page": "amulor.view.page.saved",
            "serve": "amulor.view.page.server",
        },
    )
