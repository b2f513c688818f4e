"""The page about the package, and the front page: their code runs, from top to bottom."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "howto" / "python.md"

CHECKS = """
if __name__ == "__main__":
    assert result.outcome == "completed" and q.shape[0] == time.shape[0] > 1000
    assert set(errors) == {"position", "torque"} and max(errors.values()) < 5e-3
    assert len(results) == 4
    assert loop.phase == "control" and kind == "position" and values.shape == (7,)
    assert result.outcome == "completed" and observation.shape == (14,) and not terminated
    assert 0.0 < range_rad < 1.0
    assert folder.name == "two-links" and experiment.joints == ["shoulder", "elbow"]
    assert inertia.shape == (3, 3) and states.jacobian.shape == (1000, 6, 7)
"""


def test_code_of_the_page_runs(tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 6
    # Processes of the sweep import the file.
    body = "".join(blocks).replace("\n", "\n    ")
    script = tmp_path / "page.py"
    script.write_text(f'if __name__ == "__main__":\n    {body}\n{CHECKS}')
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "did you mean 'tip'" in ran.stdout


def test_code_of_the_front_page_runs(tmp_path):
    page = (ROOT / "README.md").read_text()
    (task,) = re.findall(r"^```toml\n# circle.toml\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    (code,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    (tmp_path / "circle.toml").write_text(task)
    (tmp_path / "robots").symlink_to(ROOT / "robots")
    check = "assert tip.shape == (len(result.log['tick'].time_s), 3)"
    ran = subprocess.run(
        [sys.executable, "-c", f"{code}\n{check}"], capture_output=True, text=True, timeout=120, cwd=tmp_path
    )
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) < 1.1e-3
