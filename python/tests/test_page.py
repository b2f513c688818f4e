"""The page about the package: its code runs, from top to bottom."""

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "python.md"

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
