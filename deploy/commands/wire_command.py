"""`robrain wire`: the whole wire, printed from the table of topics."""

import msgspec

from robrain.deploy.command_line.team_options import WireFormat
from robrain.protocol.schema.document import wire_document
from robrain.protocol.schema.page import wire_page


def wire_text(wire_format: WireFormat) -> str:
    """Describe the wire in the given format, with a newline at the end."""
    if wire_format is WireFormat.MARKDOWN:
        return wire_page()
    return msgspec.json.format(msgspec.json.encode(wire_document()), indent=2).decode() + "\n"
