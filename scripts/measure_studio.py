"""Measures how fast the page of `tnst-mi studio` answers, and whether its memory stays flat.

    python scripts/measure_studio.py [--frame FILE] [--minutes MINUTES] [--out FILE]

It starts the command as people do, on a sequence of a few copies of the frame, gets in by the URL that is printed, and
asks for pictures as the page does: one at a time while the camera goes around the smoke, of 400 rows while it moves
and of 900 when it is still. `tried` is the same with a try running beside it. Then a session of `--minutes`: the camera
orbits, the frames are scrubbed through, before and after are wiped, everything that the page can show is shown,
pictures are uploaded, tries begun, and all of it opened anew. The memory of the studio's process (tries are others) is
taken every ten seconds.
"""

from __future__ import annotations

import argparse
import http.client
import io
import json
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import numpy as np
import psutil
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
FRAME = ROOT / "scenes" / "suzanne" / "frame_0010.npz"

#: Rows and columns of the pictures while the camera moves, and when it is still, on a page of 1920×1080.
MOVING, STILL = (400, 560), (900, 1260)

#: What smoke is as thick as.
LOOKS = ("network", "thin", "medium", "thick")

#: The goal of tries.
STYLE = "spirals"

#: Pictures of a turn.
TURN = 60

#: Frames of the sequence.
FRAMES = 4

#: Seconds between two readings of the memory, two rounds of the session, two of its uploads, and two of its tries.
READ_EVERY, PAUSE, UPLOAD_EVERY, TRY_EVERY = 10.0, 0.5, 20.0, 60.0

#: Seconds for a run to end, or to get as far as is waited for.
PATIENCE = 300

#: Seconds for the studio to end, in which it pauses its tries.
ENDING = 60


class Client:
    """The studio as a browser sees it, on one connection.

    Attributes:
        longest: seconds that any answer has taken.
    """

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        self.longest = 0.0
        self.memory = psutil.Process(process.pid).memory_info
        address = urlsplit(url)
        self._connection = http.client.HTTPConnection(str(address.hostname), int(address.port or 0), timeout=PATIENCE)
        self._connection.request("GET", f"/?{address.query}")
        let_in = self._connection.getresponse()
        let_in.read()
        self._cookie = (let_in.headers["Set-Cookie"] or "").split(";")[0]

    def get(self, path: str, /, **query: object) -> bytes:
        """What is answered to a GET."""
        return self._answer("GET", f"{path}?{urlencode(query)}", None)

    def post(self, path: str, /, **values: object) -> bytes:
        """What is answered to a POST."""
        return self._answer("POST", path, json.dumps(values))

    def state(self) -> dict[str, Any]:
        """What tabs are told, by the first event of a connection of its own."""
        connection = http.client.HTTPConnection(self._connection.host, self._connection.port, timeout=PATIENCE)
        try:
            connection.request("GET", "/events", headers={"Cookie": self._cookie})
            return json.loads(connection.getresponse().readline().removeprefix(b"data: "))
        finally:
            connection.close()

    def drop(self, path: str, name: str, picture: bytes) -> bytes:
        """What is answered to a picture that is dropped on a part of the page."""
        return self._answer("POST", f"{path}?{urlencode({'name': name})}", picture)

    def turn(self, size: tuple[int, int], **query: object) -> dict[str, float]:
        """Milliseconds of the pictures of a turn around the smoke."""
        times = []
        for picture in range(TURN):
            begun = time.perf_counter()
            place = {"azimuth": 360 * picture / TURN, "elevation": 20 * (picture % 2), "height": 110}
            self.get("/view", rows=size[0], columns=size[1], **place, **query)
            times.append(1e3 * (time.perf_counter() - begun))
        return {
            "median": round(statistics.median(times), 1),
            "95%": round(statistics.quantiles(times, n=20)[-1], 1),
            "largest": round(max(times), 1),
        }

    def until(self, status: str, least_done: int = 0) -> None:
        """Wait until the latest try has a status and as many iterations."""
        end = time.monotonic() + PATIENCE
        while (work := self.state()["work"][0])["status"] != status or work["done"] < least_done:
            if time.monotonic() > end or work["status"] == "failed":
                raise SystemExit(f"the try is {work['status']}: {work['error']}")
            time.sleep(0.2)
        # The studio closes connections that nobody has used for a minute, as the one of the pictures may have been.
        self._connection.close()

    def _answer(self, method: str, path: str, body: str | bytes | None) -> bytes:
        begun = time.monotonic()
        self._connection.request(method, path, body, {"Cookie": self._cookie})
        response = self._connection.getresponse()
        status, read = response.status, response.read()
        self.longest = max(self.longest, time.monotonic() - begun)
        if status != 200:
            raise SystemExit(f"{path}: {status} {read.decode('utf-8', 'replace')}")
        return read


@contextmanager
def studio(frames: Path, out: Path) -> Iterator[Client]:
    """A studio in a process of its own."""
    command = [sys.executable, "-m", "tnst_mi", "studio", str(frames), "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        try:
            yield Client(process, process.stdout.readline().split()[-1])
        finally:
            # Shells let what they run in the background ignore SIGINT, and what it begins likewise.
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
                raise SystemExit(f"the studio has not ended within {ENDING} seconds") from None


def measured(frame: Path, minutes: float) -> dict[str, Any]:
    """All numbers, by what was measured."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, studio(sequence(frame, Path(folder)), Path(folder) / "out") as client:
        client.turn(MOVING, coarse=1)
        found["moving"] = client.turn(MOVING, coarse=1)
        found["moving, perspective"] = client.turn(MOVING, coarse=1, perspective=1)
        found["still"] = client.turn(STILL)
        client.post("/goal", key="style", goal=STYLE)
        client.post("/work", action="try", alone=0)
        client.until("running", least_done=3)
        found["moving, tried"] = client.turn(MOVING, coarse=1)
        found["still, tried"] = client.turn(STILL)
        client.until("done")
        client.post("/work", action="open", id="tries/0001")
        for mode in ("difference", "movement", "depth"):
            client.turn(MOVING, coarse=1, mode=mode)
            found[f"moving, {mode}"] = client.turn(MOVING, coarse=1, mode=mode)
        found["lit, a pass"] = client.turn((360, 500), mode="after", look="medium", lit=1)
        found["memory"] = in_memory(session(client, minutes))
    return found


def sequence(frame: Path, folder: Path) -> Path:
    """A folder of copies of a frame."""
    frames = folder / "frames"
    frames.mkdir()
    for number in range(1, FRAMES + 1):
        shutil.copy(frame, frames / f"frame_{number:04d}{frame.suffix}")
    return frames


def session(client: Client, minutes: float) -> list[tuple[float, float]]:
    """The memory of the studio in a session: minutes since its beginning, and MB."""
    taken: list[tuple[float, float]] = []
    begun, over = time.monotonic(), threading.Event()

    def read() -> None:
        while not over.wait(max(0.0, begun + READ_EVERY * len(taken) - time.monotonic())):
            taken.append(((time.monotonic() - begun) / 60, client.memory().rss / 1e6))

    reader = threading.Thread(target=read)
    reader.start()
    rounds = uploads = tries = 0
    try:
        while (now := time.monotonic() - begun) < 60 * minutes:
            everything(client, rounds)
            rounds += 1
            if now >= UPLOAD_EVERY * uploads:
                client.drop("/upload", f"picture {uploads}.png", noise(uploads))
                client.post("/clear")  # it is chosen, and tries would take longer and longer
                client.post("/goal", key="style", goal=STYLE)
                client.drop("/alike", f"picture {uploads}.png", noise(uploads))
                uploads += 1
            if now >= TRY_EVERY * tries:
                begin_try(client)
                tries += 1
            time.sleep(PAUSE)
    finally:
        over.set()
        reader.join()
    print(
        f"a session of {rounds} rounds, {uploads} uploads and {tries} tries; longest answer {client.longest:.1f} s",
        flush=True,
    )
    return taken


def in_memory(taken: list[tuple[float, float]]) -> dict[str, Any]:
    """What the readings of a session come to: means of its tenths, and its slope by least squares."""
    minutes, megabytes = (np.array(values) for values in zip(*taken, strict=True))
    tenths = [round(float(tenth.mean())) for tenth in np.array_split(megabytes, min(10, len(taken)))]
    slope = float(np.polyfit(minutes, megabytes, 1)[0]) if len(taken) > 1 else 0.0
    return {
        "minutes": round(float(minutes[-1]), 1),
        "first tenth MB": tenths[0],
        "last tenth MB": tenths[-1],
        "largest MB": round(float(megabytes.max())),
        "MB a minute": round(slope, 3),
        "tenths MB": tenths,
    }


def everything(client: Client, number: int) -> None:
    """Show all that the page can show of what is opened; now and then open something anew."""
    moving = {"rows": MOVING[0], "columns": MOVING[1], "coarse": 1}
    after = client.state()["opened"]["after"]
    for mode in ("before", "after", "difference", "movement", "depth") if after else ("before",):
        for picture in range(6):
            place = {"azimuth": 17 * number + 3 * picture, "look": LOOKS[picture % len(LOOKS)]}
            client.get("/view", mode=mode, **place, **moving)
        client.get("/view", mode=mode, cut="xyz"[number % 3], at=(number % 10) / 10, rows=400, columns=560)
    for step in range(FRAMES):
        if after:
            for side in ("before", "after"):  # a wipe
                client.get("/view", mode=side, azimuth=17 * number + step, **moving)
            client.get("/arrows", azimuth=17 * number + step, **moving)
        else:
            client.get("/view", mode="before", frame=step, **moving)
    client.get("/view", mode="before", look="medium", lit=1, azimuth=number, rows=200, columns=280, height=110)
    client.get("/motifs", find="s")
    client.post("/set", key="gamma", value=round(0.05 + 0.001 * (number % 100), 4))
    if number % 10 == 4:
        client.post("/open", path=".")
    if number % 10 == 9:
        client.post("/work", action="open", id="tries/0001")


def begin_try(client: Client) -> None:
    """Begin a short try of a frame of the sequence."""
    client.post("/open", path=".")
    for key, value in (("iterations", 3), ("octaves", 2), ("views", 1)):
        client.post("/set", key=key, value=value)
    client.post("/work", action="try", alone=0)


def noise(seed: int) -> bytes:
    """A picture as a PNG."""
    encoded = io.BytesIO()
    values = np.random.default_rng(seed).integers(0, 256, (240, 320, 3), np.uint8)
    Image.fromarray(values).save(encoded, "PNG")
    return encoded.getvalue()


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frame", type=Path, default=FRAME, help="file of a density")
    parser.add_argument("--minutes", type=float, default=1.0, help="length of the session")
    parser.add_argument("--out", type=Path, help="file for the numbers (JSON)")
    arguments = parser.parse_args()
    found = measured(arguments.frame, arguments.minutes)
    for what, numbers in found.items():
        print(f"{what:22}", ", ".join(f"{name} {value}" for name, value in numbers.items()))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
