"""Connections to addresses that were checked: what a name resolves to is looked up once, judged, and used.

Checking a name and then connecting to the name would leave it to its owner to answer the second look-up
with an address inside (DNS rebinding). Here the checked address itself is connected to; TLS and the Host
header still go by the name.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Iterable
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network

import httpcore

Address = IPv4Address | IPv6Address
Resolve = Callable[[str, int], Awaitable[list[Address]]]

# Where clouds tell machines their credentials, as far as no rule below covers them: AWS (IPv6), Alibaba,
# Azure, Oracle and Google (IPv6), by their documentations. AWS, Azure and Google at 169.254.169.254 are
# link-local.
_METADATA = frozenset(
    ip_address(address)
    for address in (
        "fd00:ec2::254",
        "100.100.100.200",
        "168.63.129.16",
        "192.0.0.192",
        "fd20:ce::254",
    )
)
# Tunnels that end wherever their address says (6to4, Teredo), local NAT64, site-local, "this network".
_NEVER = tuple(
    ip_network(network) for network in ("2002::/16", "2001::/32", "64:ff9b:1::/48", "fec0::/10", "0.0.0.0/8")
)
_NAT64 = ip_network("64:ff9b::/96")


def is_allowed(address: Address, private: bool) -> bool:
    """Whether an address may be connected to: public ones, and with `private` also those of a network's own.

    Never the addresses of metadata services, nor link-local, multicast, reserved and unspecified ones. An
    IPv4 address inside an IPv6 address is judged as what it is.
    """
    address = _innermost(address)
    if address.is_loopback:
        return private
    if (
        address in _METADATA
        or any(address in network for network in _NEVER)
        or address.is_link_local
        or address.is_multicast
        or address.is_reserved
        or address.is_unspecified
    ):
        return False
    return private or address.is_global


async def system_addresses(host: str, port: int) -> list[Address]:
    """What the system resolves a name, or an address, to. Raises OSError or UnicodeError where nothing."""
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [ip_address(socket_address[0]) for *_, socket_address in found]


class GuardedNetwork(httpcore.AsyncNetworkBackend):
    """Connects to the addresses of a host if `is_allowed` of all of them, else raises ConnectError."""

    def __init__(self, private: bool, resolve: Resolve = system_addresses) -> None:
        self._private = private
        self._resolve = resolve
        self._network = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """A connection to the first address that accepts one."""
        try:
            addresses = await self._resolve(host, port)
        except (OSError, UnicodeError) as error:
            raise httpcore.ConnectError(f"{host} has no address ({error})") from None
        for address in addresses:
            if not is_allowed(address, self._private):
                raise httpcore.ConnectError(f"{host} is at {address}, which is not connected to")
        refusal: Exception = httpcore.ConnectError(f"{host} has no address")
        for address in addresses:
            try:
                return await self._network.connect_tcp(
                    str(_innermost(address)), port, timeout, local_address, socket_options
                )
            except httpcore.ConnectError as error:
                refusal = error
        raise refusal


def _innermost(address: Address) -> Address:
    """The IPv4 address where an IPv6 address means one (IPv4-mapped, NAT64)."""
    if isinstance(address, IPv6Address):
        if address.ipv4_mapped is not None:
            return address.ipv4_mapped
        if address in _NAT64:
            return IPv4Address(int(address) & 0xFFFF_FFFF)
    return address
