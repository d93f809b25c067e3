"""Figures of the aim in numbers: schedules of the wells of 5.5, what they release and by how large an event."""
