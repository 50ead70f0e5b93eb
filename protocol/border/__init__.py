"""The border: messages from outside are decoded, checked and counted here."""
