"""Judges by access rules as a Zenoh router does: default deny, and a key must be included in one that is allowed."""

from typing import Any

import zenoh


def allows(access_control: dict[str, Any], common_name: str, flow: str, message: str, key: str) -> bool:
    assert access_control["enabled"]
    assert access_control["default_permission"] == "deny"
    subjects = {one["id"] for one in access_control["subjects"] if common_name in one["cert_common_names"]}
    ids = {
        rule for policy in access_control["policies"] if subjects & set(policy["subjects"]) for rule in policy["rules"]
    }
    asked = zenoh.KeyExpr(key)
    return any(
        rule["permission"] == "allow" and any(zenoh.KeyExpr(own).includes(asked) for own in rule["key_exprs"])
        for rule in access_control["rules"]
        if rule["id"] in ids and flow in rule["flows"] and message in rule["messages"]
    )
