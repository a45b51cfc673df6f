"""Judge of submissions: `pytest -p tofrender.course.judge.plugin`.

A test never imports the submission. It asks a worker, which is a separate process. The worker loads
the submission, calls a probe (a function by the author of the test) with it, and sends arrays back.

| module | contents |
|---|---|
| `plugin` | the pytest plugin: the fixture `submission`, a marker for each problem, a report |
| `client`, `worker`, `wire` | the test's end, the submission's end, and the data between them |
| `expect` | comparisons; a failure shows the expected and the actual value |
| `trials` | correct and wrong solutions, for problems that ask for a test |
| `inputs` | numbers of the public tests that change with the term |
| `forbidden` | features that an assignment forbids |
| `factors` | answers that are wrong by a constant factor |
| `sandbox`, `system_calls`, `processes` | rights of a process, and how its children are ended |
| `speed` | speed of the machine, which scales time limits |
| `running` | run an assignment's tests in a separate pytest, and read its report |
"""
