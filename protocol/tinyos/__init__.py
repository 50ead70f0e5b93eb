"""The language of TinyOS base stations: packets, our motes' payloads, and their framing on TCP and on serial lines."""
