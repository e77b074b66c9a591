# SPDX-License-Identifier: Apache-2.0
"""The steps of the set-up. A stamp follows each, by which the next call knows what is to be done."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from setup import environment
from setup.environment import PYTHON, ROOT, VENV, SetupError

INSTALL, WORK = ROOT / "install", ROOT / ".cache" / "setup"
STAMPS = {
    "wheels": VENV / "hydro-wheels.stamp",
    "checks": VENV / "hydro-checks.stamp",
    "build": INSTALL / "hydro-build.stamp",
}
"""Each goes with the folder that its step fills; one that was cut short equals no digest."""
KERNELS = ROOT / "src" / "hydro_sim" / "hydro_sim" / "__pycache__"
"""Of the stamps of kernels: with this folder their caches go."""
PINS = [ROOT / f"{name}.txt" for name in ("constraints", "requirements", "requirements-build", "requirements-ros",
                                          "requirements-dev")]  # fmt: skip
"""All hold in each call of uv: none brings along what another one replaces."""
CONTENTS = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt", "msg/*.msg", "srv/*.srv", "resource/*")
"""What a built package depends on; Python modules are linked into the installation."""
NAMES = ("launch/*", "config/*")
"""Linked one by one: their names count."""
BEGAN = time.monotonic()


def carry_out(checks: bool, kernels: str) -> str:
    """Bring the checkout up to date; interrupted anywhere, the next call goes on. Returns what stopped it, or nothing.

    `checks`: install what checks and tests need, too. `kernels`: compile "none", those of the "main-job" or "all".
    """
    try:
        ros = environment.sourced_ros(os.environ)
        if _needed(ros, checks, kernels):
            WORK.mkdir(parents=True, exist_ok=True)
            with (WORK / "lock").open("w") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    say("another set-up is at work here; waiting for it ...")
                    fcntl.flock(lock, fcntl.LOCK_EX)
                _make(ros, _needed(ros, checks, kernels), kernels)
            rest = ", and `make setup` compiles the other programs' kernels" if kernels == "main-job" else ""
            say(f"hydro is set up: `source install/setup.bash` in a shell of your own{rest}.")
    except SetupError as error:
        return str(error)
    return ""


def _make(ros: Path | None, needed: Mapping[str, str], kernels: str) -> None:
    """Carry out the steps. Colcon builds beside downloads and kernels, of which these wait for the box's C code."""
    fetching, building = environment.variables(os.environ, None), environment.variables(os.environ, ros)

    def install(title: str, *requirements: str) -> None:
        words = [word for pins in PINS for word in ("-c", str(pins))] + [*requirements]
        environment.INSTALLING.touch()
        _run(title, [str(VENV / "bin" / "uv"), "pip", "install", "--python", str(PYTHON), *words], fetching)
        environment.INSTALLING.unlink()

    if "wheels" in needed:
        environment.require_tools(ros)
        if not environment.is_usable(ros):
            for folder in (ROOT / "build", INSTALL):  # its interpreter and paths are written all over what was built
                shutil.rmtree(folder, ignore_errors=True)
            python = getattr(sys, "_base_executable", None) or sys.executable  # also where this one runs inside of one
            words = ["-m", "venv", "--clear", *(["--system-site-packages"] if ros else []), str(VENV)]
            _run(f"environment on Python {sys.version.split()[0]}", [python, *words], fetching)
        _run("uv", [str(PYTHON), "-m", "pip", "install", "--no-input", "-r", "requirements-setup.txt"], fetching)
    if "wheels" in needed or "checks" in needed:
        fetching = environment.with_pip_configuration(fetching)
    if "wheels" in needed:
        brought = ros and not subprocess.run([PYTHON, "-c", "import colcon_core, colcon_ros"], check=False).returncode
        files = ([] if ros else ["requirements-ros.txt"]) + ([] if brought else ["requirements-build.txt"])
        install("wheels to build with", "numpy", *(word for file in files for word in ("-r", file)))
        if ros is None:
            environment.adapt_wheels()
    with ThreadPoolExecutor(1) as beside:
        try:
            builds = []
            if "build" in needed:
                for link in (*(ROOT / "build").rglob("*"), *INSTALL.rglob("*")):
                    if link.is_symlink() and not link.exists():  # of a file that has left, which colcon would copy
                        link.unlink()
                _link_sources()
                for title, chosen in (("C code of the box", ["--packages-select", "hydro_firmware"]), ("packages", [])):
                    command = [str(PYTHON), "-m", "colcon", "build", "--symlink-install", "--metas", "colcon.meta"]
                    command += ["--base-paths", "src", "firmware", *chosen]
                    builds.append(beside.submit(_run, title, command, building))
            if "wheels" in needed:
                _install_torch(fetching)
                install("wheels of all programs", "-r", "requirements.txt")
                STAMPS["wheels"].write_text(needed["wheels"])
            if "checks" in needed:
                install("wheels of checks and tests", "-r", "requirements-dev.txt")
                STAMPS["checks"].write_text(needed["checks"])
            for box in builds[:1]:
                box.result()
            if "kernels" in needed:
                _compile(needed["kernels"], kernels, building)
            for packages in builds[1:]:
                packages.result()
                STAMPS["build"].write_text(needed["build"])
        finally:
            beside.shutdown(wait=False, cancel_futures=True)


def _install_torch(fetching: Mapping[str, str]) -> None:
    """Install torch's build for processors by pip, which finds it by the machine's own configuration; else any build.

    uv then takes what is installed. The other build, with CUDA, is announced before it is downloaded.
    """
    version = re.findall("(?m)^torch==(.+)", (ROOT / "requirements.txt").read_text())[0]
    command = [str(PYTHON), "-m", "pip", "install", "--no-input", "--no-deps", "--no-compile"]
    try:
        _run("torch", [*command, f"torch=={version}+cpu"], fetching)
    except SetupError:
        if platform.machine() == "x86_64":
            say(f"pip is configured to no index with torch {version}+cpu: what follows is the build with CUDA, 3 GB")
        _run("torch", [*command, f"torch=={version}"], fetching)
    sizes = re.findall(r"Downloading torch\S+ \(([\d.]+ \w+)\)", (WORK / "torch.log").read_text(errors="replace"))
    say(f"torch: {sizes[0] if sizes else 'nothing'} downloaded")


def _needed(ros: Path | None, checks: bool, kernels: str) -> dict[str, str]:
    """Digest of what each step that is to be done depends on."""
    made_by = (ROOT / name for name in ("requirements-setup.txt", "setup/environment.py", "setup/ros2.py"))
    wheels = digest([sys.version, sys.base_prefix, str(ros), str(ROOT)], [*PINS[:-1], *made_by])
    firmware = [path for pattern in ("*.*", "hydro/*.h") for path in (ROOT / "firmware").glob(pattern)]
    sources = [*package_inputs(ROOT / "src"), *firmware, ROOT / "colcon.meta"]
    wanted = {"wheels": wheels, "build": digest([wheels], sources)}
    if checks:
        wanted["checks"] = digest([wheels], PINS[-1:])
    broken = environment.INSTALLING.exists()
    needed = {
        name: to for name, to in wanted.items() if broken or not (at := STAMPS[name]).exists() or at.read_text() != to
    }
    processor = re.findall("(?m)^(?:model name|flags|Features).*", Path("/proc/cpuinfo").read_text())[:2]
    machine = digest([wheels, os.environ.get("NUMBA_CACHE_DIR", ""), *processor])
    stamps = {"none": (), "all": ("all",), "main-job": ("all", "main-job")}[kernels]
    if stamps and not any(is_compiled(KERNELS / f"kernels-{name}.json", machine) for name in stamps):
        needed["kernels"] = machine
    return needed


def digest(words: Iterable[str], files: Iterable[Path | str] = ()) -> str:
    """Return a digest of words and of files: of a path the name and the content, of a text the name alone."""
    sha = hashlib.sha256("\n".join(words).encode())
    for file in sorted(files, key=str):
        content = hashlib.sha256(file.read_bytes()).hexdigest() if isinstance(file, Path) else ""
        sha.update(f"\nfile {file} {content}".encode())
    return sha.hexdigest()


def package_inputs(source: Path) -> list[Path | str]:
    """Return the files of the packages below `source` that call for a build: by content, or, as texts, by name."""
    contents = [path for pattern in CONTENTS for path in source.glob(f"*/{pattern}") if path.is_file()]
    return [*contents, *(str(path) for pattern in NAMES for path in source.glob(f"*/{pattern}"))]


def is_compiled(stamp: Path, machine: str) -> bool:
    """Say whether the kernels of a stamp were compiled on this machine, and of the sources as they are."""
    try:
        found = json.loads(stamp.read_text())
        sources = {path: [(stat := os.stat(path)).st_mtime_ns, stat.st_size] for path in found["sources"]}
    except (OSError, ValueError, KeyError):
        return False
    return bool(found["machine"] == machine and sources == found["sources"])


def _compile(machine: str, kernels: str, building: Mapping[str, str]) -> None:
    """Compile in the environment, beside colcon: the packages are imported by links to their sources."""
    quiet = {name: value for name, value in building.items() if name != "HYDRO_COMPILATIONS"}
    for name, folders in (("PYTHONPATH", _link_sources()), ("AMENT_PREFIX_PATH", [str(INSTALL / "hydro_firmware")])):
        quiet[name] = os.pathsep.join(filter(None, [*folders, quiet.get(name)]))
    KERNELS.mkdir(exist_ok=True)
    stamp = str(KERNELS / f"kernels-{kernels}.json")
    _run(f"kernels {kernels}", [str(PYTHON), "-m", "setup.kernels", kernels, stamp, machine], quiet)


def _link_sources() -> list[str]:
    """Link the Python packages into `build/` as colcon does, and return the folders to import them from."""
    links = [ROOT / "build" / path.parent.name / path.parent.name for path in sorted(ROOT.glob("src/*/setup.py"))]
    for link in links:
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.exists():
            link.symlink_to(ROOT / "src" / link.name / link.name)
    return [str(link.parent) for link in links]


def say(line: str) -> None:
    """Print a line with the time since the set-up began."""
    print(f"[{time.monotonic() - BEGAN:3.0f} s] {line}", flush=True)


def _run(title: str, command: Sequence[str], variables: Mapping[str, str]) -> None:
    """Run a command in the checkout; its output goes to a log.

    Raises SetupError if it exits other than 0; the sentence quotes what went wrong and names the log.
    """
    log, began = WORK / f"{title.replace(' ', '-')}.log", time.monotonic()
    say(f"{title} ...")
    with log.open("wb") as out:
        how: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": out, "stderr": subprocess.STDOUT, "cwd": ROOT}
        process = subprocess.run(command, env=dict(variables), check=False, **how)
    if process.returncode != 0:
        lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
        errors = [line for line in lines if line.lower().startswith(("error", "fatal", "cmake error"))]
        quoted = (errors or lines or ["no output"])[-1][:300].rstrip(".")
        raise SetupError(f"{title} failed: {quoted}. Run this again, which goes on here; the whole output is in {log}.")
    say(f"{title}: {time.monotonic() - began:.0f} s")
