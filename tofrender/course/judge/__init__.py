"""Judge of submissions: `pytest -p tofrender.course.judge.plugin`.

A test never imports the submission. It asks a worker, a process of its own, which loads the
submission, runs a probe of the test's author on it, and answers with arrays.
"""
