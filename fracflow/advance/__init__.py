"""The kinds of stages: which steps they make, and when they change from rest to waves and back."""
