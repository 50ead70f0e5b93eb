"""Numbers: functions and small matrices with the same result on every processor."""
