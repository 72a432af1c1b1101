"""The event stream, which continues after its last event when it breaks off."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import httpx

from ._connection import Attempts, Connection

#: Time between the end of a stream and the next one, s.
REOPEN_S = 0.2

Event = dict[str, Any]
"""An event: `id`, `at`, `who`, `type` (rig, scan, frame, fit, …) and the fields of its type."""


def follow(connection: Connection, since: int | None, positions: bool = False) -> Iterator[Event]:
    """Yields events as they happen, without end.

    When the stream breaks off, it continues after the last event that was received: none is missed, none is repeated.
    """
    last = since
    asked = {"positions": "true"} if positions else {}
    while True:
        for attempt in Attempts(connection.patience_s):
            is_open = False
            try:
                headers = {} if last is None else {"last-event-id": str(last)}
                with connection.stream("/events", asked, headers) as answer:
                    is_open = True
                    for event in parsed(answer.iter_lines()):
                        # An event that the daemon does not keep has a negative number, after which nothing continues.
                        if event["id"] > 0:
                            last = event["id"]
                        yield event
            except httpx.TransportError as error:
                if not is_open:
                    attempt.failed(f"the event stream broke off: {error or type(error).__name__}")
            connection.find_again()
            if is_open:
                break
        time.sleep(REOPEN_S)


def parsed(lines: Iterator[str]) -> Iterator[Event]:
    """Reads the `data` of server-sent events."""
    data: list[str] = []
    for line in lines:
        if line.startswith("data:"):
            data.append(line.removeprefix("data:").removeprefix(" "))
        elif not line and data:
            yield json.loads("\n".join(data))
            data.clear()
