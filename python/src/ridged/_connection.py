"""The connection: HTTP with token, lease, idempotency keys, and repetition while the daemon is away."""

from __future__ import annotations

import logging
import math
import ssl
import threading
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from ._place import FolderPlace, Place
from .errors import ConnectionLost, NoDaemon, WrongValue, problem_of, refusal

logger = logging.getLogger("ridged")

#: Routes whose answers the daemon does not keep: each stop stops, and the answer of the lease has a secret.
UNKEYED = ("/rig/stop", "/rig/preview", "/lease")
#: Refusals that pass by themselves.
PASSING = {"too-many-connections", "too-many-streams", "store-locked", "disk-silent", "stopping"}
#: Time to wait for the answer to a request, s. Imports are waited for without a limit.
ANSWER_S = 60.0
#: The daemon writes to an open event stream every 3 s, so one that is silent for longer is broken.
SILENCE_S = 15.0


class Connection:
    """Sends requests to one daemon; threads may share it."""

    def __init__(
        self, place: Place, *, lease: str | None, patience_s: float, verify: bool | str | ssl.SSLContext
    ) -> None:
        if isinstance(verify, str):
            try:
                verify = ssl.create_default_context(cafile=verify)
            except OSError as error:
                # An error of the certificates is an OSError, too.
                raise WrongValue(f"verify: {verify}: {error.strerror or error}") from error
        self.place = place
        self.lease = lease
        self.patience_s = patience_s
        self.address = place.find()
        # Proxies of the environment are for the internet; the rig is nearby.
        self._client = httpx.Client(verify=verify, trust_env=False, timeout=ANSWER_S)
        self._finding = threading.Lock()
        self._is_closed = False

    def close(self) -> None:
        """Closes all open connections."""
        self._is_closed = True
        self._client.close()

    def get(self, path: str, params: Mapping[str, Any] | None = None) -> Any:
        """Gets JSON from a path below /api/v1."""
        return self.send("GET", path, params=params).json()

    def post(self, path: str, body: object = None, *, timeout_s: float | None = ANSWER_S) -> Any:
        """Posts a body, or none. The daemon executes it once, even if it must be sent again."""
        return self.send("POST", path, body=body, timeout_s=timeout_s).json()

    def upload(self, path: str, file: Path, content_type: str, params: Mapping[str, Any]) -> Any:
        """Sends a file, part by part, and waits for the answer however long it takes. It is sent once."""
        with file.open("rb") as content:
            answer = self._client.post(
                f"{self.address.url}/api/v1{path}",
                content=content,
                params=params,
                headers={"content-type": content_type} | self._credentials(),
                timeout=None,
            )
        if not answer.is_success:
            raise refusal(answer)
        return answer.json()

    def patch(self, path: str, body: object) -> Any:
        """Sends a correction."""
        return self.send("PATCH", path, body=body).json()

    def delete(self, path: str) -> Any:
        """Deletes what is at a path."""
        return self.send("DELETE", path).json()

    def bytes_of(self, path: str) -> bytes:
        """Gets a file."""
        return self.send("GET", path).content

    def pages(self, path: str, params: Mapping[str, Any], limit: int | None) -> Iterator[Any]:
        """Yields the rows of a list, page by page, at most `limit`."""
        asked = {name: value for name, value in params.items() if value is not None}
        left = limit
        while left is None or left > 0:
            page = self.get(path, {**asked, "limit": min(left or 200, 200)})
            yield from page["items"]
            left = None if left is None else left - len(page["items"])
            asked["cursor"] = page["next_cursor"]
            if asked["cursor"] is None:
                return

    def send(
        self,
        method: str,
        path: str,
        *,
        body: object = None,
        params: Mapping[str, Any] | None = None,
        timeout_s: float | None = ANSWER_S,
    ) -> httpx.Response:
        """Sends a request until it is answered, or until the patience ends.

        Raises the daemon's refusal as an error, and WrongValue for a value that JSON cannot have.
        """
        check("", body)
        headers = {}
        if method == "POST" and path not in UNKEYED:
            headers["idempotency-key"] = str(uuid.uuid4())
        # A lease that was taken without its answer could not be presented: only that order is never sent twice.
        patience_s = 0.0 if (method, path) == ("POST", "/lease") else self.patience_s
        for attempt in Attempts(patience_s):
            try:
                address = self.address
                answer = self._client.request(
                    method,
                    f"{address.url}/api/v1{path}",
                    json=body,
                    params=params,
                    headers=headers | self._credentials(),
                    timeout=timeout_s,
                )
            except (httpx.TransportError, RuntimeError) as error:
                # Another thread may have closed the connection during the request.
                if self._is_closed:
                    raise ConnectionLost("this program has closed the connection") from error
                if isinstance(error, RuntimeError):
                    raise
                attempt.failed(f"the daemon at {self.address.url} does not answer: {error or type(error).__name__}")
                self.find_again()
                continue
            if answer.is_success:
                return answer
            # A daemon that was started again has a new secret.
            if answer.status_code == 401 and attempt.number == 0 and self.find_again():
                continue
            if answer.status_code in (429, 503) and problem_of(answer)["code"] in PASSING:
                attempt.refused(refusal(answer))
                continue
            raise refusal(answer)
        raise AssertionError("the last attempt raises")

    @contextmanager
    def stream(self, path: str, params: Mapping[str, Any], headers: Mapping[str, str]) -> Iterator[httpx.Response]:
        """Opens a stream. Raises httpx.TransportError when it breaks off."""
        limits = httpx.Timeout(ANSWER_S, read=SILENCE_S)
        url = f"{self.address.url}/api/v1{path}"
        sent = {**headers, **self._credentials()}
        with self._client.stream("GET", url, params=params, headers=sent, timeout=limits) as answer:
            if not answer.is_success:
                answer.read()
                raise refusal(answer)
            yield answer

    def _credentials(self) -> dict[str, str]:
        headers = {}
        if self.address.token:
            headers["authorization"] = f"Bearer {self.address.token}"
        if self.lease:
            headers["ridged-lease"] = self.lease
        return headers

    def find_again(self) -> bool:
        """Looks up the address again; returns whether it has changed."""
        if not isinstance(self.place, FolderPlace):
            return False
        with self._finding:
            try:
                found = self.place.find()
            except NoDaemon:
                return False
            changed = found != self.address
            self.address = found
            return changed


def check(path: str, value: object) -> None:
    """Raises WrongValue for the first part of a body that JSON cannot have, by its path: NaN, infinity, an object."""
    match value:
        case None | str() | bool() | int():
            pass
        case float():
            if not math.isfinite(value):
                raise WrongValue(f"{path}: expected a finite number, got {value}")
        case Mapping():
            for name, part in value.items():
                check(f"{path}.{name}" if path else str(name), part)
        case list() | tuple():
            for place, part in enumerate(value):
                check(f"{path}[{place}]", part)
        case _:
            raise WrongValue(f"{path}: expected a number, a text, a list or a mapping, got {type(value).__name__}")


class Attempt:
    """One attempt of several."""

    def __init__(self, number: int, until: float) -> None:
        self.number = number
        self._until = until

    def failed(self, why: str) -> None:
        """Waits before the next attempt, or raises ConnectionLost if the patience is over."""
        if time.monotonic() >= self._until:
            raise ConnectionLost(why)
        if self.number == 0:
            left_s = self._until - time.monotonic()
            logger.warning("%s; trying again for %.0f s", why, left_s)
        self._pause()

    def refused(self, error: Exception) -> None:
        """Waits before the next attempt, or raises the refusal if the patience is over."""
        if time.monotonic() >= self._until:
            raise error
        self._pause()

    def _pause(self) -> None:
        time.sleep(min(0.1 * 2.0 ** min(self.number, 5), 2.0))


class Attempts:
    """Attempts until a patience ends; each waits longer than the one before."""

    def __init__(self, patience_s: float) -> None:
        self._until = time.monotonic() + patience_s

    def __iter__(self) -> Iterator[Attempt]:
        number = 0
        while True:
            yield Attempt(number, self._until)
            number += 1
