"""Mote ranges: passes the signals of motes with known places to localisation, by the board.

It is a separate plugin, so that a robot without a mote base station is still localised. A plugin whose requirements do
not start is omitted, and localisation does not require this one.
"""

from robrain.agent.plugin import Skill, external
from robrain.algorithms.localization.rssi_ranging import RssiSample
from robrain.plugins.unit.snw_exploration.interface import RssiMeasurement, SnwInterface


class MoteRanges(Skill):
    """Writes the signal strengths of motes to the board."""

    def init(self) -> None:
        self._dropped = 0

    def activate(self) -> None:
        self.env.observe(self.env.use("snw_exploration", SnwInterface).measured, self._handle)

    @external
    def dropped(self) -> int:
        """Signals dropped because localisation was too slow."""
        return self._dropped

    def _handle(self, measured: RssiMeasurement) -> None:
        if measured.place is None:
            return
        board = self.env.board.mote_ranges
        self._dropped += len(board) == board.maxlen
        board.append(RssiSample(measured.mote, measured.place, measured.rssi_dbm, measured.stamp_ns))
