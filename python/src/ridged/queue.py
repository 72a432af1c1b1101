"""The queue: parts in sequence, each by its recipe."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, cast

from . import steps
from ._api import OrderBody, OrderState, QueueBody
from ._connection import Connection
from ._progress import Bar, Progress, ShowProgress
from .errors import QueueStopped
from .jobs import FOLLOWS_S, Pace
from .steps import OnStep, OperatorStep


class Queue:
    """The queue of the daemon."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __repr__(self) -> str:
        return f"<queue: {self.status()['message']}>"

    def status(self) -> QueueBody:
        """Returns its state, what it waits for, the present and the next order, and the counts."""
        return cast("QueueBody", self._connection.get("/queue"))

    def orders(self, state: OrderState | None = None, *, limit: int | None = None) -> list[OrderBody]:
        """Returns the orders in sequence: those that run or wait, or those in one state."""
        return list(self._connection.pages("/queue/orders", {"state": state}, limit))

    def order(self, number: int) -> OrderBody:
        """Returns an order with its scan and verdict."""
        return cast("OrderBody", self._connection.get(f"/queue/orders/{number}"))

    def add(
        self,
        parts: str | Mapping[str, Any] | Iterable[str | Mapping[str, Any]],
        *,
        recipe: str | int | None = None,
        specification: str | int | None = None,
        lot: str | None = None,
        operator_name: str | None = None,
        note: str | None = None,
    ) -> list[OrderBody]:
        """Adds orders at the end, all or none, and returns them.

        A part is its name, or a mapping with `part` (or `sample_id`) and optionally `recipe`, `specification`, `lot`,
        `external_id`, `operator_name` and `note`; the arguments fill what it leaves out. A name that the store does not
        know becomes a new part with the material of the recipe. Raises Conflict for an external id that another order
        has, Invalid for a value that is not valid (`fields` names the order, as `orders[3].recipe`).
        """
        given = {
            "recipe": recipe,
            "specification": specification,
            "lot": lot,
            "operator_name": operator_name,
            "note": note,
        }
        common = {name: value for name, value in given.items() if value is not None}
        listed = [parts] if isinstance(parts, str | Mapping) else parts
        orders = [common | ({"part": part} if isinstance(part, str) else dict(part)) for part in listed]
        added = self._connection.post("/queue/orders", {"orders": orders})
        return cast("list[OrderBody]", added["items"])

    def start(self) -> QueueBody:
        """Starts it, or resumes it and the scan of its order."""
        return self._do("start")

    def stop(self) -> QueueBody:
        """Stops it after the present order."""
        return self._do("stop")

    def pause(self) -> QueueBody:
        """Pauses it and the scan of its order."""
        return self._do("pause")

    def confirm(self) -> QueueBody:
        """Confirms the operator step of the present order, for instance that its part is on the table."""
        return self._do("continue")

    def _do(self, order: str) -> QueueBody:
        return cast("QueueBody", self._connection.post(f"/queue/{order}"))

    def move(self, number: int, to: int) -> OrderBody:
        """Moves a waiting order to a place among those that wait; 1 is the next one."""
        return cast("OrderBody", self._connection.post(f"/queue/orders/{number}/move", {"to": to}))

    def retry(self, number: int) -> OrderBody:
        """Lets a failed order wait again, as the next one."""
        return cast("OrderBody", self._connection.post(f"/queue/orders/{number}/retry"))

    def remove(self, number: int) -> OrderBody:
        """Removes a waiting or failed order. It stays on record."""
        return cast("OrderBody", self._connection.delete(f"/queue/orders/{number}"))

    def wait(
        self, *, timeout_s: float | None = None, progress: ShowProgress = True, on_step: OnStep | None = None
    ) -> QueueBody:
        """Waits until no order runs or waits and the fits and verdicts of its orders are over; shows how far the queue is.

        Its orders are those that ran or waited since the call. A fit or verdict that fails is no error.

        `on_step` is called at each operator step, as in `Scan.wait`. A paused queue can be resumed by another program, so
        the wait continues. Raises QueueStopped if the queue stops while orders wait, TimedOut after `timeout_s`.
        """
        on_step = on_step or steps.default()
        pace = Pace("the queue", timeout_s)
        announced: object = None
        own = {order["id"] for order in self.orders()}
        with Bar(progress) as bar:
            while True:
                now = self.status()
                counts = now["counts"]
                left = counts["running"] + counts["waiting"]
                if left == 0:
                    for number in sorted(own):
                        self._until_judged(number, pace, bar)
                    return now
                if now["state"] == "stopped" and counts["running"] == 0:
                    raise QueueStopped(f"the queue is stopped while {left} orders wait: {now['message']}", now)
                bar.update(progress_of(now))
                current = now.get("current")
                begins = now.get("next")
                own |= {current["order"]["id"]} if current else set()
                own |= {begins["id"]} if begins else set()
                operator = current.get("operator") if current else None
                at = (now["state"], current and current["order"]["id"], operator and operator["action"])
                if at != announced:
                    announced = at
                    if current and operator:
                        scan_id = current["order"]["scan_id"] or 0
                        step = OperatorStep(scan_id, operator["action"], operator["message"])
                        bar.note(f"scan {scan_id}: {step.message}")
                        if on_step(step):
                            self._confirmed(step)
                            continue
                    elif now["state"] == "paused":
                        bar.note(now["message"])
                pace.wait()

    def _until_judged(self, number: int, pace: Pace, bar: Bar) -> None:
        """Waits until what follows a done order is over. A fit or a verdict that the daemon does not start is no error."""
        order = self.order(number)
        scan_id = order.get("scan_id")
        if order["state"] != "done" or scan_id is None:
            return
        of_scan = {"scan_id": scan_id}
        until = time.monotonic() + FOLLOWS_S
        while True:
            fits = [row["state"] for row in self._connection.pages("/fits", {**of_scan, "fields": "state"}, None)]
            verdicts = [row["state"] for row in self._connection.pages("/verdicts", of_scan, None)]
            if "running" in fits or "running" in verdicts:
                # The verdict begins a moment after the fit.
                until = time.monotonic() + FOLLOWS_S
            else:
                expected = fits.count("completed") if order.get("specification") else 0
                over = [state for state in fits if state != "interrupted"]
                if (over and len(verdicts) >= expected) or time.monotonic() >= until:
                    return
            bar.update(Progress("queue", 1.0, None, f"fit and verdict of {order['part']}"))
            pace.wait()

    def _confirmed(self, step: OperatorStep) -> None:
        from .scans import Scan

        Scan(self._connection, self._connection.get(f"/scans/{step.scan_id}")).confirm(step)


def progress_of(now: QueueBody) -> Progress:
    """How far a queue is, by its orders."""
    counts = now["counts"]
    over = counts["done"] + counts["failed"]
    total = over + counts["running"] + counts["waiting"]
    failed = f", {counts['failed']} failed" if counts["failed"] else ""
    return Progress("queue", over / max(total, 1), None, f"{over} of {total} orders{failed}")
