"""One process per name: an agent or coordinator claims its name first, and exits if another process has it.

A starting process declares an *asks* token, then checks for other tokens of the name. Zenoh delivers in order, so of
two that ask at the same time at least one sees the other. The one later in the order of claims withdraws its token and
checks again. The earlier one waits until no other process claims the name, then declares a *has* token until its
`alive` token is declared. Exactly one remains.

The name of a dead process becomes free when its connection ends: 2 ms after `kill -9`, one lease after a link cut. So
a process that does not answer is waited for.
"""

import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing
from importlib.metadata import version
from typing import Any, NamedTuple

import zenoh

from robrain.protocol.clock import NS_PER_S, LiveClock, steps
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import NameInUse
from robrain.protocol.messages.robots.plugin_messages import ROBOT_WHO, ProcessInfo
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_CLAIM
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_CLAIM, COORDINATOR_WHO
from robrain.protocol.topic import Query, Token
from robrain.protocol.wire.endpoint import Drive, Endpoint, Request, Serve
from robrain.protocol.wire.session import LEASE_MS

ASKS, HAS = "asks", "has"
PATIENCE_S = 1.5 * LEASE_MS / 1000
"""Longest wait for the token of a silent process to disappear."""
ASK_TIMEOUT_S = LEASE_MS / 1000
"""Longest wait for a process that has the name to answer. A busy one may be slow; the connection of one that hangs ends
by then, and the query with it.
"""
SUCCESSOR_TIMEOUT_S = 0.5
"""As above, for a process that checks for its successor in its own loop."""
TOKENS_TIMEOUT_S = 5.0
CHECK_PERIOD_S = 0.02
HANG_NS = LEASE_MS * 1_000_000 // 2
"""A process that hangs for longer may have lost its tokens. Others count the lease from its last sign of life, which is
up to a quarter of the lease older than the hang.
"""
CHECK_AFTER_HANG_NS = 10 * NS_PER_S
"""After a hang: time to connect again, and to receive the token of a process that has claimed the name."""
CHECK_AGAIN_NS = NS_PER_S // 5
_ELSE = re.compile(r"[^A-Za-z0-9_.]")
"""Replaces a dash in a host name within a key."""


class Keys(NamedTuple):
    """The topics for one name, and its description."""

    what: str
    claim: Token
    alive: Token
    who: Query[None, ProcessInfo]
    names: dict[str, str]


class _Seen(NamedTuple):
    """Tokens of other processes with this name."""

    asking: list[str]
    having: list[str]
    is_alive: bool


class NameClaim:
    """The claim of this process to one name.

    Args:
        session: the process's session.
        team: the team's name.
        keys: the name to claim.

    """

    def __init__(self, session: zenoh.Session, team: str, keys: Keys) -> None:
        self._session = session
        self._team = team
        self._keys = keys
        self.info = ProcessInfo(socket.gethostname(), os.getpid(), str(session.zid()), version("robrain"))
        began_ms = time.time_ns() // 1_000_000
        host = _ELSE.sub(".", self.info.host)[:20]
        self._process = f"{began_ms:012x}-{self.info.zid[:16]}-{self.info.pid}-{host}"
        """Sort key of claims: time of asking, then id."""
        self._wire = Endpoint(session, team, LiveClock(), Drive.LIVE)
        self._tokens: dict[str, Any] = {}

    def acquire(self, on_wait: Callable[[str], None], should_stop: Callable[[], bool]) -> bool:
        """Claim the name; False if `should_stop` came first.

        Args:
            on_wait: called once with a message if there is a process to wait for.
            should_stop: asked every 20 ms.

        Raises:
            NameInUse: another process has it; the text names it.

        """
        is_waiting = False
        waited_ns, checked_ns = 0, time.monotonic_ns()
        self._declare(ASKS)
        for _ in steps(should_stop, CHECK_PERIOD_S):
            seen = self._read_tokens()
            is_held = bool(seen.having) or seen.is_alive
            if not is_held and not seen.asking:
                if ASKS in self._tokens:
                    self.take_over()
                    self._withdraw(ASKS)
                    return True
                self._declare(ASKS)  # then check again: another may have asked meanwhile
                continue
            if is_held or min(seen.asking) < self._process:
                self._withdraw(ASKS)
            if is_held:
                for info in self._who(ASK_TIMEOUT_S):
                    raise self._name_error(str(info))
            before_ns, checked_ns = checked_ns, time.monotonic_ns()
            if not is_waiting:
                is_waiting = True
                if is_held:
                    what = self._keys.what
                    on_wait(f"{what} is there, but does not answer: waiting up to {PATIENCE_S:g} s for it to go")
            else:
                # If this machine hung, the other process did as well: that counts as one check.
                waited_ns += min(checked_ns - before_ns, round(ASK_TIMEOUT_S * NS_PER_S))
                if waited_ns > PATIENCE_S * NS_PER_S:
                    raise self._name_error(_describe_process(seen))
        return False

    def take_over(self) -> None:
        """Claim the name even if another process has it; for a coordinator that was elected."""
        # Declared first, as a process that sees the token may query at once.
        self._wire.answer(self._keys.who, self._reply_process, serve=Serve.AT_ONCE, at_once=(), **self._keys.names)
        self._declare(HAS)

    def settle(self) -> None:
        """Withdraw the claim's tokens, as the process's `alive` token now marks the name as taken.

        When this returns, the hub has all declarations of the session: a process that then learns that this one is up
        finds it there.
        """
        self._withdraw(HAS)
        self._read_tokens()  # its answer comes after all that was declared before it

    def successor(self) -> NameInUse | None:
        """An error that names the process that took this one's name while it hung, if there is one."""
        for info in self._who(SUCCESSOR_TIMEOUT_S):
            if info.zid != self.info.zid:
                return NameInUse(f"this process hung, and {self._keys.what} is another one now: {info}")
        return None

    def close(self) -> None:
        """Give the name back."""
        for stage in list(self._tokens):
            self._withdraw(stage)
        self._wire.close()

    # -- inside ---------------------------------------------------------------------------------------------

    def _declare(self, stage: str) -> None:
        if stage not in self._tokens:
            key = self._keys.claim.key(self._team, **self._keys.names, stage=stage, process=self._process)
            self._tokens[stage] = self._session.liveliness().declare_token(key)

    def _withdraw(self, stage: str) -> None:
        token = self._tokens.pop(stage, None)
        if token is not None:
            token.undeclare()

    def _read_tokens(self) -> _Seen:
        keys = self._keys
        processes: dict[str, list[str]] = {ASKS: [], HAS: []}
        for key in self._tokens_at(keys.claim.selector(self._team, **keys.names)):
            found = keys.claim.parse(key)
            if found is not None and found["process"] != self._process and found["stage"] in processes:
                processes[found["stage"]].append(found["process"])
        is_alive = bool(self._tokens_at(keys.alive.key(self._team, **keys.names)))
        return _Seen(processes[ASKS], processes[HAS], is_alive)

    def _tokens_at(self, selector: str) -> list[str]:
        replies = self._session.liveliness().get(selector, timeout=TOKENS_TIMEOUT_S)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def _who(self, timeout_s: float) -> Iterator[ProcessInfo]:
        """The processes that answer for the name, this one included once it has the name."""
        key = self._keys.who.key(self._team, **self._keys.names)
        return (info for _, info in processes_at(self._session, self._keys.who, key, timeout_s))

    def _name_error(self, who: str) -> NameInUse:
        return NameInUse(f"{self._keys.what} is there already: {who}. End that process first, or use another name")

    def _reply_process(self, _request: Request[Any]) -> ProcessInfo:
        return self.info


class NameWatcher:
    """Requests a stop, and detects that the name was lost while this process hung.

    A process that hangs for about its lease loses its tokens, and another may claim its name. After a hang it checks
    for that other process for a while, because its connection is made again meanwhile.

    Args:
        claim: the name that this process has.
        should_stop: requests a stop for other reasons.
        monotonic_ns: the clock.

    """

    def __init__(
        self, claim: NameClaim, should_stop: Callable[[], bool], monotonic_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._claim = claim
        self._should_stop = should_stop
        self._monotonic_ns = monotonic_ns
        self._asked_ns = monotonic_ns()
        self._check_until_ns = self._check_ns = 0
        self.lost: NameInUse | None = None
        """The name is another's now."""

    def __call__(self) -> bool:
        """Whether to stop; has to be called more often than each half lease."""
        before_ns, self._asked_ns = self._asked_ns, self._monotonic_ns()
        now_ns = self._asked_ns
        if now_ns - before_ns > HANG_NS:
            self._check_until_ns, self._check_ns = now_ns + CHECK_AFTER_HANG_NS, now_ns
        if self.lost is None and self._check_ns <= now_ns < self._check_until_ns:
            self._check_ns = now_ns + CHECK_AGAIN_NS
            self.lost = self._claim.successor()
        return self.lost is not None or self._should_stop()

    def check(self) -> None:
        """Raise NameInUse if the name was lost."""
        if self.lost is not None:
            raise self.lost


def processes_at(
    session: zenoh.Session, who: Query[None, ProcessInfo], selector: str, timeout_s: float
) -> Iterator[tuple[str, ProcessInfo]]:
    """All processes that answer `who` at a selector, each with its key."""
    everyone: Any = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
    for reply in session.get(selector, timeout=timeout_s, **everyone):
        if reply.ok is not None:
            try:
                yield str(reply.ok.key_expr), who.payloads.read(reply.ok.payload.to_bytes())
            except BadPayload:
                continue  # not a robrain process; its token shows that a process is there


def _describe_process(seen: _Seen) -> str:
    """Describe a process that has not answered, from its tokens."""
    for process in (*seen.having, *sorted(seen.asking)):
        began, _, rest = process.partition("-")
        zid, _, rest = rest.partition("-")
        pid, _, host = rest.partition("-")
        if began and zid and pid and host:
            return f"process {pid} on {host}, Zenoh id {zid[:8]}, which does not answer"
    return "a process on an unknown host"


def claim_robot(session: zenoh.Session, team: str, robot: str) -> AbstractContextManager[NameClaim]:
    """Claim a robot's name for the duration of the block."""
    what = f"robot {robot} of team {team}"
    return closing(NameClaim(session, team, Keys(what, ROBOT_CLAIM, ROBOT_ALIVE, ROBOT_WHO, {"robot": robot})))


def claim_coordinator(session: zenoh.Session, team: str) -> AbstractContextManager[NameClaim]:
    """Claim a team's coordination for the duration of the block."""
    what = f"the coordinator of team {team}"
    return closing(NameClaim(session, team, Keys(what, COORDINATOR_CLAIM, COORDINATOR_ALIVE, COORDINATOR_WHO, {})))
