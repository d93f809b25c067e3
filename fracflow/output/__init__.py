"""The results of a run: its folder, history, events, fields and pictures. Rank 0 only, plain NumPy."""

from fracflow.output.events import EventLog, FractureNodes, read_events
from fracflow.output.fields import FieldWriter, list_steps, read_mesh, read_step
from fracflow.output.folder import RunFolder
from fracflow.output.history import HistoryFile, read_attributes, read_history

__all__ = [
    "EventLog",
    "FieldWriter",
    "FractureNodes",
    "HistoryFile",
    "RunFolder",
    "list_steps",
    "read_attributes",
    "read_events",
    "read_history",
    "read_mesh",
    "read_step",
]
