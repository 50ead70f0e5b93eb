"""The factsheet of a robot as a vehicle."""

from typing import Any

from robrain.deploy.vda5050.messages import ID_MAX, NODES_MAX, Version
from robrain.protocol.messages.robots.robot_messages import RobotState

INSTANT = ("cancelOrder", "startPause", "stopPause", "stateRequest", "factsheetRequest")
SPEED_M_S, HEIGHT_M = 1.0, 1.0
"""Nominal values: a robot does not report them."""


def factsheet(version: Version, robot: RobotState | None) -> dict[str, Any]:
    """The factsheet as JSON, without its header.

    Args:
        version: of VDA 5050.
        robot: its state; None if it is unknown.

    """
    is_old = version is Version.V2_1

    def name(old: str, new: str) -> str:
        return old if is_old else new

    diameter_m = 2.0 * (robot.radius_m if robot is not None else 0.0)
    ends = {} if is_old else {"pauseAllowed": False, "cancelAllowed": True}
    wait: dict[str, Any] = {
        "actionType": "wait",
        "actionScopes": ["NODE"],
        "actionParameters": [{"key": "duration", "valueDataType": "NUMBER", "description": "Seconds."}],
        **ends,
    }
    if not is_old:  # the schema of 2.1.0 allows no list here
        wait["blockingTypes"] = ["SOFT", "HARD"]
    actions = [wait, *({"actionType": kind, "actionScopes": ["INSTANT"], **ends} for kind in INSTANT)]
    return {
        "typeSpecification": {
            "seriesName": "robrain",
            name("agvKinematic", "mobileRobotKinematics"): name("DIFF", "DIFFERENTIAL"),
            name("agvClass", "mobileRobotClass"): "CARRIER",
            name("maxLoadMass", "maximumLoadMass"): 0.0,
            "localizationTypes": ["NATURAL"],
            "navigationTypes": [name("AUTONOMOUS", "FREELY_NAVIGATING")],
        },
        "physicalParameters": {
            name("speedMin", "minimumSpeed"): 0.0,
            name("speedMax", "maximumSpeed"): SPEED_M_S,
            name("accelerationMax", "maximumAcceleration"): SPEED_M_S,
            name("decelerationMax", "maximumDeceleration"): SPEED_M_S,
            name("heightMin", "minimumHeight"): 0.0,
            name("heightMax", "maximumHeight"): HEIGHT_M,
            "width": diameter_m,
            "length": diameter_m,
        },
        "protocolLimits": {
            name("maxStringLens", "maximumStringLengths"): {name("idLen", "maximumIdLength"): ID_MAX},
            name("maxArrayLens", "maximumArrayLengths"): {"order.nodes": NODES_MAX, "order.edges": NODES_MAX},
            "timing": {
                name("minOrderInterval", "minimumOrderInterval"): 0.0,
                name("minStateInterval", "minimumStateInterval"): 0.05,
                "defaultStateInterval": 1.0,
                "visualizationInterval": 0.5,
            },
        },
        "protocolFeatures": {
            "optionalParameters": [{"parameter": "order.nodes.nodePosition", "support": "REQUIRED"}],
            name("agvActions", "mobileRobotActions"): actions,
        },
        name("agvGeometry", "mobileRobotGeometry"): {},
        "loadSpecification": {},
    }
