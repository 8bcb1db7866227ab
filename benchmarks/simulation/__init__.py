"""The simulator's time, policies and infractions."""
