"""A suite on Ray workers, one shard per task, in a folder that all of them share."""
import subprocess
import ray
command = lambda i: ["opspace", "bench", "suite.toml", "--shard", f"{i}/8", "--out", "results"]
run = ray.remote(num_cpus=2)(lambda i: subprocess.run(command(i)).returncode)
print(ray.get([run.remote(i) for i in range(1, 9)]))
