"""Classroom 50 runs this in GitHub Actions for each submission, in the student's repository."""

import os
import subprocess
from pathlib import Path

here = Path(__file__).resolve().parent
course, repository = here / "course", Path.cwd()
subprocess.run(["bash", here / "setup.sh"], check=True)
command = [course / ".venv/bin/python", "-m", "tofrender", "grade", "@folder@"]
command += ["--submission", repository, "-o", repository / "result.json", "--format", "classroom50"]
command += ["--time-limit", "@time_limit_s@", "--memory", "@memory_gib@"]
subprocess.run(command, cwd=course, env=os.environ | {"PYTHONPATH": str(course)}, check=True)
