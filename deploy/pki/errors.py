"""Errors of `robrain pki` and `robrain router`.

RobrainError
└── PkiError    a certificate, or a file of them, cannot be made or used; names the file
"""

from robrain.protocol.errors import RobrainError


class PkiError(RobrainError):
    """A certificate, or a file of them, cannot be made or used."""
