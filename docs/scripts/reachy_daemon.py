"""Installs the daemon of Reachy Mini's maker in an environment of its own, and starts its simulation.

`python docs/scripts/reachy_daemon.py FOLDER [PORT]` installs it in a folder, the first time, wakes the head, and
runs it until Ctrl-C: some 400 MB, no compiler, no camera and no sound. `stewart-drake` reaches it at
`reachy://127.0.0.1:PORT`, 8000 by default.
"""

import json
import os
import subprocess
import sys
import time
import urllib.request
import venv
from pathlib import Path
from typing import Any

DAEMON = "reachy_mini==1.12.0"
# What it needs but for its camera and sound, which would need GStreamer.
NEEDS = [
    "aiohttp",
    "asgiref",
    "fastapi",
    "huggingface-hub",
    "jinja2",
    "libusb_package",
    "log-throttling==0.0.3",
    "mujoco==3.3.0",
    "numpy",
    "onnxruntime==1.27.0",
    "platformdirs",
    "psutil",
    "pulsectl",
    "pyserial",
    "python-multipart",
    "pyusb",
    "questionary",
    "reachy-mini-rust-kinematics",
    "reachy_mini_motor_controller",
    "requests",
    "rich",
    "rustypot",
    "scipy",
    "starlette",
    "toml",
    "uvicorn[standard]",
    "websockets<16",
    "zeroconf",
]
# In the place of PyGObject, which it imports and then does not use.
NO_GOBJECT = """
class _Anything:
    def __getattr__(self, name):
        return _Anything()

    def __call__(self, *given, **named):
        return _Anything()


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return _Anything()
"""
FLAGS = [
    "--sim",
    "--headless",
    "--no-media",
    "--no-wake-up-on-start",
    "--no-goto-sleep-on-stop",
    "--no-preload-datasets",
    "--fastapi-port",
]


def install(folder: Path) -> None:
    """Makes the environment; one that was not finished is made again."""
    if folder.exists() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").exists():
        sys.exit(f"{folder} has other things in it; name a new folder")
    venv.create(folder, with_pip=True, clear=True)
    pip = [folder / "bin" / "python", "-P", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--no-deps", DAEMON], check=True)
    subprocess.run([*pip, *NEEDS], check=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "gi").mkdir()
    (packages / "gi" / "__init__.py").write_text("def require_version(*given):\n    pass\n", encoding="utf-8")
    (packages / "gi" / "repository.py").write_text(NO_GOBJECT, encoding="utf-8")
    (folder / "installed").touch()


def start(folder: Path, port: int) -> "subprocess.Popen[bytes]":
    """The daemon with its simulation, installed where it is not there yet."""
    if not (folder / "installed").exists():
        install(folder)
    command = [folder / "bin" / "reachy-mini-daemon", *FLAGS, str(port)]
    return subprocess.Popen(command, env={**os.environ, "HF_HUB_OFFLINE": "1"})


def wake(port: int) -> None:
    """Wakes the head of a daemon that may not answer yet, and waits until it is at home."""

    def ask(what: str, method: str) -> Any:
        request = urllib.request.Request(f"http://127.0.0.1:{port}/api/move/{what}", method=method)
        with urllib.request.urlopen(request, timeout=5.0) as answer:
            return json.load(answer)

    ends = time.monotonic() + 60.0
    while True:
        try:
            waking = ask("play/wake_up", "POST")
            break
        except OSError:
            if time.monotonic() > ends:
                raise
            time.sleep(0.5)
    while waking in ask("running", "GET"):
        time.sleep(0.1)


if __name__ == "__main__":
    where = int(sys.argv[2]) if len(sys.argv) > 2 else 8000
    daemon = start(Path(sys.argv[1]).absolute(), where)
    try:
        wake(where)
        print(f"awake: reachy://127.0.0.1:{where}", flush=True)
        sys.exit(daemon.wait())
    except OSError as error:
        daemon.terminate()
        sys.exit(f"the daemon has not woken the head within a minute: {error}")
    except KeyboardInterrupt:
        daemon.wait()
