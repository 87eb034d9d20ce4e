"""The daemon of Reachy Mini's maker, simulated, in a virtual environment of its own under build/: `make daemon`.

It is installed without GStreamer, which only camera and sound need; a module that stands in for `gi` is all that the
daemon itself misses of it.
"""

import os
import socket
import subprocess
import time
import venv
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from stewart_drake import load_scenario
from stewart_drake.machines.machine import open_machine
from stewart_drake.mechanics.kinematics import inverse_kinematics

FOLDER = Path(__file__).parents[1] / "build" / "reachy_daemon"
VERSION = "1.12.0"
NEEDS = (
    "aiohttp asgiref fastapi huggingface-hub<2 jinja2 libusb_package log-throttling==0.0.3 mujoco==3.3.0 numpy"
    " onnxruntime==1.27.0 platformdirs psutil pulsectl pyserial python-multipart pyusb questionary"
    " reachy-mini-rust-kinematics reachy_mini_motor_controller requests rich rustypot scipy starlette toml"
    " uvicorn[standard] websockets<16 zeroconf"
)
STAND_IN = '''"""Stands in for PyGObject, of which a daemon without camera and sound needs nothing."""


def require_version(*_):
    pass


class _Anything:
    def __getattr__(self, _):
        return _Anything()

    def __call__(self, *_, **__):
        return _Anything()


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return _Anything()
'''
FLAGS = "--sim --headless --no-media --no-wake-up-on-start --no-goto-sleep-on-stop --no-preload-datasets"
STARTS_WITHIN = 60.0  # [s]
SERVOS = ["motors={kind: position, preset: perfect_actuator}", "controller={kind: feedforward}", "safety=null"]


def install() -> None:
    """Makes the environment: half a minute, 400 MB."""
    venv.create(FOLDER, clear=True, with_pip=True)
    pip = [FOLDER / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--no-deps", f"reachy_mini=={VERSION}"], check=True)
    subprocess.run([*pip, *NEEDS.split()], check=True)
    (where,) = FOLDER.glob("lib/python*/site-packages")
    for name in ("__init__", "repository"):
        (where / "gi").mkdir(exist_ok=True)
        (where / "gi" / f"{name}.py").write_text(STAND_IN, encoding="utf-8")
    (FOLDER / "installed").touch()


def installed() -> bool:
    """Whether `install` has ended."""
    return (FOLDER / "installed").exists()


@contextmanager
def daemon() -> Iterator[int]:
    """A daemon on a free port, until the end of the block; the head is brought to its home first."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [FOLDER / "bin" / "reachy-mini-daemon", *FLAGS.split(), "--fastapi-port", str(port)]
    with (FOLDER / "log.txt").open("w", encoding="utf-8") as said:
        process = subprocess.Popen(command, stdout=said, stderr=said, env={**os.environ, "HF_HUB_OFFLINE": "1"})
        try:
            _wait_for(port, process)
            _rise(port)
            yield port
        finally:
            process.terminate()
            process.wait()


def _rise(port: int) -> None:
    """To home: the head begins asleep, 50 mm low."""
    scenario = load_scenario("reachy_nod", SERVOS)
    machine = open_machine(f"reachy://localhost:{port}", scenario)
    machine.connect()
    for _ in range(100):
        machine.read()
        machine.command(inverse_kinematics(scenario.robot, scenario.robot.home_pose))
    machine.disconnect()


def _wait_for(port: int, process: "subprocess.Popen[bytes]") -> None:
    ends = time.monotonic() + STARTS_WITHIN
    while time.monotonic() < ends and process.poll() is None:
        with closing(socket.socket()) as asked:
            if asked.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    raise RuntimeError(f"the daemon does not start; see {FOLDER / 'log.txt'}")


if __name__ == "__main__":
    if not installed():
        install()
    with daemon() as at:
        print(f"reachy://localhost:{at}, Ctrl-C ends it", flush=True)
        with suppress(KeyboardInterrupt):
            while True:
                time.sleep(1.0)
