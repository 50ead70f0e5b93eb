"""What an assistant's refusals say. Decisions are made on `Ban`, never on these."""

from types import MappingProxyType

from robrain.deploy.assistant.policy import OPEN_TASKS_MAX, Ban

WORDS = MappingProxyType(
    {
        Ban.RESUME: "an assistant never ends a halt: a person does, with `robrain resume`",
        Ban.PLUGINS: "an assistant never loads, unloads or reloads plugins: a person does, with `robrain plugin`",
        Ban.LEAD: "an assistant never decides who leads a team: a person does, with `robrain lead`",
        Ban.HOLD: "an assistant never holds plugins",
        Ban.DRIVE: "an assistant never moves a robot itself: submit a task, and the team decides who does it and how",
        Ban.PLANNING: "an assistant never changes how the team plans: a person does, with `robrain task objective`",
        Ban.KEYS: "an assistant never makes or revokes certificates: a person does, with `robrain pki`",
        Ban.TEXT_FORM: "an assistant sends no text that a robot executes: use call_plugin, which names what is called",
        Ban.UNKNOWN_TOOL: "there is no such tool",
        Ban.NO_PLUGIN: "the robot has no such plugin: see list_plugins",
        Ban.NO_FUNCTION: "the plugin has no such function: see list_plugins",
        Ban.NOT_OPEN: "the plugin's manifest does not open it to callers outside the robot (visibility `command`)",
        Ban.NOT_YOURS: "an assistant only cancels tasks that it has submitted itself",
        Ban.HAS_ENDED: "the task has ended already",
        Ban.TOO_MANY_TASKS: f"{OPEN_TASKS_MAX} tasks of this assistant have not ended yet: wait, or cancel one of them",
        Ban.ROLE: "this assistant's certificate does not allow it",
        Ban.BAD_ARGUMENTS: "the arguments are not valid",
        Ban.BUSY: "too many calls are being answered: wait for their answers",
        Ban.NOT_LOGGED: "the audit log cannot be written, and an order that is not logged is not carried out",
        Ban.NO_TOKEN: "there is no order with this token: it was used already, or never given; "
        "call again without `confirm`",
        Ban.EXPIRED: "the time to confirm this order is over: call again without `confirm`",
        Ban.ANOTHER_ORDER: "this token confirms other arguments; it is void now: call again without `confirm`",
        Ban.TEAM: "the team refuses",
        Ban.NOBODY: "nobody answers",
    }
)


def refusal(ban: Ban, detail: str = "") -> str:
    """A refusal in words, with what it is about."""
    return f"refused: {WORDS[ban]}{f': {detail}' if detail else ''}"
