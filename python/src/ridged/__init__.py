"""Client of ridged, which measures the ridge angle of micro-structured surfaces.

    import ridged
    lab = ridged.connect()
    scan = lab.measure("B-17", preset="paper")
    scan.wait()
    print(scan.fit.theta_r)
    table = scan.observations()
"""

from ._progress import Progress
from .errors import (
    Conflict,
    ConnectionLost,
    Invalid,
    LeaseHeld,
    LeaseLost,
    MotionFailed,
    NoDaemon,
    NotFound,
    QueueStopped,
    Refused,
    RidgedError,
    ScanStopped,
    TimedOut,
    Unauthorized,
    Unavailable,
    WorkFailed,
    WrongValue,
)
from .fits import Fit, Quantity
from .jobs import Files, Map, Work
from .lab import Lab, connect
from .queue import Queue
from .rig import Lease, Preview, Rig, RigStatus
from .samples import Sample
from .scans import Scan
from .steps import OperatorStep, ask, confirm, show

__version__ = "0.1.0"

__all__ = [
    "Conflict",
    "ConnectionLost",
    "Files",
    "Fit",
    "Invalid",
    "Lab",
    "Lease",
    "LeaseHeld",
    "LeaseLost",
    "Map",
    "MotionFailed",
    "NoDaemon",
    "NotFound",
    "OperatorStep",
    "Preview",
    "Progress",
    "Quantity",
    "Queue",
    "QueueStopped",
    "Refused",
    "RidgedError",
    "Rig",
    "RigStatus",
    "Sample",
    "Scan",
    "ScanStopped",
    "TimedOut",
    "Unauthorized",
    "Unavailable",
    "Work",
    "WorkFailed",
    "WrongValue",
    "ask",
    "confirm",
    "connect",
    "show",
]
