"""A door behind a Modbus TCP controller."""

from collections.abc import Callable

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from robrain.client.door_keeper import DoorUnavailable

ANSWER_S = 1.0
"""Time limit of the controller's answer."""


class ModbusDoor:
    """A door behind a Modbus TCP controller; see `DoorDriver`.

    Args:
        host: of the controller.
        port: of the controller.
        coil: address of the coil that orders the door to open while it is on.
        input_: address of the discrete input that is on while a robot can pass.
        unit: number of the device behind the controller.

    """

    def __init__(self, host: str, port: int, *, coil: int, input_: int, unit: int = 1) -> None:
        self._client = ModbusTcpClient(host, port=port, timeout=ANSWER_S, retries=0)
        self._coil, self._input, self._unit = coil, input_, unit

    def open(self) -> None:
        """Switch the coil on."""
        self._request(lambda: self._client.write_coil(self._coil, True, device_id=self._unit))

    def close(self) -> None:
        """Switch the coil off."""
        self._request(lambda: self._client.write_coil(self._coil, False, device_id=self._unit))

    def state(self) -> bool:
        """Read the input."""
        read = self._client.read_discrete_inputs
        return bool(self._request(lambda: read(self._input, count=1, device_id=self._unit)).bits[0])

    def disconnect(self) -> None:
        """Close the connection; the coil keeps its state."""
        self._client.close()  # type: ignore[no-untyped-call]

    def _request(self, ask: Callable[[], ModbusPDU]) -> ModbusPDU:
        if not self._client.connected and not self._client.connect():  # type: ignore[no-untyped-call]
            raise DoorUnavailable("the controller cannot be reached")
        try:
            answer = ask()
        except ModbusException as error:
            raise DoorUnavailable(f"the controller does not answer: {error}") from error
        if answer.isError():
            raise DoorUnavailable(f"the controller refuses: {answer}")
        return answer
