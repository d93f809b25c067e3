"""What a run leaves: its recorder, its totals, its catalogue of events, and when it saves."""
