"""The border: what comes from outside is decoded, checked and counted here."""
