"""Slamtec's RPLIDAR A-series, on a serial line."""
