"""Measures how fast the page of `tnst-mi studio` answers, and whether its memory stays flat.

    python scripts/measure_studio.py [--frame FILE] [--seconds SECONDS] [--out FILE]

It starts the command as people do, gets in by the URL that is printed, and asks for pictures as the page does: one at a
time while the camera goes around the smoke, of 400 rows while it moves and of 900 when it is still. `tried` is the same
with a try running beside it. After a warm-up, `--seconds` of a session in which all that the page can show is shown and
everything is opened anew again and again; the memory of the studio's process is taken before and after.
"""

from __future__ import annotations

import argparse
import http.client
import json
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import psutil

ROOT = Path(__file__).resolve().parents[1]
FRAME = ROOT / "scenes" / "suzanne" / "frame_0010.npz"

#: Rows and columns of the pictures while the camera moves, and when it is still, on a page of 1920×1080.
MOVING, STILL = (400, 560), (900, 1260)

#: Pictures of a turn.
TURN = 60

#: Seconds for a run to end, or to get as far as is waited for.
PATIENCE = 300


class Client:
    """The studio as a browser sees it, on one connection."""

    def __init__(self, process: subprocess.Popen[str], url: str) -> None:
        self.memory = psutil.Process(process.pid).memory_info
        address = urlsplit(url)
        self._connection = http.client.HTTPConnection(str(address.hostname), int(address.port or 0), timeout=PATIENCE)
        self._connection.request("GET", f"/?{address.query}")
        let_in = self._connection.getresponse()
        let_in.read()
        self._cookie = (let_in.headers["Set-Cookie"] or "").split(";")[0]

    def get(self, path: str, **query: object) -> bytes:
        """What is answered to a GET."""
        return self._answer("GET", f"{path}?{urlencode(query)}", None)

    def post(self, path: str, **values: object) -> bytes:
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

    def _answer(self, method: str, path: str, body: str | None) -> bytes:
        self._connection.request(method, path, body, {"Cookie": self._cookie})
        response = self._connection.getresponse()
        read = response.read()
        if response.status != 200:
            raise SystemExit(f"{path}: {response.status} {read.decode('utf-8', 'replace')}")
        return read


@contextmanager
def studio(frame: Path, out: Path) -> Iterator[Client]:
    """A studio in a process of its own."""
    command = [sys.executable, "-m", "tnst_mi", "studio", str(frame), "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        try:
            yield Client(process, process.stdout.readline().split()[-1])
        finally:
            process.send_signal(signal.SIGINT)


def measured(frame: Path, seconds: float) -> dict[str, Any]:
    """All numbers, by what was measured."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as out, studio(frame, Path(out)) as client:
        client.turn(MOVING, coarse=1)
        found["moving"] = client.turn(MOVING, coarse=1)
        found["moving, perspective"] = client.turn(MOVING, coarse=1, perspective=1)
        found["still"] = client.turn(STILL)
        client.post("/goal", key="style", goal="spirals")
        client.post("/work", action="try")
        client.until("running", least_done=3)
        found["moving, tried"] = client.turn(MOVING, coarse=1)
        found["still, tried"] = client.turn(STILL)
        client.until("done")
        client.post("/work", action="open", id="tries/0001")
        for mode in ("difference", "movement"):
            client.turn(MOVING, coarse=1, mode=mode)
            found[f"moving, {mode}"] = client.turn(MOVING, coarse=1, mode=mode)
        found["lit, a pass"] = client.turn((360, 500), mode="after", look="medium", lit=1)
        found["memory"] = session(client, seconds)
    return found


def session(client: Client, seconds: float) -> dict[str, Any]:
    """The memory of the studio in MB at the beginning and the end of a session, and each tenth of it."""
    taken, begun, rounds = [], time.monotonic(), 0
    while (now := time.monotonic() - begun) < seconds or len(taken) < 2:
        if now >= len(taken) * seconds / 10:
            taken.append(round(client.memory().rss / 1e6))
        everything(client, rounds)
        rounds += 1
    return {"minutes": round(seconds / 60, 1), "rounds": rounds, "MB": [*taken, round(client.memory().rss / 1e6)]}


def everything(client: Client, number: int) -> None:
    """Show all that the page can show, and open it anew."""
    for mode in ("before", "after", "difference", "movement"):
        for picture in range(6):
            place = {"azimuth": 17 * number + 3 * picture, "rows": MOVING[0], "columns": MOVING[1], "coarse": 1}
            client.get("/view", mode=mode, look=("network", "thin", "medium", "thick")[picture % 4], **place)
        client.get("/view", mode=mode, cut="xyz"[number % 3], at=(number % 10) / 10, rows=400, columns=560)
    client.get("/view", mode="after", look="medium", lit=1, azimuth=number, rows=200, columns=280, height=110)
    client.get("/motifs", find="s")
    client.post("/set", key="gamma", value=round(0.05 + 0.001 * (number % 100), 4))
    client.state()
    if number % 10 == 9:
        client.post("/work", action="open", id="tries/0001")


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frame", type=Path, default=FRAME, help="file of a density")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the session")
    parser.add_argument("--out", type=Path, help="file for the numbers (JSON)")
    arguments = parser.parse_args()
    found = measured(arguments.frame, arguments.seconds)
    for what, numbers in found.items():
        print(f"{what:22}", ", ".join(f"{name} {value}" for name, value in numbers.items()))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
