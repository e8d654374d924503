"""A studio in a process of its own, and what takes a process its room or its rights."""

import contextlib
import ctypes
import http.client
import json
import os
import resource
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 180  # that one wait may take on a machine that does much else


class Studio:
    """A studio in a process of its own."""

    def __init__(self, folder, *words, environment=None, limit=None):
        self.folder = folder
        log = Path(f"{folder}.log")
        source = str(ROOT / "src")
        # A process whose files are bounded would leave bytecode that is cut off, for all that come after it.
        bounded = {"PYTHONDONTWRITEBYTECODE": "1"} if limit else {}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bunraku", "studio", "--no-browser", "--port", "0", "--folder", str(folder), *words],
            stdout=log.open("w"), stderr=subprocess.STDOUT, preexec_fn=limit,
            env={**os.environ, "PYTHONPATH": source, "OMP_NUM_THREADS": "1", **bounded, **(environment or {})},
        )  # fmt: skip
        self.log = log
        self.address = self.until(self._address, "an address")
        self.base, _, self.token = self.address.partition("/#token=")

    def _address(self):
        if self.process.poll() is not None:
            raise AssertionError(self.log.read_text())
        lines = [line for line in self.log.read_text().splitlines() if line.startswith("studio: ")]
        return lines[0].split()[1] if lines else None

    def until(self, look, what="it"):
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            found = look()
            if found:
                return found
            time.sleep(0.15)
        raise AssertionError(f"{what} did not come within {SECONDS} s")

    def ask(self, method, path, body=None, data=None, headers=None, token=None):
        """Status and JSON, or bytes where the answer is none."""
        asked = urllib.request.Request(f"{self.base}{path}", method=method)
        asked.add_header("authorization", f"Bearer {self.token if token is None else token}")
        for name, value in (headers or {}).items():
            asked.add_header(name, value)
        if body is not None:
            data = json.dumps(body).encode()
        try:
            with urllib.request.urlopen(asked, data=data, timeout=SECONDS) as answer:
                status, content = answer.status, answer.read()
        except urllib.error.HTTPError as error:
            status, content = error.code, error.read()
        except http.client.IncompleteRead as error:
            raise AssertionError(f"{path}: {error}; the studio says:\n{self.log.read_text()[-4000:]}") from error
        try:
            return status, json.loads(content)
        except ValueError:
            return status, content

    def get(self, path):
        status, body = self.ask("GET", path)
        assert status == 200, body
        return body

    def post(self, path, body=None, data=None):
        status, found = self.ask("POST", path, body if data is None else None, data)
        assert status in (200, 201, 202), found
        return found

    def ended(self, job):
        """The job when it has ended, however it did."""
        return self.until(
            lambda: (found := self.get(f"/api/jobs/{job}"))["state"] not in ("waiting", "running") and found,
            f"job {job}",
        )

    def done(self, job):
        found = self.ended(job)
        assert found["state"] == "done", found
        return found

    def wait(self, made):
        """What was asked for, when its job is done."""
        self.done(made["job"])
        return made

    def sample(self, name="mushroom"):
        made = self.wait(self.post(f"/api/characters?sample={name}", {}))
        path = f"/api/characters/{made['character']['id']}"
        return self.until(lambda: (found := self.get(path)) and "ends" in found and found, "all of a character")

    def animate(self, character, text="waves", seconds=2, **how):
        body = {"script": [{"text": text, "seconds": seconds}], "seeds": [0], "steps": 4, "candidates": 1, **how}
        return self.post(f"/api/characters/{character}/takes", body)

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(60)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait(20)


@contextlib.contextmanager
def no_space(process=0):
    """No file of a process may grow: the system refuses as it does on a full disk."""
    before = resource.prlimit(process, resource.RLIMIT_FSIZE)
    resource.prlimit(process, resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.prlimit(process, resource.RLIMIT_FSIZE, before)


def as_somebody():
    """Give up the right to write where files forbid it, which root has; for `preexec_fn`."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
            if libc.prctl(24, capability, 0, 0, 0):  # PR_CAPBSET_DROP
                raise OSError(ctypes.get_errno(), "capabilities cannot be given up")
