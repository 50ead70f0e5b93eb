"""The plugin manager under whatever may be done to it, in any order."""

import faulthandler
import logging
import tempfile
from pathlib import Path

import msgspec
import pytest
import zenoh
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from robrain.agent.errors import PluginError
from robrain.agent.lifecycle.transitions import TRANSITIONS, TransitionRefused, Trigger
from robrain.agent.plugin import PluginState
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, HOST_RELOAD, HOST_UNLOAD
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from tests.agent.conftest import Bench

pytestmark = pytest.mark.slow

WATCHDOG_S = 500.0

UNIVERSE = """
    FAULT, SEEN = {}, []

    class PingInterface(Protocol):
        rung: Event[int]
        def ping(self) -> str: ...

    class Watched:
        interface = PingInterface
        rung = Event[int]()
        period_s = 0.04
        running = False
        heard = 0
        def init(self): self._fail("init")
        def activate(self):
            self.running = True
            self.handles = {}
            for name in self.needs:
                self.handles[name] = self.env.use(name, PingInterface)
                self.env.observe(self.handles[name].rung, self.hear)
            self._fail("activate")
        def deactivate(self):
            self.running = False
            self._fail("deactivate")
        def hear(self, value):
            if not self.running: SEEN.append(f"{self.env.plugin} is told while it does not run")
            self.heard += 1
        def step(self):
            if not self.running: SEEN.append(f"{self.env.plugin} steps while it does not run")
            self._fail("step")
            self.rung.notify(1)
            for handle in self.handles.values(): handle.ping()
        @external
        def ping(self) -> str:
            if not self.running: SEEN.append(f"{self.env.plugin} is called while it does not run")
            for handle in self.handles.values(): handle.ping()
            return self.env.plugin
        def _fail(self, where):
            if FAULT.get(self.env.plugin) == where:
                del FAULT[self.env.plugin]
                raise RuntimeError(f"fails in {where}")

    class Motor(Watched, Device): needs = ()
    class Radio(Watched, Device): needs = ()
    class Driver(Watched, Unit): needs = ("motor",)
    class Rival(Watched, Unit): needs = ("motor",)
    class Relay(Watched, Unit): needs = ("radio",)
    class Roam(Watched, Skill): needs = ("driver", "relay")
"""
REQUIRES = {
    "motor": [],
    "radio": [],
    "driver": ["motor"],
    "rival": ["motor"],
    "relay": ["radio"],
    "roam": ["driver", "relay"],
}
PLUGINS = st.sampled_from(sorted(REQUIRES))
RUNS = (PluginState.ACTIVE, PluginState.HALTED)


class Manager(RuleBasedStateMachine):
    """One robot. Its exclusive `motor` is wanted by two; `radio` is started again after a fault."""

    session: zenoh.Session

    def __init__(self):
        super().__init__()
        self._folder = tempfile.TemporaryDirectory()
        self.bench = Bench(Path(self._folder.name), self.session)
        self.bench.code("universe", UNIVERSE)
        for name in REQUIRES:
            self._write(name)
        self.kept = []

    def _write(self, name, **more):
        policy = {"restart": "on-failure", "backoff_s": 0.1} if name in ("radio", "driver") else {}
        tag = {"visibility": ["*", "command"], "requires": REQUIRES[name], "shared": name != "motor", **policy, **more}
        self.bench.manifest(name, f"universe:{name.title()}", **tag)

    @initialize(load=st.sampled_from([["motor"], ["roam"], ["radio", "rival"]]))
    def start(self, load):
        self.manager = self.bench.start(*load).manager
        # Modules of other runs have other paths; all plugins of this one share a module, until it is reloaded.
        self.spaces = []
        self._watch()

    def teardown(self):
        self.bench.close()
        self._folder.cleanup()

    def _watch(self):
        for tag in self.manager.plugins.values():
            space = tag.plugin_class.ping.__globals__
            if not any(space is known for known in self.spaces):
                self.spaces.append(space)

    def _check(self, holds, what):
        assert holds, what

    # -- what is done to it -------------------------------------------------------------------------------------

    def _ask(self, query, name, **fields):
        try:
            infos = self.bench.wire.ask(query, query.request(plugin=name, **fields), robot="r1")
        except CallError as refused:
            self._check(refused.message != "", f"{query.name} of {name} is refused without a word")
        else:
            assert infos
        self._watch()

    @rule(name=PLUGINS)
    def load(self, name):
        self._ask(HOST_LOAD, name)

    @rule(name=PLUGINS, cascade=st.booleans())
    def unload(self, name, cascade):
        users = [user.name for user in self.manager.registry.users_of(name)]
        self._ask(HOST_UNLOAD, name, cascade=cascade)
        assert (name in self.manager.plugins) == (bool(users) and not cascade)

    @rule(name=PLUGINS)
    def reload(self, name):
        before = self.manager.plugins.get(name)
        ran = before is not None and before.state in RUNS
        self._ask(HOST_RELOAD, name)
        assert not ran or self.manager.plugins[name].state in (*RUNS, PluginState.FAULTED)

    @rule(name=PLUGINS, where=st.sampled_from(["init", "activate", "deactivate", "step"]))
    def let_fail(self, name, where):
        for space in self.spaces:
            space["FAULT"][name] = where

    @rule(name=PLUGINS)
    def fail_now(self, name):
        if name in self.manager.plugins:
            self.manager.get(name).fault(RuntimeError("told to"))

    @rule(ticks=st.integers(1, 30))
    def time_passes(self, ticks):
        self.bench.tick(ticks)

    @rule(name=PLUGINS)
    def call(self, name):
        tag = self.manager.plugins.get(name)
        try:
            reply = self.bench.wire.ask(ROBOT_CALL, robot="r1", plugin=name, function="ping")
        except NobodyThere:
            pytest.fail("a query was not answered")
        except CallError as refused:
            code = refused.code
            self._check(tag is not None or code is ErrorCode.UNKNOWN_PLUGIN, f"{name} is not there, answered {code}")
            halted = tag is not None and tag.state is PluginState.HALTED
            self._check(not halted or code is ErrorCode.HALTED, f"{name} is halted, answered {code}")
        else:
            assert tag.state is PluginState.ACTIVE
            assert msgspec.json.decode(reply) == name

    @rule(name=PLUGINS, trigger=st.sampled_from(Trigger))
    def ask_for_what_the_table_refuses(self, name, trigger):
        tag = self.manager.plugins.get(name)
        if tag is None or (tag.state, trigger) in TRANSITIONS:
            return
        before = (tag.state, tag.state_reason, tag.instance)
        with pytest.raises(TransitionRefused, match=f"^{name} is {tag.state}: it cannot be "):
            tag.apply(trigger, "told to")
        assert (tag.state, tag.state_reason, tag.instance) == before

    @rule()
    def halt(self):
        self.manager.halt()

    @rule()
    def resume(self):
        self.manager.resume()

    @rule(name=PLUGINS)
    def keep_its_handles(self, name):
        tag = self.manager.plugins.get(name)
        if tag is not None and tag.state in RUNS:
            self.kept += [(callee, handle) for callee, handle in tag.plugin.handles.items()]

    # -- what holds at all times --------------------------------------------------------------------------------

    @invariant()
    def a_handle_works_on_what_is_there_or_says_why_not(self):
        for callee, handle in self.kept[-6:]:
            try:
                answer = handle.ping()
            except PluginError:
                continue
            assert answer == callee
            assert self.manager.get(callee).state is PluginState.ACTIVE

    @invariant()
    def nobody_is_called_who_does_not_run(self):
        assert [entry for space in getattr(self, "spaces", []) for entry in space["SEEN"]] == []

    @invariant()
    def once_the_host_has_seen_to_faults_all_is_well(self):
        if not hasattr(self, "manager"):
            return
        self.manager.settle(self.bench.clock.now_ns())
        self.manager.settle(self.bench.clock.now_ns())
        tags = self.manager.plugins
        for name, tag in tags.items():
            assert tag.state is not PluginState.UNLOADED
            assert tag.state is not PluginState.HALTED or self.manager.halted
            assert tag.state in RUNS or tag.state_reason, f"{name} is {tag.state} and does not say why"
            if tag.state in RUNS:
                assert tag.plugin.running
                requires = tag.manifest.tag.requires
                assert all(tags[required].state in RUNS for required in requires), f"{name} lacks what it requires"
                assert all(tags[required].level < tag.level for required in requires)
            if tag.exclusive.inside:
                assert tags[tag.exclusive.inside].state in RUNS, f"{name} is held by one that does not run"
        order = list(tags)
        assert all(
            order.index(required) < order.index(name)
            for name, tag in tags.items()
            for required in tag.manifest.tag.requires
            if required in tags
        )

    @invariant()
    def the_host_tells_of_all_of_them(self):
        if hasattr(self, "manager"):
            assert list(self.bench.infos()) == list(self.manager.plugins)
            assert len(self.bench.wire.ask(ROBOT_PLUGINS, robot="r1")) == len(self.manager.plugins)


@pytest.mark.timeout(WATCHDOG_S + 10)
def test_whatever_is_done_in_any_order_the_manager_keeps_its_promises(lockstep_session):
    Manager.session = lockstep_session
    faulthandler.dump_traceback_later(WATCHDOG_S, exit=False)  # who waits for whom, should it come to that
    logging.disable(logging.CRITICAL)
    try:
        run_state_machine_as_test(
            Manager,
            settings=settings(
                max_examples=25, stateful_step_count=40, deadline=None, suppress_health_check=list(HealthCheck)
            ),
        )
    finally:
        logging.disable(logging.NOTSET)
        faulthandler.cancel_dump_traceback_later()
