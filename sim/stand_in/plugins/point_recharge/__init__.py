"""Point recharge: goes to a charger, when told and when it must."""
