"""Pseudo-random numbers that are equal for all robots: hashes of shared values."""

from hashlib import blake2b


def chance(*words: object) -> float:
    """A number from 0 to 1, 1 excluded; equal words, equal number, on every machine.

    The hash is cryptographic, not a checksum. Checksums of texts of one length differ by the same bits whatever else is
    hashed. The same tasks would then be preferred in every round.
    """
    text = ":".join(map(str, words))
    return int.from_bytes(blake2b(text.encode(), digest_size=6).digest(), "big") / 2**48
