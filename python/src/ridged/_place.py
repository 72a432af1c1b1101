"""Where the daemon is: an address that was given, or the notice in a data folder."""

from __future__ import annotations

import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path

import httpx

from .errors import NoDaemon, WrongValue

#: Files of the data folder, written by the daemon.
NOTICE, SECRET, LOCK, DATABASE = "daemon.json", "daemon.secret", "lock", "ridged.sqlite"
DEFAULT_FOLDER = Path("ridged-data")


@dataclass(frozen=True)
class Address:
    """Address of a daemon, and the token for it."""

    url: str
    token: str | None

    def __repr__(self) -> str:
        return f"Address({self.url!r})"


@dataclass(frozen=True)
class FixedPlace:
    """An address that was given."""

    address: Address

    def find(self) -> Address:
        """Returns the address."""
        return self.address


@dataclass(frozen=True)
class FolderPlace:
    """A data folder of this machine. After a restart its daemon may have another port and another secret."""

    folder: Path
    token: str | None

    def find(self) -> Address:
        """Returns the address of the daemon that runs on the folder.

        Raises NoDaemon if none does.
        """
        if not is_held(self.folder):
            raise NoDaemon(
                f"no daemon runs on {self.folder}; start one with `ridged serve`, or name its data folder (data=) or its "
                "address (ridged.connect(\"http://HOST:PORT\"))"
            )
        try:
            url = json.loads((self.folder / NOTICE).read_text())["url"]
        except (OSError, ValueError, KeyError, TypeError):
            raise NoDaemon(
                f"a ridged process holds {self.folder} but takes no requests: a scan without a daemon, or a daemon that "
                "is starting or ending"
            ) from None
        return Address(str(url), self.token or secret_of(self.folder))


Place = FixedPlace | FolderPlace


def is_held(folder: Path) -> bool:
    """Whether a process has locked a data folder: the folder itself, or the file in it, as earlier programs do.

    The notice of a killed daemon remains, so it proves nothing.
    """
    try:
        import fcntl
    except ImportError:
        # No daemon runs on Windows; a client there gives an address.
        return False
    for path in (folder, folder / LOCK):
        try:
            opened = os.open(path, os.O_RDONLY)
        except OSError:
            continue
        try:
            fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            continue
        finally:
            os.close(opened)
    return False


def secret_of(folder: Path) -> str | None:
    """Returns the secret of the daemon, which only its own user can read."""
    try:
        return (folder / SECRET).read_text().strip() or None
    except OSError:
        return None


def token_of(file: Path) -> str:
    """Reads a token file.

    Raises WrongValue if it cannot be read, if other users can read it, or if it has no token.
    """
    try:
        mode = stat.S_IMODE(file.stat().st_mode)
        token = file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise WrongValue(f"token file {file}: {words_of(error)}") from error
    if mode & 0o077:
        raise WrongValue(f"token file {file}: its mode is {mode:o}, so that others can read it; run `chmod 600 {file}`")
    if not token or any(c.isspace() or not c.isprintable() for c in token):
        raise WrongValue(f"token file {file}: expected one token, as `ridged token create` prints it")
    return token


def words_of(error: OSError | UnicodeDecodeError) -> str:
    """Why a file cannot be read, without its name."""
    return error.strerror or str(error) if isinstance(error, OSError) else "it is not a text"


def held_folders() -> list[Path]:
    """Data folders that daemons of this user hold, by the open files of its processes."""
    found = set()
    for process in Path("/proc").glob("[0-9]*/fd"):
        try:
            links = [os.readlink(entry) for entry in process.iterdir()]
        except OSError:
            continue
        for link in links:
            file = Path(link)
            if file.name in (LOCK, f"{LOCK} (deleted)") and (file.parent / DATABASE).is_file() and (file.parent / NOTICE).is_file():
                found.add(file.parent)
    return sorted(folder for folder in found if is_held(folder))


def default_folder() -> Path:
    """Returns `ridged-data` in the current folder if a daemon runs there, else the folder of the only daemon of this user.

    Raises NoDaemon if none or several run.
    """
    if is_held(DEFAULT_FOLDER):
        return DEFAULT_FOLDER
    folders = held_folders()
    match folders:
        case [folder]:
            return folder
        case []:
            raise NoDaemon(
                "no daemon of this user runs on this machine; start one with `ridged serve` (or `ridged serve "
                '--simulated-rig`), or give an address: ridged.connect("http://HOST:PORT")'
            )
        case _:
            names = ", ".join(str(folder) for folder in folders)
            raise NoDaemon(f"several daemons run on this machine; name the data folder of one (data=): {names}")


def is_address(url: str) -> bool:
    """Whether a text is an address of HTTP with a host."""
    try:
        parts = httpx.URL(url)
    except httpx.InvalidURL:
        return False
    return parts.scheme in ("http", "https") and bool(parts.host)


def place_of(
    url: str | None, token: str | None, token_file: str | Path | None, data: str | Path | None
) -> Place:
    """Returns where the daemon is, by the arguments of `connect` and the variable RIDGED_TOKEN_FILE.

    Raises WrongValue for arguments that exclude each other, NoDaemon if no daemon is found.
    """
    if url is not None and data is not None:
        raise WrongValue("give an address or a data folder, not both")
    if token is not None and token_file is not None:
        raise WrongValue("give token or token_file, not both")
    file = token_file or (None if token else os.environ.get("RIDGED_TOKEN_FILE"))
    if file:
        token = token_of(Path(file))
    if url is None:
        return FolderPlace(Path(data) if data is not None else default_folder(), token)
    if not is_address(url):
        raise WrongValue(f"expected an address such as http://127.0.0.1:8787, got {url!r}")
    return FixedPlace(Address(url.rstrip("/"), token))
