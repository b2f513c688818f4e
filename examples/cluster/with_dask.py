"""A suite on Dask workers, one shard per task, in a folder that all of them share: with_dask.py [SCHEDULER]."""
import subprocess, sys
from dask.distributed import Client
shard = lambda i: subprocess.run(["opspace", "bench", "suite.toml", "--shard", f"{i}/8", "--out", "results"]).returncode
if __name__ == "__main__":
    client = Client(*sys.argv[1:])  # without a scheduler: workers on this machine
    print(client.gather(client.map(shard, range(1, 9), pure=False)))
