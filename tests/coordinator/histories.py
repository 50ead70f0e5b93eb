"""What may happen to a team, in any order: played, looked at after each step, and brought to its end."""

from robrain.protocol.wire.session import open_lockstep_session


def play(make_history, actions):
    """Do the actions, each the name of a method and its arguments.

    Args:
        make_history: of a session what has `team`, `check`, `finish` and the actions.
        actions: tuples.
    """
    with open_lockstep_session() as session:
        history = make_history(session)
        try:
            for do, *arguments in actions:
                getattr(history, do)(*arguments)
                history.check()
            history.finish()
        finally:
            history.team.close()
