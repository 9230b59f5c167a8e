"""A journal replayed, solves included, against the live state: equal bit for bit?

Victoria Park goes through HTTP into a service, which solves the atlas as it does for anyone. The
digest of the live state (every sub-map's estimate, the solution, the joint covariances) is then
compared with that of the same journal recovered in processes of their own: as it is, with the
compiled code made for the plainest processor of the architecture, and with the C library's and
NumPy's code for newer processors switched off.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import uvicorn

from service.app import create_app
from service.client import Client
from service.datasets import VICTORIA_PARK, read_source
from service.engine import Engine
from service.recovery import recover
from service.replaying import replay
from service.settings import Settings
from service.store.sqlite import SqliteJournal
from submaps.atlas.state import AtlasState

MAP = "park"
PLAIN = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}
OLD_LIBRARIES = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA,-FMA4",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512_SKX",
    "OPENBLAS_CORETYPE": "Prescott",
}


def digest_of(state: AtlasState) -> str:
    """Digest of a map's state, joint covariances from the solution included."""
    digest = hashlib.blake2b(state.digest(), digest_size=16)
    solution = state.solution
    if solution is not None:
        for number in range(solution.base.submap_count):
            digest.update(np.ascontiguousarray(solution.placed(number).covariance).tobytes())
    return f"{digest.hexdigest()} (version {state.version}, {state.submap_count} sub-maps)"


def live(folder: Path) -> str:
    """Serve, replay over HTTP, wait for the last solve, and return the digest of the live state."""
    app = create_app(Settings.from_environment({}, data_dir=folder, port=0))
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    engine: Engine = app.state.engine
    while not server.started or engine.unready is not None:
        time.sleep(0.05)
    port = server.servers[0].sockets[0].getsockname()[1]
    with Client(f"http://127.0.0.1:{port}") as client:
        replay(client, read_source(VICTORIA_PARK), MAP, lambda *_: None)
    state = engine.maps[MAP].view.state
    while True:  # a solve that began on its own may still be on its way
        time.sleep(1.0)
        if engine.maps[MAP].view.state is state:
            break
        state = engine.maps[MAP].view.state
    server.should_exit = True
    thread.join()
    return digest_of(state)


def recovered(folder: Path) -> str:
    """Digest of the state that the journal's recovery reaches."""
    journal = SqliteJournal(folder)
    (hosted,) = recover(journal)
    journal.close()
    return digest_of(hosted.view.state)


def main() -> None:
    """Compare, and say so; exit code 1 where a digest differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recover", type=Path, help="print the digest of the journal in this folder, no more")
    folder = parser.parse_args().recover
    if folder is not None:
        print(recovered(folder))
        return
    with tempfile.TemporaryDirectory(prefix="submaps-") as home:
        data = Path(home) / "data"
        first = live(data)
        print(f"live                                   {first}")
        failed = False
        ways = {"same processor": {}, "plain processor": PLAIN, "plain, old libraries": PLAIN | OLD_LIBRARIES}
        for name, environment in ways.items():
            command = [sys.executable, "-m", "benchmarks.replay", "--recover", str(data)]
            out = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
            again = out.stdout.strip().splitlines()[-1]
            failed |= again != first
            print(f"replayed, {name:28s} {again} {'equal' if again == first else 'DIFFERS'}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
