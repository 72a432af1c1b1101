"""Daemons on simulated rigs, each in its own folder, and one scan that many tests read."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import ridged

ROOT = Path(__file__).resolve().parents[2]
RIDGED = Path(os.environ.get("RIDGED_BIN", ROOT / "target/debug/ridged")).resolve()
#: Ample time for a debug binary on a busy machine, s.
READY_S = 60.0


class Daemon:
    """A running `ridged serve --simulated-rig`."""

    def __init__(self, folder: Path, *options: str, settings: str = "") -> None:
        self.folder = folder
        self.data = folder / "ridged-data"
        self._settings = settings
        self._options = options
        self.start()

    def start(self) -> None:
        """Starts it, on a port of its own."""
        command = [str(RIDGED), "serve", "--simulated-rig", "--listen", "127.0.0.1:0", "--data", str(self.data)]
        command += self._options or ("--time-scale", "500")
        if self._settings:
            (self.folder / "rig.toml").write_text(self._settings)
            command += ["--config", "rig.toml"]
        self._log = (self.folder / "log.txt").open("a")
        self.process = subprocess.Popen(
            command, cwd=self.folder, stdout=subprocess.PIPE, stderr=self._log, text=True
        )
        lines: queue.Queue[str] = queue.Queue()
        stdout = self.process.stdout
        assert stdout is not None
        threading.Thread(target=lambda: lines.put(stdout.readline()), daemon=True).start()
        try:
            ready = lines.get(timeout=READY_S)
        except queue.Empty:
            ready = ""
        if not ready.startswith("listening on "):
            self.kill()
            raise RuntimeError(f"the daemon is not ready: {ready!r}\n{(self.folder / 'log.txt').read_text()[-2000:]}")
        self.url = ready.removeprefix("listening on ").strip()

    def kill(self) -> None:
        """Ends it at once, as a power cut does."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        """Ends it as Ctrl-C does."""
        self._end(signal.SIGINT)

    def _end(self, by: signal.Signals) -> None:
        if self.process.poll() is None:
            self.process.send_signal(by)
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._log.close()


@pytest.fixture(scope="session", autouse=True)
def _program() -> None:
    assert RIDGED.is_file(), f"there is no program {RIDGED}: run `cargo build`, or set RIDGED_BIN"


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RIDGED_TOKEN_FILE", "RIDGED_LEASE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="session")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    running = Daemon(tmp_path_factory.mktemp("lab"))
    yield running
    running.stop()


@pytest.fixture(scope="session")
def lab(daemon: Daemon) -> Iterator[ridged.Lab]:
    with ridged.connect(data=daemon.data) as connected:
        yield connected


@pytest.fixture(scope="session")
def scan(lab: ridged.Lab) -> ridged.Scan:
    """A completed scan of a sample with a ridge angle of 15°."""
    started = lab.measure("model 15°", preset="paper")
    return started.wait(on_step=ridged.confirm, progress=False, timeout_s=120)


@pytest.fixture
def own_daemon(tmp_path: Path) -> Iterator[Callable[..., Daemon]]:
    """Starts daemons of one test."""
    running: list[Daemon] = []

    def start(*options: str, settings: str = "") -> Daemon:
        folder = tmp_path / f"daemon-{len(running)}"
        folder.mkdir()
        running.append(Daemon(folder, *options, settings=settings))
        return running[-1]

    yield start
    for one in running:
        one.stop()
