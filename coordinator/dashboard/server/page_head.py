"""What is added to viser's page: its style, and a script that makes keys and rows of tables work.

viser's own elements cannot say that a row was clicked, nor that a key is held; `page.js` turns both into what they can.
"""

from importlib import resources

CLOSE_MARK = '<div class="rb-close-mark"></div>'
"""Marks the close button of a window, which follows it; Escape presses that button."""


def page_head(*, has_halt: bool) -> str:
    """HTML for the page's head, with `{nonce}` as placeholder for the script's nonce.

    `has_halt` adds the halt button; a recording has none.
    """
    folder = resources.files("robrain.coordinator.dashboard.server")
    style = folder.joinpath("page.css").read_text(encoding="utf-8")
    script = folder.joinpath("page.js").read_text(encoding="utf-8")
    mark = '<meta name="rb-halt" content="yes">' if has_halt else ""
    return f'{mark}<style>{style}</style><script nonce="{{nonce}}">{script}</script>'
