#!/usr/bin/env bash
# One job that is scheduler, coordinator and workers:
#
#     TNST_MI_ENV=/shared/env sbatch [--partition=… --gpus-per-task=1 …] slurm.sh INPUT OUT --recipe RECIPE.toml
#
# What follows OUT are flags of `tnst-mi stylize`. INPUT, OUT, the weights and the virtual environment are on file systems
# that all nodes have under the same paths. A job that has been requeued, or is submitted again, goes on with OUT.

#SBATCH --job-name=tnst-mi
#SBATCH --ntasks=8
#SBATCH --cpus-per-task=8
#SBATCH --mem-per-cpu=4G
#SBATCH --time=08:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=tnst-mi-%j.log
# Before the time is up; --time less what an own step takes, and some.
#SBATCH --signal=B:USR1@180

set -euo pipefail

[ $# -ge 2 ] || { echo "usage: sbatch slurm.sh INPUT OUT [flags of tnst-mi stylize]" >&2; exit 2; }
input=$1 out=${2%/}
shift 2
bin=${TNST_MI_ENV:-/shared/env}/bin

# Workers find the scheduler by this file, which all nodes see.
scheduler_file=$out.scheduler-$SLURM_JOB_ID.json
mkdir -p "$(dirname "$out")"
rm -f "$scheduler_file"

# Dask's processes look at themselves a hundred times a second otherwise, on cores that compute.
export DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED=False DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL=500ms

running=()
# shellcheck disable=SC2329 # The trap calls it.
stop() {
    [ ${#running[@]} -eq 0 ] || kill "${running[@]}" 2>/dev/null || true
    rm -f "$scheduler_file"
}
trap stop EXIT
trap 'exit 143' TERM INT USR1

"$bin/dask" scheduler --port 0 --dashboard-address :0 --scheduler-file "$scheduler_file" &
running+=($!)

# Since Slurm 22.05 srun does not know --cpus-per-task from sbatch.
srun --ntasks="$SLURM_NTASKS" --cpus-per-task="${SLURM_CPUS_PER_TASK:-1}" --kill-on-bad-exit=0 \
    "$bin/dask" worker --scheduler-file "$scheduler_file" --nthreads 1 --memory-limit 0 --death-timeout 300 &
running+=($!)

# The file is there before all of it has been written.
until address=$("$bin/python" -c 'import json, sys; print(json.load(open(sys.argv[1]))["address"])' \
    "$scheduler_file" 2>/dev/null); do
    kill -0 "${running[0]}" || { echo "the scheduler has ended" >&2; exit 1; }
    sleep 1
done

resume=()
[ ! -e "$out" ] || resume=(--resume)
"$bin/tnst-mi" stylize "$input" --out "$out" --cluster "$address" "${resume[@]}" "$@" &
coordinator=$!
running+=("$coordinator")

# Asked to end, it does so after the steps in flight; when time is nearly up, the job then goes on in another turn.
signalled='' again=''
trap 'signalled=yes; kill -TERM "$coordinator"' TERM INT
trap 'signalled=yes again=yes; kill -TERM "$coordinator"' USR1
while :; do
    code=0
    wait "$coordinator" || code=$?
    # A signal ends the waiting, not what is waited for.
    [ -n "$signalled" ] || break
    signalled=''
done
if [ -n "$again" ] && [ "$code" -eq 3 ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
