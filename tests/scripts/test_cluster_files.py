"""scripts/cluster: the files parse, fit together, and the scripts in them start, resume and end what they should.

The scripts run with stand-ins for dask, tnst-mi and Slurm's commands, which note how they were called.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import psutil
import pytest

import tnst_mi

FOLDER = Path(__file__).resolve().parents[2] / "scripts" / "cluster"

DASK = """#!/usr/bin/env bash
echo "$$ $*" >> "$NOTES/dask"
while [ $# -gt 0 ]; do [ "$1" != --scheduler-file ] || file=$2; kind=${kind:-$1}; shift; done
if [ "$kind" = scheduler ]; then
    echo '{"addr' > "$file"; sleep 0.3; echo '{"address": "tcp://here:8786"}' > "$file"
fi
exec sleep 60
"""

TNST_MI = """#!/usr/bin/env bash
printf '%s\\n' "$@" > "$NOTES/arguments"
if [ -e "$NOTES/endless" ]; then
    trap 'sleep 0.3; exit 3' TERM
    touch "$NOTES/began"
    while :; do sleep 0.1; done
fi
exit "$(cat "$NOTES/code")"
"""

SRUN = """#!/usr/bin/env bash
trap 'kill $(jobs -p)' EXIT
trap exit TERM
echo "$*" > "$NOTES/srun"
shift 3
"$@" & "$@" &
wait
"""

SCONTROL = """#!/usr/bin/env bash
echo "$*" > "$NOTES/scontrol"
"""


class StandIns:
    """Programs that note how they are called, in the folder of an environment."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.notes, self.out = folder, folder / "notes", folder / "a shot" / "out"
        (folder / "bin").mkdir()
        self.notes.mkdir()
        (self.notes / "code").write_text("0")
        for name, text in {"dask": DASK, "tnst-mi": TNST_MI, "srun": SRUN, "scontrol": SCONTROL}.items():
            (folder / "bin" / name).write_text(text)
            (folder / "bin" / name).chmod(0o755)
        (folder / "bin" / "python").symlink_to(sys.executable)
        path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
        self.environment = os.environ | {"NOTES": str(self.notes), "PATH": path, "TNST_MI_ENV": str(folder)}
        self.environment |= {"SLURM_JOB_ID": "42", "SLURM_NTASKS": "2", "SLURM_CPUS_PER_TASK": "8"}

    def noted(self, name: str) -> list[str]:
        """The lines of a note; none if it was not written."""
        path = self.notes / name
        return path.read_text("utf-8").splitlines() if path.exists() else []

    def left(self) -> list[int]:
        """Processes of the stand-ins for dask that still run, after they have had time to end."""
        started = [int(line.split()[0]) for line in self.noted("dask")]
        end = time.monotonic() + 5
        while time.monotonic() < end and (left := [pid for pid in started if psutil.pid_exists(pid)]):
            time.sleep(0.05)
        return left


@pytest.fixture
def stand_ins(tmp_path: Path) -> StandIns:
    if shutil.which("bash") is None:
        pytest.skip("bash is not here, which runs the scripts")
    return StandIns(tmp_path)


def slurm(stand_ins: StandIns, *flags: str) -> subprocess.Popen:
    command = ["bash", str(FOLDER / "slurm.sh"), "in put", str(stand_ins.out), *flags]
    return subprocess.Popen(command, env=stand_ins.environment, stderr=subprocess.PIPE, text=True)


def test_a_slurm_job_is_scheduler_workers_and_run(stand_ins: StandIns) -> None:
    job = slurm(stand_ins, "--recipe", "my recipe.toml")
    assert job.wait(20) == 0, job.communicate()[1]
    arguments = stand_ins.noted("arguments")
    assert arguments[:4] == ["stylize", "in put", "--out", str(stand_ins.out)]
    assert arguments[4:] == ["--cluster", "tcp://here:8786", "--recipe", "my recipe.toml"]
    workers = [line for line in stand_ins.noted("dask") if " worker " in line]
    file = stand_ins.out.with_name("out.scheduler-42.json")
    assert all(f"--scheduler-file {file} --nthreads 1 --memory-limit 0" in line for line in workers)
    assert stand_ins.noted("srun")[0].startswith("--ntasks=2 --cpus-per-task=8 ")
    assert stand_ins.left() == [] and not file.exists() and stand_ins.noted("scontrol") == []


def test_a_slurm_job_goes_on_with_a_folder_that_is_there_and_passes_codes_on(stand_ins: StandIns) -> None:
    stand_ins.out.mkdir(parents=True)
    (stand_ins.notes / "code").write_text("2")
    assert slurm(stand_ins).wait(20) == 2
    assert stand_ins.noted("arguments")[-1] == "--resume"
    assert stand_ins.left() == [] and stand_ins.noted("scontrol") == []


@pytest.mark.parametrize(("sent", "requeued"), [(signal.SIGUSR1, ["requeue 42"]), (signal.SIGTERM, [])])
def test_a_slurm_job_ends_its_run_in_time_and_is_queued_again(
    sent: signal.Signals, requeued: list[str], stand_ins: StandIns
) -> None:
    (stand_ins.notes / "endless").touch()
    job = slurm(stand_ins)
    end = time.monotonic() + 15
    while not (stand_ins.notes / "began").exists() and time.monotonic() < end:
        time.sleep(0.05)
    job.send_signal(sent)
    assert job.wait(15) == 3
    assert stand_ins.noted("scontrol") == requeued and stand_ins.left() == []


def test_slurm_arguments_are_those_of_dask_jobqueue() -> None:
    ctrl_c = signal.getsignal(signal.SIGINT)
    jobqueue = pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")
    signal.signal(signal.SIGINT, ctrl_c)  # which it takes for itself
    arguments = tomllib.loads((FOLDER / "slurm.toml").read_text("utf-8"))
    assert arguments.pop("jobs") > 1
    arguments |= {"cores": 1, "processes": 1, "worker_extra_args": ["--memory-limit", "0"]}
    with jobqueue.SLURMCluster(**arguments, scheduler_options={"dashboard_address": ":0"}) as cluster:
        script = cluster.job_script()
    assert "#SBATCH --cpus-per-task=8" in script and "#SBATCH -p compute" in script
    # dask-jobqueue sets a limit of its own; of two, dask worker takes the last.
    assert "--nthreads 1" in script and script.split()[-2:] == ["--memory-limit", "0"]


def test_kubernetes_objects_fit_together() -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    claim, cluster, job = yaml.safe_load_all((FOLDER / "kubernetes.yaml").read_text("utf-8"))
    name = cluster["metadata"]["name"]
    scheduler, worker = cluster["spec"]["scheduler"], cluster["spec"]["worker"]
    assert scheduler["service"]["selector"]["dask.org/cluster-name"] == name
    (run,) = job["spec"]["template"]["spec"]["containers"]
    assert f"--cluster tcp://{name}-scheduler:8786" in run["args"][0]
    for pod in (worker["spec"], job["spec"]["template"]["spec"]):
        (volume,), (container,) = pod["volumes"], pod["containers"]
        assert volume["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
        assert container["volumeMounts"][0]["name"] == volume["name"]
    images = {
        pod["containers"][0]["image"] for pod in (worker["spec"], scheduler["spec"], job["spec"]["template"]["spec"])
    }
    assert len(images) == 1 and images.pop().endswith(f":{tnst_mi.__version__}")
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]


def openjd(*arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess:
    program = shutil.which("openjd")
    if program is None:
        pytest.skip("openjd is not here (pip install openjd-cli)")
    return subprocess.run([program, *arguments], env=environment, capture_output=True, text=True, check=False)


TEMPLATE = FOLDER / "openjd.yaml"


def run_template(stand_ins: StandIns, *others: str) -> subprocess.CompletedProcess:
    folder = stand_ins.folder
    parameters = {"Input": folder / "in put", "Recipe": folder / "my recipe.toml", "Out": stand_ins.out, "Others": 2}
    given = json.dumps({name: str(value) for name, value in parameters.items()} | {"Environment": str(folder)})
    return openjd("run", str(TEMPLATE), "-p", given, *others, environment=stand_ins.environment)


def test_the_openjd_template_is_valid() -> None:
    found = openjd("check", str(TEMPLATE), "--output", "json")
    assert found.returncode == 0, found.stdout
    told: dict[str, Any] = json.loads(found.stdout)
    assert told["status"] == "success"


def test_an_openjd_job_is_a_run_and_workers_that_come_too_late_end(stand_ins: StandIns) -> None:
    found = run_template(stand_ins)
    assert found.returncode == 0, found.stdout
    assert found.stdout.count("the run has ended without this worker") == 2
    arguments = stand_ins.noted("arguments")
    assert arguments[:2] == ["stylize", str(stand_ins.folder / "in put")]
    assert arguments[2:] == [
        *("--recipe", str(stand_ins.folder / "my recipe.toml")),
        *("--out", str(stand_ins.out), "--cluster", "tcp://here:8786"),
    ]
    assert [line.split()[1] for line in stand_ins.noted("dask")].count("worker") == 1
    assert stand_ins.left() == [] and not stand_ins.out.with_name("out.scheduler.json").exists()


def test_a_task_of_an_openjd_job_fails_if_its_run_does_and_resumes_it(stand_ins: StandIns) -> None:
    stand_ins.out.mkdir(parents=True)
    (stand_ins.notes / "code").write_text("3")
    found = run_template(stand_ins, "--task-param", "Place=0")
    assert found.returncode != 0 and stand_ins.noted("arguments")[-1] == "--resume"
    assert stand_ins.left() == []
