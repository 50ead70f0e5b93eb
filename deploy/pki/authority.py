"""The certificates themselves: keys on P-256, a CA of the team's own, one short-lived certificate per member."""

from datetime import datetime, timedelta
from ipaddress import ip_address
from typing import NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from robrain.deploy.errors import PkiError
from robrain.protocol.access.member import Member, MemberRole

CA_DAYS = 3650
EARLY = timedelta(minutes=5)
"""Clocks of members may be behind by this much."""


class Pair(NamedTuple):
    """A certificate and its key, both as PEM."""

    certificate: bytes
    key: bytes
    serial: int
    not_after: datetime


class Authority:
    """The team's CA.

    Args:
        certificate: its own, as PEM.
        key: its key, as PEM.

    Raises:
        PkiError: one of them cannot be read, or the two do not belong together.

    """

    def __init__(self, certificate: bytes, key: bytes) -> None:
        try:
            self._certificate = x509.load_pem_x509_certificate(certificate)
            loaded = load_pem_private_key(key, None)
        except (ValueError, TypeError) as error:
            raise PkiError("expected a certificate and a key in PEM") from error
        if not isinstance(loaded, ec.EllipticCurvePrivateKey) or loaded.public_key() != self._certificate.public_key():
            raise PkiError("the key is not that of the certificate")
        self._key = loaded

    @staticmethod
    def create(team: str, now: datetime) -> Pair:
        """A new CA for a team."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"robrain CA of {team}"[:64])
        usage = _usage(signs_certificates=True)
        builder = _builder(name, name, key, now, CA_DAYS)
        builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), True)
        certificate = builder.add_extension(usage, True).sign(key, hashes.SHA256())
        return _pair(certificate, key)

    def issue(self, member: Member, days: float, now: datetime, hosts: tuple[str, ...] = ()) -> Pair:
        """A certificate for a member, with a new key.

        Args:
            member: whose.
            days: for how long, but no longer than the CA's own.
            now: the time; it begins a little earlier.
            hosts: names and addresses at which a router is reached. Only routers may be connected to: a robot's
                certificate does not pass for a router's.

        Raises:
            PkiError: the CA's own certificate has ended.

        """
        key = ec.generate_private_key(ec.SECP256R1())
        days = min(days, (self._certificate.not_valid_after_utc - now) / timedelta(days=1))
        if days <= 0:
            raise PkiError("the CA's own certificate has ended: make a new CA, in a new folder")
        builder = _builder(_name(member.common_name), self._certificate.subject, key, now, days)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
        builder = builder.add_extension(_usage(signs_certificates=False), True)
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if member.role is MemberRole.ROUTER:
            purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
            builder = builder.add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts]), False)
        certificate = builder.add_extension(x509.ExtendedKeyUsage(purposes), False).sign(self._key, hashes.SHA256())
        return _pair(certificate, key)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, now: datetime, days: float
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLY)
        .not_valid_after(now + timedelta(days=days))
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pair(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Pair:
    return Pair(
        certificate.public_bytes(Encoding.PEM),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
        certificate.serial_number,
        certificate.not_valid_after_utc,
    )
