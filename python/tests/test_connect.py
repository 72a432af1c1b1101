"""Where the daemon is found, who one is there, and what happens when it is away."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import ridged
from conftest import RIDGED, Daemon
from ridged import _place

StartDaemon = Callable[..., Daemon]


def test_a_data_folder_leads_to_its_daemon(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    with ridged.connect(data=daemon.data) as lab:
        assert (lab.url, lab.who, lab.role) == (daemon.url, "local", "admin")
    monkeypatch.chdir(daemon.folder)
    with ridged.connect() as lab:
        assert lab.url == daemon.url
    with ridged.connect(daemon.url + "/") as lab:
        assert lab.url == daemon.url


def test_the_only_daemon_of_the_user_is_found_from_any_folder(
    daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert daemon.data in _place.held_folders()
    monkeypatch.setattr(_place, "held_folders", lambda: [daemon.data])
    with ridged.connect() as lab:
        assert lab.url == daemon.url
    monkeypatch.setattr(_place, "held_folders", lambda: [daemon.data, tmp_path])
    with pytest.raises(ridged.NoDaemon, match=f"several daemons .*{daemon.data}, {tmp_path}"):
        ridged.connect()
    monkeypatch.setattr(_place, "held_folders", list)
    with pytest.raises(ridged.NoDaemon, match="ridged serve"):
        ridged.connect()


def test_a_daemon_is_found_when_its_lock_file_was_deleted(own_daemon: StartDaemon) -> None:
    daemon = own_daemon()
    (daemon.data / "lock").unlink()
    assert daemon.data in _place.held_folders()
    with ridged.connect(data=daemon.data) as lab:
        assert lab.url == daemon.url


def test_a_folder_without_a_daemon_and_a_wrong_address_are_named(tmp_path: Path) -> None:
    # The notice of a daemon that was killed proves nothing.
    (tmp_path / "daemon.json").write_text(json.dumps({"url": "http://127.0.0.1:9", "process": 1}))
    (tmp_path / "lock").write_text("")
    with pytest.raises(ridged.NoDaemon, match=f"no daemon runs on {tmp_path}"):
        ridged.connect(data=tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(ridged.NoDaemon, match=f"127.0.0.1:{port} does not answer"):
        ridged.connect(f"http://127.0.0.1:{port}")
    for address in ("lab-pc", "127.0.0.1:8787", "http://", "http://lab-pc:port", "http://[::1"):
        with pytest.raises(ridged.WrongValue, match="expected an address"):
            ridged.connect(address)
    missing = tmp_path / "missing"
    with pytest.raises(ridged.WrongValue, match=f"token file {missing}: No such file"):
        ridged.connect(f"http://127.0.0.1:{port}", token_file=missing)
    with pytest.raises(ridged.WrongValue, match=f"verify: {missing}: No such file"):
        ridged.connect(f"https://127.0.0.1:{port}", verify=str(missing))
    with pytest.raises(ridged.WrongValue, match="not both"):
        ridged.connect("http://lab-pc", data=tmp_path)


def test_a_token_has_its_role_and_the_owner_needs_none(
    own_daemon: StartDaemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = own_daemon(settings="[server]\ntoken_on_loopback = true\n")
    file = tmp_path / "viewer.token"
    command = [str(RIDGED), "token", "create", "anna", "--role", "viewer"]
    command += ["--out", str(file), "--data", str(daemon.data)]
    subprocess.run(command, check=True, capture_output=True)
    with pytest.raises(ridged.Unauthorized) as refused:
        ridged.connect(daemon.url)
    assert refused.value.code == "no-token"
    with ridged.connect(data=daemon.data) as lab:
        assert lab.role == "admin"
    monkeypatch.setenv("RIDGED_TOKEN_FILE", str(file))
    with ridged.connect(daemon.url) as lab:
        assert (lab.who, lab.role) == ("anna", "viewer")
        assert lab.rig.status().is_simulated
        with pytest.raises(ridged.Unauthorized) as refused:
            lab.rig.move(theta_c_deg=1)
        assert refused.value.code == "role-too-low"
        lab.rig.stop()
        assert file.read_text().strip() not in repr(lab) + repr(lab._connection.address)
    file.chmod(0o644)
    with pytest.raises(ridged.WrongValue, match="chmod 600"):
        ridged.connect(daemon.url)


class LossyProxy:
    """Forwards connections to a daemon, and loses the answers to the first POSTs."""

    def __init__(self, port: int, losses: int) -> None:
        self._port = port
        self.losses_left = losses
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._forward, args=(client,), daemon=True).start()

    def _forward(self, client: socket.socket) -> None:
        with client, socket.create_connection(("127.0.0.1", self._port)) as daemon:
            while request := client.recv(65536):
                daemon.sendall(request)
                # A body may follow its head.
                client.settimeout(0.05)
                try:
                    while more := client.recv(65536):
                        daemon.sendall(more)
                except TimeoutError:
                    pass
                client.settimeout(None)
                answer = daemon.recv(65536)
                if request.startswith(b"POST") and self.losses_left:
                    self.losses_left -= 1
                    return
                client.sendall(answer)

    def close(self) -> None:
        self._server.close()


def test_a_request_whose_answer_was_lost_is_executed_once(daemon: Daemon, lab: ridged.Lab) -> None:
    proxy = LossyProxy(int(daemon.url.rsplit(":", 1)[1]), losses=2)
    try:
        with ridged.connect(proxy.url) as through:
            added = through.add_sample("sent three times", index=1.5)
    finally:
        proxy.close()
    assert proxy.losses_left == 0
    assert [sample.id for sample in lab.samples("sent three times")] == [added.id]


def test_a_restarted_daemon_is_found_again_and_the_scan_resumes(own_daemon: StartDaemon) -> None:
    daemon = own_daemon()
    with ridged.connect(data=daemon.data) as lab:
        first_url = lab.url
        scan = lab.measure("model 15°", theta_c_deg=[-20, -10, 0, 10, 20], phi_s_deg=range(0, 300, 30), exposures_s=[0.02])
        events = lab.events(since=0)
        seen = [next(events)]

        def kill_once(progress: ridged.Progress) -> None:
            if scan.body["progress"]["frames_done"] > 15 and daemon.process.poll() is None and lab.url == first_url:
                daemon.kill()
                daemon.start()

        with pytest.raises(ridged.ScanStopped, match=r"interrupted.*scan.resume\(\)") as stopped:
            scan.wait(on_step=ridged.confirm, progress=kill_once, timeout_s=120)
        assert stopped.value.scan.state == "interrupted"
        assert lab.url != first_url
        scan.resume()
        scan.wait(on_step=ridged.confirm, progress=False, timeout_s=120)
        assert len(scan.observations(rows=True)) == 50
        while not (seen[-1]["type"] == "scan" and seen[-1]["state"] == "completed"):
            seen.append(next(events))
        recorded = [event["id"] for event in seen if event["id"]]
        assert recorded == list(range(1, recorded[-1] + 1)), "no event is missed and none is repeated"
