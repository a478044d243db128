"""Time and identity: who is where, and how fast."""
