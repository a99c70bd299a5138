"""A Slurm cluster of this one machine, in a directory of its own, for tests: munged, slurmctld and slurmd."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel")
CONFIG = """
ClusterName=roomeq
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={place}/munge.socket,cred_expire=5
CredType=cred/munge
StateSaveLocation={place}/state
SlurmdSpoolDir={place}/spool
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd.pid
SlurmctldLogFile={place}/slurmctld.log
SlurmdLogFile={place}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=sched_interval=1,batch_sched_delay=0
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=1
RebootProgram=/bin/true
NodeName={host} NodeAddr=127.0.0.1 CPUs=4 RealMemory=4000 State=UNKNOWN
PartitionName=cpu Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def why_not() -> str | None:
    """Return why no cluster can be started here, or None."""
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    if lacking := [program for program in PROGRAMS if not shutil.which(program, path=path)]:
        return f"needs {', '.join(lacking)}: apt-get install slurm-wlm munge"
    return None if os.geteuid() == 0 else "needs root, to start a Slurm cluster"


@contextlib.contextmanager
def cluster(place: Path):
    """Start a cluster; give the environment in which `sbatch` finds it. Whatever happens, it ends with the block.

    Parameters
    ----------
    place : Path
        Where its files go; munge wants nobody else to be able to write there.

    Raises
    ------
    RuntimeError
        It does not come up within half a minute; the message quotes its logs.
    """
    place.mkdir(parents=True, mode=0o755)
    for name in ("state", "spool"):
        (place / name).mkdir()
    config = place / "slurm.conf"
    config.write_text(CONFIG.format(host=socket.gethostname().split(".")[0], ports=_free_ports(2), place=place))
    (place / "munge.key").write_bytes(os.urandom(128))
    (place / "munge.key").chmod(0o400)
    env = dict(os.environ, SLURM_CONF=str(config), PATH=f"{os.environ['PATH']}:/usr/sbin:/sbin")
    servers = []
    try:
        munge = {name: f"--{name}-file={place}/munge.{name}" for name in ("key", "log", "pid", "seed")}
        servers.append(_start(["munged", "--foreground", "--force", f"--socket={place}/munge.socket",
                               *munge.values()], place, env))
        _wait_for(lambda: (place / "munge.socket").exists(), place)
        servers.append(_start(["slurmctld", "-D", "-i", "-f", str(config)], place, env))
        servers.append(_start(["slurmd", "-D", "-f", str(config)], place, env))
        _wait_for(lambda: "idle" in _said(["sinfo", "--noheader", "--format=%t"], env), place)
        yield env
    finally:
        subprocess.run(["scancel", "--user=root"], env=env, capture_output=True, timeout=20, check=False)
        for server in reversed(servers):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGTERM)
            try:
                server.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(server.pid, signal.SIGKILL)
                server.wait()


def _start(command: list[str], place: Path, env: dict) -> subprocess.Popen:
    with open(place / f"{command[0]}.out", "wb") as out:
        return subprocess.Popen(command, env=env, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                                cwd=place, start_new_session=True)


def _said(command: list[str], env: dict) -> str:
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=20, check=False).stdout


def _wait_for(is_so, place: Path) -> None:
    until = time.monotonic() + 30
    while not is_so():
        if time.monotonic() > until:
            logs = "\n".join(f"{path.name}: {path.read_text()[-1500:]}" for path in sorted(place.glob("*.[lo]*")))
            raise RuntimeError(f"no Slurm cluster came up in {place}:\n{logs}")
        time.sleep(0.2)


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
