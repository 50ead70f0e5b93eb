"""Pure functions by subject: maps, localisation, navigation, exploration, allocation, energy, motes and consensus.

Nothing here has a session or reads a clock. Value types and messages come from `protocol`.
"""
