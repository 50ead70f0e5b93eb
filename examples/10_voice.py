"""Speech to a team: lines of recognised text become orders of `robrain assistant`, rehearsed and read back first.

    RECOGNISER | python 10_voice.py --connect tcp/10.0.0.5:7447 | SPEECH_SYNTHESIS

Use any recogniser that prints a line for each sentence. The assistant applies the same rules as to a language model.
"""

import os
import re
import sys

import anyio
from mcp import Client, StdioServerParameters, stdio_client

NUMBER_WORDS = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen"
WORDS = {word: str(number) for number, word in enumerate(NUMBER_WORDS.split())}
NUMBER = r"(\d+(?:\.\d+)?)"
GRAMMAR = {
    rf"(?:send|drive|go)\b.*\bto {NUMBER}(?: and)? {NUMBER}": (
        "submit_task", lambda x, y: {"kind": "visit", "x_m": float(x), "y_m": float(y)}),
    r"(?:cancel|forget) (?:that|the) task": ("cancel_task", dict),
    rf"where is robot {NUMBER}": ("robot_state", lambda number: {"robot": f"r{number}"}),
    r"(?:who is there|what are you doing)": ("list_robots", dict),
    r"(?:please )?(?:continue|resume)": ("resume", dict),
}  # fmt: skip
"""Sentences with their tool and arguments. Every line that begins with `stop` halts the team."""


def understood(line: str) -> tuple[str, dict] | None:
    text = " ".join(WORDS.get(word, word) for word in re.findall(r"[a-z\d.]+", line.lower()))
    text = re.sub(r"(\d) point (\d)", r"\1.\2", text)
    if re.match("stop|halt", text):
        return "halt", {"reason": "spoken"}
    found = ((re.fullmatch(sentence, text), *meaning) for sentence, meaning in GRAMMAR.items())
    return next(((tool, arguments(*match.groups())) for match, tool, arguments in found if match), None)


async def listen() -> None:
    words = ["-m", "robrain.cli", "assistant", *sys.argv[1:]]
    server = StdioServerParameters(command=sys.executable, args=words, env=dict(os.environ))
    waiting, task = None, ""  # the order that awaits a confirmation, and the last task
    async with Client(stdio_client(server)) as team:
        while line := await anyio.to_thread.run_sync(sys.stdin.readline):
            print(f"heard: {line.strip()}")
            is_yes = re.fullmatch(r"(yes|confirm|do it)\W*", line.strip().lower())
            order, waiting = waiting if is_yes else understood(line), None  # any other line is a no
            if order is None:
                print("  say: I did not understand; nothing is done", flush=True)
                continue
            tool, arguments = order[0], {**order[1], **({"task": task} if order[0] == "cancel_task" else {})}
            answer = await team.call_tool(tool, arguments)
            values = answer.structured_content or {}
            task = values.get("task", task)
            if token := values.get("confirm"):
                waiting = tool, {**arguments, "confirm": token}
            said = answer.content[0].text.rpartition("this would happen:\n")[2].replace("\n", "\n       ")
            print(f"  say: {said}{' Shall I?' if waiting else ''}", flush=True)


anyio.run(listen)
