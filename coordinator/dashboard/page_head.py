"""What is added to viser's page: its style, and a script that makes keys and rows of tables work.

viser's own elements cannot say that a row was clicked, nor that a key is held; `page.js` turns both into what they can.
"""

from importlib import resources


def page_head() -> str:
    """HTML for the page's head, with `{nonce}` where the script's nonce belongs."""
    folder = resources.files("robrain.coordinator.dashboard")
    style = folder.joinpath("page.css").read_text(encoding="utf-8")
    script = folder.joinpath("page.js").read_text(encoding="utf-8")
    return f'<style>{style}</style><script nonce="{{nonce}}">{script}</script>'
